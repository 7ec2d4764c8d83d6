//! The independent watchdog. When the tasks stop running, it resets the chip, and a reset switches all outputs off.
//!
//! It runs from its own oscillator, nominally 32 kHz. Between chips and temperatures this is 17 to 47 kHz. The watchdog
//! also runs while a debugger has the core halted.

use stm32f4xx_hal::pac;
use zwidth::contract;

/// Nominal time from the last feeding to the reset. Because the oscillator's frequency varies, the real time is 34 to
/// 94 ms.
const TIMEOUT_MS: u16 = 50;
/// Nominal time until the reset during an erase of a settings sector. The erase stalls the core for up to 0.5 s.
const PATIENT_MS: u16 = 2_000;

/// Code of prescaler 32. With the nominal 32 kHz a tick is 1 ms.
const PRESCALER: u16 = 0b011;

/// The watchdog, which is started already.
pub struct Watchdog(());

fn registers() -> &'static pac::iwdg::RegisterBlock {
    // SAFETY: the address is the watchdog's. Each use is a sequence of stores that the key register protects. If two
    // tasks use the watchdog at once, both only reload its counter.
    unsafe { &*pac::IWDG::ptr() }
}

/// Sets the time until the reset. The new time is used after at most 6 cycles of the watchdog's oscillator, 0.2 ms.
fn set_timeout(ms: u16) {
    let iwdg = registers();
    // SAFETY: documented keys and values.
    unsafe {
        iwdg.kr().write(|w| w.bits(0x5555));
        iwdg.pr().write(|w| w.bits(PRESCALER));
        iwdg.rlr().write(|w| w.bits(ms));
        while iwdg.sr().read().bits() != 0 {}
        iwdg.kr().write(|w| w.bits(0xAAAA));
    }
}

impl Watchdog {
    /// Starts the watchdog. Only a reset stops it.
    pub fn start(_: pac::IWDG) -> Self {
        // SAFETY: a documented key; it also starts the watchdog's clock.
        registers().kr().write(|w| unsafe { w.bits(0xCCCC) });
        set_timeout(TIMEOUT_MS);
        Self(())
    }
}

impl contract::Watchdog for Watchdog {
    fn feed(&mut self) {
        let iwdg = registers();
        // While flash is written, the watchdog has a longer time. This task does not run then, so another time is an
        // error here.
        if iwdg.rlr().read().bits() != TIMEOUT_MS || iwdg.pr().read().bits() != PRESCALER {
            set_timeout(TIMEOUT_MS);
        }
        renew();
    }
}

/// Restarts the watchdog's time. `idle` calls this function. `link` calls it between the parts of long work with the
/// force off.
pub(in crate::board) fn renew() {
    // SAFETY: a documented key.
    registers().kr().write(|w| unsafe { w.bits(0xAAAA) });
}

/// Gives the watchdog more time during `work`, which stalls the core.
pub(in crate::board) fn with_patience<R>(work: impl FnOnce() -> R) -> R {
    set_timeout(PATIENT_MS);
    let result = work();
    set_timeout(TIMEOUT_MS);
    result
}
