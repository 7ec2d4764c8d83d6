//! Positions of the handle at the last samples. Experiments and telemetry need the position of every sample.
//!
//! The task `sample` writes without a check. The number of the sample gives the index. `render` reads the positions
//! later, and `link` reads them for telemetry. A position is overwritten [`LENGTH`] samples later. If `render` were
//! late by so many samples, its output would long have been switched off. After reading, `link` checks that no position
//! was overwritten.

use core::sync::atomic::{AtomicI32, Ordering::Relaxed};

use zwidth::units::Position;

/// Number of samples that are stored. They are enough even if `link` is late by all outputs that can wait in its queue.
const LENGTH: usize = 256;
/// The largest number of samples that `render` goes back.
pub const FOLLOWED: usize = 32;
const _: () = assert!(LENGTH.is_power_of_two());

static COUNTS: [AtomicI32; LENGTH] = [const { AtomicI32::new(0) }; LENGTH];

#[inline(always)]
fn place(sample: u64) -> &'static AtomicI32 {
    #[expect(clippy::cast_possible_truncation, reason = "modulo the length")]
    &COUNTS[sample as usize & (LENGTH - 1)]
}

#[inline(always)]
pub fn note(sample: u64, position: Position) {
    place(sample).store(position.counts(), Relaxed);
}

/// Reads the positions of the samples up to `newest`, oldest first. `newest` must have been noted. The positions are
/// right if [`is_kept`] is true for the oldest position after the reading.
pub fn read(newest: u64, places: &mut [Position]) {
    for (place_of, back) in places.iter_mut().rev().zip(0u64..) {
        let counts = place(newest.wrapping_sub(back)).load(Relaxed);
        *place_of = Position::from_counts(counts);
    }
}

/// Whether the position of the sample `oldest` is still stored. `next` is the number of the next sample.
pub fn is_kept(oldest: u64, next: u64) -> bool {
    next.saturating_sub(oldest) < LENGTH as u64
}

/// Reads the positions of the samples one by one.
pub struct Follower {
    next: u64,
    end: u64,
}

impl Follower {
    /// A follower that has not read any sample.
    pub const fn new() -> Self {
        Self { next: 0, end: 0 }
    }

    /// Allows reading up to `sample`, which must have been noted. Positions that are too old are skipped.
    pub fn follow_to(&mut self, sample: u64) {
        self.end = sample.wrapping_add(1);
        // A flipped bit in `next` must not keep samples away from a hit, which ends by its samples.
        self.next = self.next.max(self.end.saturating_sub(FOLLOWED as u64)).min(self.end);
    }

    /// Flips a bit of the number of the next sample.
    #[cfg(test)]
    pub fn spoil(&mut self, bit: u32) {
        self.next ^= 1 << bit;
    }

    /// Returns the position at the next sample, or `None` after the last sample that [`follow_to`](Self::follow_to) has
    /// allowed.
    pub fn read(&mut self) -> Option<Position> {
        if self.next >= self.end {
            return None;
        }
        let counts = place(self.next).load(Relaxed);
        self.next += 1;
        Some(Position::from_counts(counts))
    }
}
