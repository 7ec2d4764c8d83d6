//! Settings in flash that survive a power cut at any moment.
//!
//! Two sectors hold fixed-length records one after another; a save appends. The newest valid record
//! wins. When a sector is full the other one is erased and the next record goes there, so the
//! newest record is never in the sector that is being erased. A record counts only when its CRC
//! (its last word) is right, so one that was cut short does not exist, and its place is not used
//! again.
//!
//! A sector of 16 KiB takes 93 saves; 10 000 erases make that 1.8 million. Writing flash stalls the
//! processor (16 us a word, up to 0.8 s an erase): save only with the force off.

mod record;

pub use record::{DeviceKey, RECORD_WORDS, Signs, Stored};

use core::fmt;

/// One of the two sectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sector {
    /// The first.
    A,
    /// The second.
    B,
}

impl Sector {
    const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// Two flash sectors of equal size. Erased words are [`BLANK`]; programming turns bits from 1 to 0
/// only.
pub trait Flash {
    /// Why an operation failed.
    type Error;

    /// Words in each sector.
    fn sector_words(&self) -> usize;

    /// The word at that place; [`BLANK`] beyond the end.
    fn read(&self, sector: Sector, word: usize) -> u32;

    /// Programs one erased word.
    ///
    /// # Errors
    /// The hardware refused or failed.
    fn program(&mut self, sector: Sector, word: usize, value: u32) -> Result<(), Self::Error>;

    /// Erases a sector.
    ///
    /// # Errors
    /// The hardware refused or failed.
    fn erase(&mut self, sector: Sector) -> Result<(), Self::Error>;
}

/// An erased word.
pub const BLANK: u32 = u32::MAX;

/// Which settings were loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The newest that were saved.
    Newest,
    /// Older ones: what was saved after them is damaged, or the save was cut short.
    Older,
    /// The defaults, because nothing was ever saved.
    Empty,
    /// The defaults, because all that was saved is damaged.
    Defaults,
    /// The defaults, because what was saved is for another device.
    OtherDevice,
    /// The defaults, because this firmware cannot take what was saved.
    Unusable,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Newest => "newest settings",
            Self::Older => "older settings: the newest copy is damaged",
            Self::Empty => "defaults: nothing was saved yet",
            Self::Defaults => "defaults: every saved copy is damaged",
            Self::OtherDevice => "defaults: what was saved is for another device",
            Self::Unusable => "defaults: this firmware cannot take what was saved",
        })
    }
}

/// Settings out of flash.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loaded {
    /// The settings.
    pub stored: Stored,
    /// Which they are.
    pub source: Source,
    /// Damaged or unfinished records in both sectors.
    pub damaged: u32,
}

/// What a save did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Saved {
    /// A new record was written.
    Written,
    /// The newest record says the same already.
    Unchanged,
}

/// Why a save failed. What was saved before is still there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveError<E> {
    /// The hardware refused or failed.
    Flash(E),
    /// The record does not read back as it was written.
    Verify,
    /// A sector is smaller than one record.
    TooSmall,
}

impl<E> From<E> for SaveError<E> {
    fn from(error: E) -> Self {
        Self::Flash(error)
    }
}

/// What a slot holds.
enum Slot {
    Blank,
    Damaged,
    Record(u32, Stored),
}

fn slots<F: Flash>(flash: &F) -> usize {
    flash.sector_words() / RECORD_WORDS
}

fn words<F: Flash>(flash: &F, sector: Sector, slot: usize) -> [u32; RECORD_WORDS] {
    core::array::from_fn(|n| flash.read(sector, slot * RECORD_WORDS + n))
}

fn slot<F: Flash>(flash: &F, sector: Sector, slot: usize) -> Slot {
    let words = words(flash, sector, slot);
    if words.iter().all(|&word| word == BLANK) {
        return Slot::Blank;
    }
    Stored::from_words(&words)
        .map_or(Slot::Damaged, |(sequence, stored)| Slot::Record(sequence, stored))
}

/// What a sector holds.
#[derive(Clone, Copy, Default)]
struct Content {
    newest: Option<(u32, Stored)>,
    /// Damaged slots, and those of them behind the newest record.
    damaged: u32,
    damaged_behind: u32,
    /// First slot behind everything that was ever written.
    free: usize,
}

fn scan<F: Flash>(flash: &F, sector: Sector) -> Content {
    let mut content = Content::default();
    for n in 0..slots(flash) {
        match slot(flash, sector, n) {
            Slot::Blank => continue,
            Slot::Damaged => {
                content.damaged += 1;
                content.damaged_behind += 1;
            }
            Slot::Record(sequence, stored) => {
                if content.newest.is_none_or(|(newest, _)| sequence >= newest) {
                    content.newest = Some((sequence, stored));
                    content.damaged_behind = 0;
                }
            }
        }
        content.free = n + 1;
    }
    content
}

/// The sector with the newest record, that record, and what both sectors hold (that one first).
fn newest<F: Flash>(flash: &F) -> (Sector, Option<(u32, Stored)>, [Content; 2]) {
    let (a, b) = (scan(flash, Sector::A), scan(flash, Sector::B));
    match (a.newest, b.newest) {
        (Some((first, _)), Some((second, stored))) if second > first => {
            (Sector::B, Some((second, stored)), [b, a])
        }
        (None, Some(found)) => (Sector::B, Some(found), [b, a]),
        (found, _) => (Sector::A, found, [a, b]),
    }
}

/// The newest settings that are whole, else `defaults`; and says which.
pub fn load<F: Flash>(flash: &F, defaults: Stored) -> Loaded {
    let (_, found, [active, other]) = newest(flash);
    let damaged = active.damaged + other.damaged;
    // A sector with valid records was filled before the active one, so its damage is old. Without
    // any, its damage is a save or an erase that came later and was cut short.
    let later = active.damaged_behind + if other.newest.is_none() { other.damaged } else { 0 };
    let (stored, source) = match found {
        Some((_, stored)) if stored.device != defaults.device => (defaults, Source::OtherDevice),
        Some((_, stored)) if later == 0 => (stored, Source::Newest),
        Some((_, stored)) => (stored, Source::Older),
        None if damaged == 0 => (defaults, Source::Empty),
        None => (defaults, Source::Defaults),
    };
    Loaded { stored, source, damaged }
}

/// Appends `stored`. A power cut at any moment leaves either what was saved before or `stored`.
///
/// # Errors
/// The hardware failed, or the record does not read back; what was saved before is still there.
pub fn save<F: Flash>(flash: &mut F, stored: &Stored) -> Result<Saved, SaveError<F::Error>> {
    let count = slots(flash);
    if count == 0 {
        return Err(SaveError::TooSmall);
    }
    let (active, found, [content, _]) = newest(flash);
    let sequence = match found {
        Some((sequence, newest))
            if content.damaged_behind == 0
                && newest.to_words(sequence) == stored.to_words(sequence) =>
        {
            return Ok(Saved::Unchanged);
        }
        Some((sequence, _)) => sequence.saturating_add(1),
        None => 1,
    };
    let (sector, slot) = if content.free < count {
        (active, content.free)
    } else {
        // Without any valid record there is nothing to keep, and either sector will do.
        let other = active.other();
        flash.erase(other)?;
        (other, 0)
    };
    let words_now = stored.to_words(sequence);
    for (n, &word) in words_now.iter().enumerate() {
        flash.program(sector, slot * RECORD_WORDS + n, word)?;
    }
    if words(flash, sector, slot) == words_now {
        Ok(Saved::Written)
    } else {
        Err(SaveError::Verify)
    }
}

#[cfg(test)]
mod tests;
