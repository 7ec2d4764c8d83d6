//! Boards with an STM32F4: one file for each peripheral, and everything that such boards have in common.
//!
//! A board includes its force output (`dac.rs` or `pwm.rs`), and `edges.rs` if it has edge times. The peripherals are
//! fixed:
//! * TIM2: encoder; TIM5: samples; TIM6: halts;
//! * TIM1_CH3: enable; TIM1_BKIN: emergency stop;
//! * TIM8 and DMA2: output watchdog.

mod boot;
pub mod debugger;
pub mod enable;
pub mod encoder;
mod fatal;
pub mod fault_memory;
pub mod flash;
mod interrupts;
pub mod output_watchdog;
pub mod pin;
pub mod read_back;
mod reset;
pub mod sample_timer;
pub mod self_test;
pub mod set_up;
mod stack_guard;
pub mod supply;
pub mod watchdog;

use core::marker::PhantomData;

use embedded_hal::digital::InputPin;
use stm32f4xx_hal::{
    pac::{self, Interrupt},
    rcc::{Config, Rcc, RccExt as _},
};
use zwidth::{
    Output,
    contract::{Board, Drive, EmergencyStop, Encoder, ForceOutput, Link, Parts, RATE_HZ},
    safety::{Fault, ResetCause},
    self_test::Found,
    velocity::Sense,
};

use super::super::{
    common::{logger, rtt},
    off,
};

/// Values and parts that differ from board to board.
pub trait Wiring: Sized {
    const NAME: &'static str;
    /// Core clock, in Hz. The timers of APB1 run at half of it.
    const CORE_HZ: u32;
    /// Level of the supply detector (PLS, three bits). The flash must still work at this voltage.
    const SUPPLY_LEVEL: u8;
    const OUTPUT: Output;
    const ENABLE: pin::BoardPin;
    const STOP: pin::BoardPin;
    /// Number that distinguishes the chip from others (`DEV_ID` of DBGMCU_IDCODE).
    const CHIP: u32;
    /// Level of the brown-out reset for the board's supply (`BOR_LEV` of the option bytes).
    const BROWN_OUT_RESET: u32;
    /// The lowest and the highest code that the force output surely reaches. See
    /// [`ReadBack::SWING`](zwidth::contract::ReadBack::SWING).
    const SWING: Option<[i32; 2]>;
    const SENSES: &'static [Sense];
    const LATENCY_SAMPLES: f64;
    type Force: ForceOutput;
    type Encoder: Encoder;
    type StopInput: InputPin;

    /// Sets the force output to several values and reads them back, with enable off.
    fn test_output() -> Found;

    fn take(device: pac::Peripherals, core: cortex_m::Peripherals) -> Parts<F4<Self>>;
}

pub struct F4<W>(PhantomData<W>);

impl<W: Wiring> Board for F4<W> {
    const NAME: &'static str = W::NAME;
    const OUTPUT: Output = W::OUTPUT;
    const SENSES: &'static [Sense] = W::SENSES;
    const LATENCY_SAMPLES: f64 = W::LATENCY_SAMPLES;

    type Device = pac::Peripherals;
    type Core = cortex_m::Peripherals;
    type Encoder = W::Encoder;
    type SampleTimer = sample_timer::SampleTimer;
    type Force = W::Force;
    type Enable = enable::Enable;
    type StopInput = W::StopInput;
    type Supply = supply::Supply;
    type DebugHalts = debugger::Halts;
    type SelfTest = self_test::SelfTest<W>;
    type Watchdog = watchdog::Watchdog;
    type SetUp = set_up::SetUp;
    type ReadBack = read_back::Converters<W>;
    type OutputWatchdog = output_watchdog::OutputWatchdog;
    type FaultMemory = fault_memory::FaultMemory;
    type Flash = flash::SettingsFlash;
    type Telemetry = rtt::Telemetry;
    type Replies = rtt::Replies;
    type Commands = rtt::Commands;

    fn take(device: pac::Peripherals, core: cortex_m::Peripherals) -> Parts<Self> {
        W::take(device, core)
    }

    // src/main.rs binds `render` and `link` to these two free interrupts.
    #[inline(always)]
    fn request_render() {
        rtic::pend(Interrupt::SPI3);
    }

    #[inline(always)]
    fn request_link() {
        rtic::pend(Interrupt::SPI2);
    }

    fn end(fault: Fault) -> ! {
        fatal::end(fault)
    }

    fn log_dropped() -> u32 {
        logger::dropped()
    }
}

