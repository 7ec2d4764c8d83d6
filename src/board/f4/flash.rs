//! Flash sectors 1 and 2, 16 KiB each, for the settings records of [`zwidth::store`].
//!
//! The core stalls while flash is erased or programmed (16 us a word, up to 0.8 s an erase): only
//! with the force off, and with more time until the watchdog's reset. Not through the HAL's driver,
//! which panics where this one returns an error.

use core::ptr;

use stm32f4xx_hal::pac;
use zwidth::store::{BLANK, Flash, Sector};

use super::watchdog;

const FLASH: usize = 0x0800_0000;
const SECTOR_BYTES: usize = 16 * 1024;
/// Bits of CR: program, sector erase, sector number, 32 bits at a time, start, lock.
const PG: u32 = 1;
const SER: u32 = 1 << 1;
const SNB: u32 = 3;
const PSIZE_32: u32 = 2 << 8;
const STRT: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;
/// Bits of SR: end of operation and all errors (cleared by writing them), busy.
const FLAGS: u32 = 0xF3;
const ERRORS: u32 = 0xF2;
const BSY: u32 = 1 << 16;

/// The two sectors.
pub struct SettingsFlash(pac::FLASH);

/// What the flash controller did not like, as the bits of its status register.
#[derive(Clone, Copy, Debug)]
pub struct FlashError(pub u32);

const fn number(sector: Sector) -> u32 {
    match sector {
        Sector::A => 1,
        Sector::B => 2,
    }
}

/// Address of a word.
fn address(sector: Sector, word: usize) -> *mut u32 {
    let sector = if matches!(sector, Sector::A) { 1 } else { 2 };
    ptr::with_exposed_provenance_mut(FLASH + sector * SECTOR_BYTES + word * size_of::<u32>())
}

impl SettingsFlash {
    pub(in crate::board) fn new(flash: pac::FLASH) -> Self {
        Self(flash)
    }

    /// Runs `work` with the controller unlocked and set to `mode`.
    fn with_mode(&mut self, mode: u32, work: impl FnOnce(&pac::FLASH)) -> Result<(), FlashError> {
        let flash = &self.0;
        // SAFETY: documented keys and values; a wrong sequence leaves the controller locked.
        unsafe {
            flash.keyr().write(|w| w.bits(0x4567_0123));
            flash.keyr().write(|w| w.bits(0xCDEF_89AB));
            flash.sr().write(|w| w.bits(FLAGS));
            flash.cr().write(|w| w.bits(PSIZE_32 | mode));
        }
        watchdog::with_patience(|| {
            work(flash);
            while flash.sr().read().bits() & BSY != 0 {}
        });
        let errors = flash.sr().read().bits() & ERRORS;
        // SAFETY: a documented value.
        unsafe { flash.cr().write(|w| w.bits(LOCK)) };
        if errors == 0 { Ok(()) } else { Err(FlashError(errors)) }
    }
}

impl Flash for SettingsFlash {
    type Error = FlashError;

    fn sector_words(&self) -> usize {
        SECTOR_BYTES / size_of::<u32>()
    }

    fn read(&self, sector: Sector, word: usize) -> u32 {
        if word >= self.sector_words() {
            return BLANK;
        }
        // SAFETY: inside sector 1 or 2, which hold no code; aligned; any word is valid. Volatile,
        // because programming changes it.
        unsafe { ptr::read_volatile(address(sector, word)) }
    }

    fn program(&mut self, sector: Sector, word: usize, value: u32) -> Result<(), FlashError> {
        if word >= self.sector_words() {
            return Err(FlashError(0));
        }
        self.with_mode(PG, |_| {
            // SAFETY: as in `read`; the controller takes the store and programs the word.
            unsafe { ptr::write_volatile(address(sector, word), value) }
        })
    }

    fn erase(&mut self, sector: Sector) -> Result<(), FlashError> {
        let mode = SER | number(sector) << SNB;
        let result = self.with_mode(mode, |flash| {
            // SAFETY: a documented value.
            unsafe { flash.cr().write(|w| w.bits(PSIZE_32 | mode | STRT)) };
        });
        // The caches may hold what was erased: reset them while they are off.
        let flash = &self.0;
        flash.acr().modify(|_, w| w.dcen().clear_bit().icen().clear_bit());
        flash.acr().modify(|_, w| w.dcrst().set_bit().icrst().set_bit());
        flash.acr().modify(|_, w| w.dcrst().clear_bit().icrst().clear_bit());
        flash.acr().modify(|_, w| w.dcen().set_bit().icen().set_bit());
        result
    }
}
