//! Settings in flash that survive a power cut at any moment.
//!
//! Two sectors hold records of a fixed length, one after another. A save appends a record. The newest valid record is
//! used. If a sector is full, the other sector is erased, and the next record goes there. So the sector with the newest
//! record is never erased. A record is valid only if its last word is its correct CRC. So an incomplete record is
//! ignored. Its slot is not used again before the next erase. If a record has no room for all parameters of an
//! estimator, the remaining parameters are in a further record. The further record is written before the main record,
//! and is valid only together with the main record.
//!
//! A sector of 16 KiB takes 93 saves. Each sector can be erased 10 000 times, which is enough for 1.8 million saves.
//! Writing flash stalls the processor: 16 us per word, and up to 0.5 s per erase. So save only with the force off.
//!
//! The flash may be any [`NorFlash`] of two erase blocks, sector A and sector B. The size of a single write
//! (`WRITE_SIZE`: 4 bytes on an F4, 8 or 16 on other families) must divide a record's 176 bytes.

mod record;

pub use record::{DeviceKey, LAYOUT, Name, RECORD_WORDS, Signs, Stored};

use core::fmt;

use embedded_storage::nor_flash::NorFlash;
use record::{Further, further_of_words, looks_like_a_record};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sector {
    A,
    B,
}

impl Sector {
    const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }

    /// Offset of the sector's first byte.
    #[expect(clippy::cast_possible_truncation, reason = "offsets of flash have 32 bits")]
    const fn start<F: NorFlash>(self) -> u32 {
        match self {
            Self::A => 0,
            Self::B => F::ERASE_SIZE as u32,
        }
    }

    /// Offset of the slot's first byte.
    #[expect(clippy::cast_possible_truncation, reason = "inside the sector")]
    const fn offset<F: NorFlash>(self, slot: usize) -> u32 {
        self.start::<F>() + (slot * RECORD_BYTES) as u32
    }
}

const RECORD_BYTES: usize = size_of::<[u32; RECORD_WORDS]>();

const BLANK: u32 = u32::MAX;

/// Where the loaded settings come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The newest saved settings.
    Newest,
    /// Older saved settings, because a later save is damaged, is incomplete, or belongs to an image with other
    /// estimators.
    Older,
    /// The defaults, because nothing was ever saved. Another program may have written to the flash.
    Empty,
    /// The defaults, because all saved settings are damaged.
    Defaults,
    /// The defaults, because the saved settings are for another device.
    OtherDevice,
    /// The defaults, because this firmware cannot use the saved settings.
    Unusable,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Newest => "newest settings",
            Self::Older => "older settings: the newest cannot be read",
            Self::Empty => "defaults: nothing was saved yet",
            Self::Defaults => "defaults: every saved copy is damaged",
            Self::OtherDevice => "defaults: what was saved is for another device",
            Self::Unusable => "defaults: this firmware cannot take what was saved",
        })
    }
}

/// Settings that were loaded from flash.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loaded {
    /// The saved settings, or the defaults.
    pub stored: Stored,
    /// Source of these settings.
    pub source: Source,
    /// Number of slots in both sectors that hold a damaged or unfinished record, or words of another program.
    pub damaged: u32,
}

/// Result of a save.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Saved {
    /// A new record was written.
    Written,
    /// The newest record already has these settings.
    Unchanged,
}

/// Why a save failed. The settings that were saved before are still there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveError<E> {
    /// The hardware refused or failed.
    Flash(E),
    /// The record reads back differently.
    Verify,
    /// A sector is smaller than one record, or there are fewer than two sectors.
    TooSmall,
}

impl<E> From<E> for SaveError<E> {
    fn from(error: E) -> Self {
        Self::Flash(error)
    }
}

enum Slot {
    Blank,
    Damaged,
    /// Words of another program.
    Foreign,
    Further(u32, Further),
    Record(u32, Stored),
}

/// Number of records that fit into a sector.
fn slots<F: NorFlash>() -> usize {
    const { assert!(RECORD_BYTES.is_multiple_of(F::WRITE_SIZE)) };
    const { assert!(RECORD_BYTES.is_multiple_of(F::READ_SIZE)) };
    F::ERASE_SIZE / RECORD_BYTES
}

/// Reads the words of a slot. Returns `None` if the flash cannot be read.
fn words<F: NorFlash>(flash: &mut F, sector: Sector, slot: usize) -> Option<[u32; RECORD_WORDS]> {
    let mut words = [[0; size_of::<u32>()]; RECORD_WORDS];
    flash.read(sector.offset::<F>(slot), words.as_flattened_mut()).ok()?;
    Some(words.map(u32::from_le_bytes))
}

fn slot<F: NorFlash>(flash: &mut F, sector: Sector, slot: usize) -> Slot {
    match words(flash, sector, slot) {
        Some(words) if words.iter().all(|&word| word == BLANK) => Slot::Blank,
        Some(words) => {
            if let Some((sequence, stored)) = Stored::from_words(&words) {
                Slot::Record(sequence, stored)
            } else if let Some((sequence, further)) = further_of_words(&words) {
                Slot::Further(sequence, further)
            } else if looks_like_a_record(&words) {
                Slot::Damaged
            } else {
                Slot::Foreign
            }
        }
        None => Slot::Damaged,
    }
}

#[derive(Clone, Copy, Default)]
struct Content {
    newest: Option<(u32, Stored)>,
    /// Number of damaged slots. `damaged_behind` counts only those after the newest record.
    damaged: u32,
    damaged_behind: u32,
    /// Number of damaged slots that once held a record.
    records: u32,
    /// The first free slot. No slot from here on was written since the last erase.
    free: usize,
}

