//! Why the program starts: the reset flags of the RCC.

use stm32f4xx_hal::pac;
use zwidth::safety::ResetCause;

/// Reads the flags and clears them for the next time.
pub(in crate::board) fn cause(rcc: &pac::RCC) -> ResetCause {
    let flags = rcc.csr().read();
    // Several flags are set at once: each cause also pulls the reset pin, and a loss of power sets further flags.
    let cause = if flags.wdgrstf().bit_is_set() || flags.wwdgrstf().bit_is_set() {
        ResetCause::Watchdog
    } else if flags.sftrstf().bit_is_set() {
        ResetCause::Software
    } else if flags.porrstf().bit_is_set() || flags.borrstf().bit_is_set() {
        ResetCause::Power
    } else {
        ResetCause::Pin
    };
    rcc.csr().modify(|_, w| w.rmvf().set_bit());
    cause
}
