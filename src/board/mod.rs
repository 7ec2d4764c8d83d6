//! The hardware. All unsafe code of the firmware is here, except the hand-over between tasks in `src/sync`.
//!
//! [`zwidth::contract`] states what a board provides. A board is one file, which exports `Selected`. The file names the
//! pins as the schematic does. It includes the peripherals of its family (`f4/`) and the code that all families share
//! (`common/`). See docs/lab/adding-a-board.md.
#![allow(unsafe_code)]

// Each feature selects one board. build.rs refuses two boards.
#[cfg(feature = "discovery-f407")]
#[path = "discovery_f407.rs"]
mod selected;
#[cfg(feature = "nucleo-f446re")]
#[path = "nucleo_f446re.rs"]
mod selected;

mod common;

pub use common::{device_record::device_record, image::image};

use cortex_m::register::control;
use selected::Selected;
pub use zwidth::contract::{FlashError, RATE_HZ};
use zwidth::{
    contract::{self, Parts},
    device::record::BoardFacts,
    safety::{Fault, OutputWatch},
};

// The parts of the selected board, under the names that the tasks use.
pub type Board = Parts<Selected>;
pub type Link = contract::Link<Selected>;
pub type Encoder = <Selected as contract::Board>::Encoder;
pub type SampleTimer = <Selected as contract::Board>::SampleTimer;
type Force = <Selected as contract::Board>::Force;
type Enable = <Selected as contract::Board>::Enable;
pub type Drive = contract::Drive<Force, Enable>;
pub type EmergencyStop = contract::EmergencyStop<<Selected as contract::Board>::StopInput>;
pub type Supply = <Selected as contract::Board>::Supply;
pub type Halts = <Selected as contract::Board>::DebugHalts;
pub type FaultMemory = <Selected as contract::Board>::FaultMemory;
pub type Watchdog = <Selected as contract::Board>::Watchdog;
pub type SetUp = <Selected as contract::Board>::SetUp;
pub type ReadBack = <Selected as contract::Board>::ReadBack;
pub type OutputWatchdog = <Selected as contract::Board>::OutputWatchdog;
pub type SelfTest = <Selected as contract::Board>::SelfTest;
pub type SettingsFlash = <Selected as contract::Board>::Flash;
pub type Telemetry = <Selected as contract::Board>::Telemetry;
pub type Replies = <Selected as contract::Board>::Replies;
pub type Commands = <Selected as contract::Board>::Commands;

/// Facts of this board. A device record must match them, or the board refuses it.
pub const FACTS: BoardFacts = BoardFacts {
    name: <Selected as contract::Board>::NAME,
    rate_hz: RATE_HZ as f64,
    output: <Selected as contract::Board>::OUTPUT,
    senses: <Selected as contract::Board>::SENSES,
    latency_samples: <Selected as contract::Board>::LATENCY_SAMPLES,
};

/// The check that reads the force output back, or `None` if the board cannot read it.
pub fn output_watch() -> Option<OutputWatch> {
    let swing = <ReadBack as contract::ReadBack>::SWING?;
    OutputWatch::new(FACTS.output, swing).ok()
}

/// Sets the board up. See [`contract::Board::take`].
pub fn take(
    device: <Selected as contract::Board>::Device,
    core: <Selected as contract::Board>::Core,
) -> Board {
    contract::Board::take(device, core)
}

/// Starts encoder, force output and sample timer. `idle` calls it. See [`contract::start`].
pub fn start() {
    forget_floats();
    contract::start::<Encoder, Force, SampleTimer>();
}

/// Sleeps until an interrupt. It first clears SLEEPDEEP (SCR, PM0214 4.4.6), in case a flipped bit has set it. With
/// SLEEPDEEP the chip would go into stop mode (RM0390 and RM0090, 5.3). There no clock runs, and only the independent
/// watchdog could switch off.
#[inline(always)]
pub fn sleep() {
    // SAFETY: the register's reset value; nothing else in this program writes it.
    unsafe { (*cortex_m::peripheral::SCB::PTR).scr.write(0) };
    cortex_m::asm::dsb();
    cortex_m::asm::wfi();
}

/// Ends the floating-point context that `init` began. `idle` needs no such context. If the context stayed, the first
/// float instruction of `link` would save all its registers. That takes some 35 cycles, during which a sample waits.
fn forget_floats() {
    let mut control = control::read();
    control.set_fpca(control::Fpca::NotActive);
    // SAFETY: no float is alive in the caller, which has only just begun. A later one would begin the context anew.
    unsafe { control::write(control) };
}

#[inline(always)]
pub fn off() {
    contract::off::<Force, Enable>();
}

pub fn end(fault: Fault) -> ! {
    <Selected as contract::Board>::end(fault)
}

#[inline(always)]
pub fn is_late() -> bool {
    <SampleTimer as contract::SampleTimer>::is_late()
}

#[inline(always)]
pub fn request_render() {
    <Selected as contract::Board>::request_render();
}

#[inline(always)]
pub fn request_link() {
    <Selected as contract::Board>::request_link();
}

pub fn clock() -> u16 {
    <Halts as contract::DebugHalts>::clock()
}

pub fn log_dropped() -> u32 {
    <Selected as contract::Board>::log_dropped()
}

pub fn turn_encoder(reversed: bool) {
    <Encoder as contract::Encoder>::turn(reversed);
}

#[inline(always)]
pub fn supply_has_dropped() {
    <Supply as contract::Supply>::has_dropped();
}
