//! The hardware: one file per board, which names its pins as the schematic does, and one file per
//! peripheral. All unsafe code of the firmware is here.
//!
//! A board file has `NAME`, `CORE_HZ`, `OUTPUT`, `SENSES` and `take`, and picks its [`Output`]; see
//! docs/adding-a-board.md.
#![allow(unsafe_code)]

#[cfg(all(feature = "nucleo-f446re", feature = "discovery-f407"))]
compile_error!("pick one board: --no-default-features --features BOARD");
#[cfg(not(any(feature = "nucleo-f446re", feature = "discovery-f407")))]
compile_error!("pick a board: --features nucleo-f446re or discovery-f407");

#[cfg(feature = "discovery-f407")]
mod discovery_f407;
#[cfg(feature = "discovery-f407")]
use discovery_f407 as selected;
#[cfg(feature = "nucleo-f446re")]
mod nucleo_f446re;
#[cfg(feature = "nucleo-f446re")]
use nucleo_f446re as selected;

mod common;
mod f4;

#[cfg(not(feature = "usual-logger"))]
pub use common::logger::dropped as log_dropped;
#[cfg(feature = "usual-logger")]
pub use common::rtt::log_dropped;
pub use common::rtt::{Commands, Link, UpLink};
pub use f4::{
    debugger::Halts,
    encoder::{Encoder, turn as turn_encoder},
    fault_memory::FaultMemory,
    flash::{FlashError, SettingsFlash},
    sample_timer::SampleTimer,
    supply::{Supply, has_dropped as supply_has_dropped},
    watchdog::Watchdog,
};
pub use selected::{LATENCY_SAMPLES, NAME, OUTPUT, SENSES, take};

use f4::{enable, sample_timer};

use stm32f4xx_hal::{
    pac,
    rcc::{Enable, Rcc, Reset},
};
use zwidth::{safety::ResetCause, units::OutputCode};

/// Samples per second, Hz.
pub const RATE_HZ: u32 = 10_000;

/// All of the board that the tasks use.
pub struct Board {
    /// Position.
    pub encoder: Encoder,
    /// When to sample.
    pub sample_timer: SampleTimer,
    /// Force and enable.
    pub drive: Drive,
    /// Emergency stop.
    pub stop: EmergencyStop,
    /// Supply voltage.
    pub supply: Supply,
    /// Halts by a debugger.
    pub halts: Halts,
    /// Reset when the tasks stop.
    pub watchdog: Watchdog,
    /// What a reset must not wipe out.
    pub memory: FaultMemory,
    /// Why the program starts.
    pub reset_cause: ResetCause,
    /// Where settings are kept.
    pub settings: SettingsFlash,
    /// Probe link.
    pub link: Link,
}

/// The force output and the amplifier's enable line.
pub struct Drive {
    output: selected::Output,
}

impl Drive {
    /// Puts a command out, mirrored about zero force if the motor is mounted the other way round.
    /// It moves nothing while the amplifier is off.
    #[inline(always)]
    pub fn write(&mut self, command: OutputCode, mirrored: bool) {
        self.output.write(command, mirrored);
    }

    /// Enables the amplifier at zero force. The emergency stop's hardware has the last word.
    pub fn on(&mut self) {
        selected::zero();
        enable::on();
    }

    /// Whether the amplifier is enabled; false as soon as hardware or a task has dropped it.
    #[inline(always)]
    pub fn is_on(&self) -> bool {
        enable::is_on()
    }

    /// Whether the emergency stop was open since the amplifier was enabled, if only for a moment.
    #[inline(always)]
    pub fn was_stopped(&self) -> bool {
        enable::was_stopped()
    }
}

/// Starts the output's clock and, right after it, the sampling: their distance sets the phase of the PWM. Once,
/// with all interrupts on.
pub fn start() {
    selected::start();
    sample_timer::start();
}

/// Off: enable inactive first, then zero force. From any task, and from the panic and fault
/// handlers; a handful of stores.
#[inline(always)]
pub fn off() {
    enable::off();
    selected::zero();
}

/// Normally closed switch to ground with a pull-up: an open switch or a cut wire reads as a stop.
/// The same pin is TIM1's break input, which drops enable without any code.
pub struct EmergencyStop(());

impl EmergencyStop {
    /// The switch is closed: no stop.
    #[inline(always)]
    pub fn is_closed(&self) -> bool {
        selected::stop_input_is_low()
    }
}

/// Watches the HSE: if it fails, TIM1's break drops enable and an NMI ends the program.
fn watch_clock() {
    // SAFETY: one bit of a register that nobody else writes after the clock was set up.
    let rcc = unsafe { &*pac::RCC::ptr() };
    rcc.cr().modify(|_, w| w.csson().set_bit());
}

/// TIM1 with a clock and in its reset state; its outputs stay off.
fn power_tim1(rcc: &mut Rcc) {
    pac::TIM1::enable(rcc);
    pac::TIM1::reset(rcc);
}
