//! The independent watchdog: a reset, hence outputs off, when the tasks stop running.
//!
//! It runs from its own 32 kHz oscillator (17 to 47 kHz over parts and temperature) and keeps
//! running while a debugger has the core halted.

use stm32f4xx_hal::{pac, prelude::*, watchdog::IndependentWatchdog};

/// Time without feeding until the reset, nominal; 34 to 94 ms over the oscillator's spread.
const TIMEOUT_MS: u32 = 50;
/// The same around an erase of a settings sector, which stalls the core for up to 0.8 s.
const PATIENT_MS: u32 = 2_000;

/// The watchdog, started.
pub struct Watchdog(IndependentWatchdog);

impl Watchdog {
    /// Starts it; nothing but a reset stops it.
    pub fn start(iwdg: pac::IWDG) -> Self {
        let mut watchdog = IndependentWatchdog::new(iwdg);
        watchdog.start(TIMEOUT_MS.millis());
        Self(watchdog)
    }

    /// All tasks are alive.
    pub fn feed(&mut self) {
        self.0.feed();
    }
}
