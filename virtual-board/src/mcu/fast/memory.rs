//! Flash and RAM as the core sees them, without the bus.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use rsemu::core::{
    space::RamStore,
    value::{Endian, Width},
};

use super::super::{FLASH, RAM, RAM_BYTES};

/// The range of RAM that the protection unit refuses, as its first address and its size.
pub(super) type Guard = (u32, u32);

/// Memory that can be accessed without the bus. `None` as a result means that the emulator must run the access.
pub(super) struct Memory<'a> {
    pub(super) ram: &'a RamStore,
    pub(super) flash: &'a [u8],
    pub(super) guard: Guard,
    /// For each word of RAM, whether it was read. `None` if nobody needs these notes.
    pub(super) reads: Option<&'a [AtomicBool]>,
}

impl Memory<'_> {
    /// Loads `bytes` bytes at `address`, which must be aligned to that size.
    #[inline(always)]
    pub(super) fn load(&self, address: u32, bytes: u32) -> Option<u32> {
        if address & (bytes - 1) != 0 {
            return None;
        }
        let at = address.wrapping_sub(RAM);
        if at < RAM_BYTES {
            if self.is_guarded(address) {
                return None;
            }
            if let Some(word) = self.reads.and_then(|words| words.get(at as usize / 4)) {
                word.store(true, Relaxed);
            }
            let value = self.ram.read_value(at.into(), width(bytes), Endian::Little).ok()?;
            return u32::try_from(value).ok();
        }
        let at = address.wrapping_sub(FLASH) as usize;
        match bytes {
            1 => self.flash.get(at).map(|byte| u32::from(*byte)),
            2 => self.flash.get(at..)?.first_chunk().map(|two| u16::from_le_bytes(*two).into()),
            _ => self.flash.get(at..)?.first_chunk().map(|four| u32::from_le_bytes(*four)),
        }
    }

    #[inline(always)]
    pub(super) fn store(&self, address: u32, bytes: u32, value: u32) -> Option<()> {
        let at = address.wrapping_sub(RAM);
        if address & (bytes - 1) != 0 || at >= RAM_BYTES || self.is_guarded(address) {
            return None;
        }
        self.ram.write_value(at.into(), width(bytes), value.into(), Endian::Little).ok()
    }

    /// Checks that `words` words from `address` on can be loaded and stored here.
    pub(super) fn holds(&self, address: u32, words: u32) -> Option<()> {
        let (at, bytes) = (address.wrapping_sub(RAM), 4 * words);
        let (first, length) = self.guard;
        let inside = at < RAM_BYTES && bytes <= RAM_BYTES - at && address & 3 == 0;
        let guarded = length > 0
            && address < first.saturating_add(length)
            && first < address.saturating_add(bytes);
        (inside && !guarded).then_some(())
    }

    #[inline(always)]
    fn is_guarded(&self, address: u32) -> bool {
        let (first, length) = self.guard;
        address.wrapping_sub(first) < length
    }
}

#[inline(always)]
fn width(bytes: u32) -> Width {
    match bytes {
        1 => Width::U8,
        2 => Width::U16,
        _ => Width::U32,
    }
}
