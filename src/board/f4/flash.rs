//! Flash sectors 1 and 2, 16 KiB each, for the settings records of [`zwidth::store`].
//!
//! The core stalls while flash is programmed or erased. A word takes 16 us to program, and a sector up to 0.5 s to
//! erase. So both happen only with the force off, and the watchdog gets more time. The HAL's driver is not used: it
//! panics where this driver returns an error.

use core::ptr;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, ReadNorFlash, check_erase, check_read, check_write,
};
use stm32f4xx_hal::pac;
use zwidth::contract::FlashError;

use super::watchdog;

const FLASH: usize = 0x0800_0000;
const SECTOR_BYTES: usize = 16 * 1024;
const WORD_BYTES: usize = size_of::<u32>();
/// Bits of CR, in this order: program, erase a sector, the sector's number, program 32 bits at a time, start, lock.
const PG: u32 = 1;
const SER: u32 = 1 << 1;
const SNB: u32 = 3;
const PSIZE_32: u32 = 2 << 8;
const STRT: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;
/// Bits of SR. `FLAGS` are the end of an operation and all errors; a write of 1 clears them. `ERRORS` are only the
/// errors. `BSY` says that the controller is busy.
const FLAGS: u32 = 0xF3;
const ERRORS: u32 = 0xF2;
const BSY: u32 = 1 << 16;

pub struct SettingsFlash(pac::FLASH);

/// Address of the word at this offset from the beginning of sector 1. [`check_read`] or a similar check must have
/// accepted the offset.
fn word_at(offset: u32) -> *mut u32 {
    ptr::with_exposed_provenance_mut(FLASH + SECTOR_BYTES + offset as usize)
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

    fn erase_sector(&mut self, number: u32) -> Result<(), FlashError> {
        let mode = SER | number << SNB;
        let result = self.with_mode(mode, |flash| {
            // SAFETY: a documented value.
            unsafe { flash.cr().write(|w| w.bits(PSIZE_32 | mode | STRT)) };
        });
        // The caches may contain data from before the erase. They must be off when they are reset.
        let flash = &self.0;
        flash.acr().modify(|_, w| w.dcen().clear_bit().icen().clear_bit());
        flash.acr().modify(|_, w| w.dcrst().set_bit().icrst().set_bit());
        flash.acr().modify(|_, w| w.dcrst().clear_bit().icrst().clear_bit());
        flash.acr().modify(|_, w| w.dcen().set_bit().icen().set_bit());
        result
    }
}

impl ErrorType for SettingsFlash {
    type Error = FlashError;
}

impl ReadNorFlash for SettingsFlash {
    const READ_SIZE: usize = WORD_BYTES;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        check_read(self, offset, bytes.len())?;
        let (words, _) = bytes.as_chunks_mut::<WORD_BYTES>();
        for (word, at) in words.iter_mut().zip((offset..).step_by(WORD_BYTES)) {
            // SAFETY: inside sector 1 or 2, which hold no code; aligned; any word is valid. Volatile,
            // because programming changes it.
            *word = unsafe { ptr::read_volatile(word_at(at)) }.to_le_bytes();
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * SECTOR_BYTES
    }
}

impl NorFlash for SettingsFlash {
    const WRITE_SIZE: usize = WORD_BYTES;
    const ERASE_SIZE: usize = SECTOR_BYTES;

    /// Writes the bytes word by word. Before each word the watchdog's time starts again.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        check_write(self, offset, bytes.len())?;
        let (words, _) = bytes.as_chunks::<WORD_BYTES>();
        for (word, at) in words.iter().zip((offset..).step_by(WORD_BYTES)) {
            self.with_mode(PG, |_| {
                // SAFETY: as in `read`; the controller takes the store and programs the word.
                unsafe { ptr::write_volatile(word_at(at), u32::from_le_bytes(*word)) }
            })?;
        }
        Ok(())
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        check_erase(self, from, to)?;
        // Sectors 1 and 2 of the chip.
        let sectors = [1, 2].into_iter().zip([0, SECTOR_BYTES]);
        let mut wanted = sectors.filter(|(_, start)| (from as usize..to as usize).contains(start));
        wanted.try_for_each(|(number, _)| self.erase_sector(number))
    }
}
