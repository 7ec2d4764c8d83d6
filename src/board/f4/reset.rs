//! Finds the cause of the last reset from the reset flags of the RCC.

use stm32f4xx_hal::pac;
use zwidth::safety::ResetCause;

/// Reads the flags of the last reset, and clears them. Otherwise the next start would also see the old flags.
pub(in crate::board) fn cause(rcc: &pac::RCC) -> ResetCause {
    let flags = rcc.csr().read();
    // Several flags can be set at once. Each cause also pulls the reset pin, and a loss of power sets further flags. So
    // the order of the checks matters.
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
