//! The supply supervisor: the programmable voltage detector (PVD), at a level that the board chooses.
//!
//! The detector pends an interrupt (EXTI line 16). Its handler switches off at once and notes the drop. A check at each
//! output is not enough: between two outputs the supply may fall below the voltage that the flash needs, or fall and
//! recover.

use core::sync::atomic::{AtomicBool, Ordering::Relaxed};

use stm32f4xx_hal::{
    pac,
    rcc::{Enable, Rcc},
};
use zwidth::contract;

/// Whether the detector has found a low supply since the last call of `is_low`.
static DROPPED: AtomicBool = AtomicBool::new(false);

/// Bit of the detector's line in EXTI.
const LINE: u32 = 1 << 16;

pub struct Supply(pac::PWR);

impl Supply {
    /// Switches the detector on, at this level (PLS, three bits).
    pub fn new(pwr: pac::PWR, exti: &pac::EXTI, level: u8, rcc: &mut Rcc) -> Self {
        pac::PWR::enable(rcc);
        // SAFETY: all values of the field are documented.
        pwr.cr().modify(|_, w| unsafe { w.pls().bits(level & 0b111).pvde().set_bit() });
        // The line requests an interrupt at a rising edge, because the detector's output rises when the supply falls.
        // SAFETY: a documented line.
        unsafe {
            exti.rtsr().modify(|r, w| w.bits(r.bits() | LINE));
            exti.imr().modify(|r, w| w.bits(r.bits() | LINE));
        }
        Self(pwr)
    }

    /// Opens the backup RAM, which a reset closes, for writing.
    pub(in crate::board) fn open_backup(&self) {
        self.0.cr().modify(|_, w| w.dbp().set_bit());
    }
}

impl contract::Supply for Supply {
    #[inline(always)]
    fn has_dropped() {
        super::off();
        DROPPED.store(true, Relaxed);
        // SAFETY: writing one clears the request of this line; nothing else writes this register.
        unsafe { (*pac::EXTI::ptr()).pr().write(|w| w.bits(LINE)) };
    }

    #[inline(always)]
    fn is_low(&mut self) -> bool {
        let dropped = DROPPED.load(Relaxed);
        if dropped {
            DROPPED.store(false, Relaxed);
        }
        dropped || self.0.csr().read().pvdo().bit_is_set()
    }
}
