//! The supply supervisor: the programmable voltage detector (PVD), its level chosen by the board.

use stm32f4xx_hal::{
    pac,
    rcc::{Enable, Rcc},
};

/// The detector.
pub struct Supply(pac::PWR);

impl Supply {
    /// Detector on, at that level (PLS, three bits).
    pub fn new(pwr: pac::PWR, level: u8, rcc: &mut Rcc) -> Self {
        pac::PWR::enable(rcc);
        // SAFETY: all values of the field are documented.
        pwr.cr().modify(|_, w| unsafe { w.pls().bits(level & 0b111).pvde().set_bit() });
        Self(pwr)
    }

    /// Opens the backup RAM, which a reset closes, for writing.
    pub(super) fn open_backup(&self) {
        self.0.cr().modify(|_, w| w.dbp().set_bit());
    }

    /// The supply is below the threshold.
    #[inline(always)]
    pub fn is_low(&self) -> bool {
        self.0.csr().read().pvdo().bit_is_set()
    }
}