/// The chip after [`Chip::start`]. Its clock is on, TIM1's outputs are off, and the pins are still inputs.
pub struct Chip {
    /// The clock controller. The board's file needs it to set up pins and peripherals.
    pub rcc: Rcc,
    enable: enable::Enable,
    reset_cause: ResetCause,
    link: rtt::Channels,
}

/// The parts that the board's own file sets up before it calls [`Chip::finish`].
pub struct Wires<W: Wiring> {
    /// The force output. It is at zero force.
    pub force: W::Force,
    /// The encoder. Its count is 0, and it does not count yet.
    pub encoder: W::Encoder,
    /// TIM1's break input with its pull-up on. The program can also read this pin.
    pub stop: W::StopInput,
}

/// The peripherals that the board's file does not use. Every board with an STM32F4 passes them to [`Chip::finish`].
pub struct Peripherals {
    pub tim5: pac::TIM5,
    pub tim6: pac::TIM6,
    pub tim8: pac::TIM8,
    pub dma2: pac::DMA2,
    /// Detector of a low supply.
    pub pwr: pac::PWR,
    /// Interrupt of the supply detector.
    pub exti: pac::EXTI,
    pub flash: pac::FLASH,
    pub iwdg: pac::IWDG,
}

impl Chip {
    /// Starts RTT, then the clock that `clock` describes. This clock is made from 8 MHz. They come from a crystal, or
    /// from another chip if `external` is true. If the 8 MHz are missing, or if the chip is wrong, the board reports it
    /// and stops here with all outputs off.
    pub fn start<W: Wiring>(
        rcc: pac::RCC,
        clock: Config,
        external: bool,
        dbgmcu: &pac::DBGMCU,
        mut core: cortex_m::Peripherals,
    ) -> Self {
        let reset_cause = reset::cause(&rcc);
        let mut link = rtt::init();
        boot::expect_chip(dbgmcu, W::CHIP, &mut link.replies);
        boot::expect_clock(&rcc, external, &mut link.replies);
        let mut rcc = rcc.freeze(clock);
        // If the HSE fails, TIM1's break input switches enable off, and an NMI ends the program.
        rcc.cr().modify(|_, w| w.csson().set_bit());
        debugger::set_up(dbgmcu);
        interrupts::set_up(&mut core);
        stack_guard::set_up(&mut core.MPU);
        core.DCB.enable_trace();
        core.DWT.enable_cycle_counter();
        let enable = enable::Enable::new(&mut rcc);
        Self { rcc, enable, reset_cause, link }
    }

    /// Sets up the remaining parts. The independent watchdog runs from here on. The timers do not run yet.
    pub fn finish<W: Wiring>(self, wires: Wires<W>, rest: Peripherals) -> Parts<F4<W>> {
        let Self { mut rcc, enable, reset_cause, link } = self;
        let Peripherals { tim5, tim6, tim8, dma2, pwr, exti, flash, iwdg } = rest;
        let Wires { force, encoder, stop } = wires;
        // A sample must be a whole number of ticks. The timers' clock below comes from the clock tree, not from the
        // board's file.
        const {
            assert!(
                (W::CORE_HZ / 2).is_multiple_of(RATE_HZ),
                "a sample is no whole number of ticks"
            )
        };
        let timer_hz = rcc.clocks.timclk1().raw();
        // TIM1 is set up. The next store locks the set-up of TIM1. From then on TIM1 drives its pins low.
        off();
        let output_watchdog = output_watchdog::OutputWatchdog::new(tim8, &dma2, &mut rcc);
        let supply = supply::Supply::new(pwr, &exti, W::SUPPLY_LEVEL, &mut rcc);
        let memory = fault_memory::FaultMemory::new(&supply, &mut rcc);
        let rtt::Channels { telemetry, replies, commands } = link;
        Parts {
            encoder,
            sample_timer: sample_timer::SampleTimer::new(tim5, timer_hz / RATE_HZ, &mut rcc),
            drive: Drive::new(force, enable),
            output_watchdog,
            set_up: set_up::SetUp::new(W::ENABLE),
            read_back: read_back::Converters::new(&mut rcc),
            stop: EmergencyStop::new(stop),
            supply,
            halts: debugger::Halts::new(tim6, timer_hz, RATE_HZ, &mut rcc),
            self_test: self_test::SelfTest::new(&mut rcc),
            watchdog: watchdog::Watchdog::start(iwdg),
            memory,
            reset_cause,
            settings: flash::SettingsFlash::new(flash),
            link: Link { telemetry, replies, commands },
        }
    }
}