fn scan<F: NorFlash>(flash: &mut F, sector: Sector) -> Content {
    let mut content = Content::default();
    let mut before = None;
    for n in 0..slots::<F>() {
        let (mut found, of_before) = (slot(flash, sector, n), before.take());
        // A further record is used only together with the main record after it.
        if let Slot::Further(sequence, further) = found {
            before = Some((sequence, further));
        }
        if let Slot::Record(sequence, stored) = &mut found
            && stored.has_further()
        {
            match of_before {
                Some((same, further)) if same == *sequence => {
                    *stored = stored.with_further(&further);
                    content.damaged = content.damaged.saturating_sub(1);
                    content.damaged_behind = content.damaged_behind.saturating_sub(1);
                    content.records = content.records.saturating_sub(1);
                }
                _ => found = Slot::Damaged,
            }
        }
        match found {
            Slot::Blank => continue,
            Slot::Damaged | Slot::Foreign | Slot::Further(..) => {
                content.records += u32::from(!matches!(found, Slot::Foreign));
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

/// Returns the sector with the newest record, this record, and the contents of both sectors. The sector of the record
/// comes first.
fn newest<F: NorFlash>(flash: &mut F) -> (Sector, Option<(u32, Stored)>, [Content; 2]) {
    let (a, b) = (scan(flash, Sector::A), scan(flash, Sector::B));
    match (a.newest, b.newest) {
        (Some((first, _)), Some((second, stored))) if second > first => {
            (Sector::B, Some((second, stored)), [b, a])
        }
        (None, Some(found)) => (Sector::B, Some(found), [b, a]),
        (found, _) => (Sector::A, found, [a, b]),
    }
}

/// Number of slots that were damaged after the newest record was written. A power cut during a save or an erase does
/// that.
///
/// If the other sector has valid records, this sector was filled before the active sector, so its damage is old. If the
/// other sector has only words of another program, it was not in use yet.
fn damaged_later(active: &Content, other: &Content) -> u32 {
    active.damaged_behind + if is_half_erased(other) { other.records } else { 0 }
}

/// Whether the other sector must be erased before use, because its erase was cut short or another program has written
/// to it. The active sector may still have room for a smaller record.
fn is_half_erased(other: &Content) -> bool {
    other.newest.is_none() && other.damaged > 0
}

/// Loads the newest valid settings, or `defaults` if there are none. The result says where they come from.
pub fn load<F: NorFlash>(flash: &mut F, defaults: Stored) -> Loaded {
    let (_, found, [active, other]) = newest(flash);
    let damaged = active.damaged + other.damaged;
    let later = damaged_later(&active, &other);
    let (stored, source) = match found {
        Some((_, stored)) if stored.device != defaults.device => (defaults, Source::OtherDevice),
        Some((_, stored)) if has_nan(&stored) => (defaults, Source::Unusable),
        Some((_, stored)) if later == 0 => (stored, Source::Newest),
        Some((_, stored)) => (stored, Source::Older),
        None if active.records + other.records == 0 => (defaults, Source::Empty),
        None => (defaults, Source::Defaults),
    };
    Loaded { stored, source, damaged }
}

/// Whether a value is NaN. A NaN cannot come from the console. It is not saved, because it would not equal the copy
/// that is read back.
fn has_nan(stored: &Stored) -> bool {
    let same = *stored;
    same != *stored
}

/// Appends a record with `stored`. If power is cut at any moment, flash has either the old settings or `stored`.
///
/// # Errors
/// The hardware failed, or the record reads back differently. The settings from before are still there.
pub fn save<F: NorFlash>(flash: &mut F, stored: &Stored) -> Result<Saved, SaveError<F::Error>> {
    let count = slots::<F>();
    let needed = 1 + usize::from(stored.has_further());
    if count < needed || flash.capacity() < 2 * F::ERASE_SIZE {
        return Err(SaveError::TooSmall);
    }
    let (active, found, [content, other]) = newest(flash);
    let sequence = match found {
        Some((sequence, newest))
            if damaged_later(&content, &other) == 0
                && newest.to_words(sequence) == stored.to_words(sequence)
                && newest.further_to_words(sequence) == stored.further_to_words(sequence) =>
        {
            return Ok(Saved::Unchanged);
        }
        Some((sequence, _)) => sequence.saturating_add(1),
        None => 1,
    };
    let end = Sector::B.start::<F>();
    let (sector, slot) = if found.is_none() && content.damaged + other.damaged > 0 {
        // There is no valid record, so both sectors are erased. Old words could be taken for a newer record.
        [0, end].into_iter().try_for_each(|start| flash.erase(start, start + end))?;
        (Sector::A, 0)
    } else if content.free + needed <= count && !is_half_erased(&other) {
        (active, content.free)
    } else {
        let sector = active.other();
        flash.erase(sector.start::<F>(), sector.start::<F>() + end)?;
        (sector, 0)
    };
    let further = stored.further_to_words(sequence);
    for (n, words_now) in further.into_iter().chain([stored.to_words(sequence)]).enumerate() {
        let bytes = words_now.map(u32::to_le_bytes);
        flash.write(sector.offset::<F>(slot + n), bytes.as_flattened())?;
        if words(flash, sector, slot + n) != Some(words_now) {
            return Err(SaveError::Verify);
        }
    }
    Ok(Saved::Written)
}

#[cfg(test)]
mod tests;
