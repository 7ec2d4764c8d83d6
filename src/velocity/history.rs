//! The last differences of the position, for estimators that use a window.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::kept::{Bytes, Kept};
use crate::units::Velocity;

/// Longest window, in samples.
pub const WINDOW_MAX: u32 = 64;

pub(super) const LENGTH: usize = WINDOW_MAX as usize;

/// The ring for the windows of most estimators.
pub(super) type History = Ring<LENGTH>;

/// The last `LENGTH` differences, in counts per sample, saturated to the range of [`Velocity`]. `LENGTH` is a power of
/// two up to 256.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ring<const LENGTH: usize> {
    differences: [i16; LENGTH],
    /// Sum of all values in `differences`. A comparison with it finds a flipped bit.
    sum: u32,
    /// Index of the newest difference, modulo `LENGTH`.
    newest: u8,
}

impl<const LENGTH: usize> Ring<LENGTH> {
    pub(super) const REST: Self = Self { differences: [0; LENGTH], sum: 0, newest: 0 };

    #[expect(clippy::cast_possible_truncation, reason = "at most 255")]
    const ALL: u8 = if LENGTH > 255 { 255 } else { LENGTH as u8 };

    pub(super) fn push(&mut self, difference: i32) {
        self.newest = self.newest.wrapping_add(1);
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 16 bits")]
        let difference = difference.clamp(-Velocity::LIMIT, Velocity::LIMIT) as i16;
        if let Some(place) = self.differences.get_mut(usize::from(self.newest) % LENGTH) {
            self.sum = self.sum.wrapping_sub(place.sum()).wrapping_add(difference.sum());
            *place = difference;
        }
    }

    /// The difference `age` samples before the newest one.
    #[inline]
    pub(super) fn back(&self, age: u8) -> i32 {
        let at = usize::from(self.newest.wrapping_sub(age)) % LENGTH;
        self.differences.get(at).copied().map_or(0, i32::from)
    }

    /// Writes the last `window` differences, oldest first.
    pub(super) fn put_last(&self, window: u8, bytes: &mut Bytes<'_>) {
        for age in (0..window).rev() {
            #[expect(clippy::cast_possible_truncation, reason = "it was put in as 16 bits")]
            (self.back(age) as i16).put(bytes);
        }
    }

    /// Reads the differences that [`put_last`](Self::put_last) has written into a new ring.
    pub(super) fn take_last(window: u8, rest: &mut &[u8]) -> Option<Self> {
        let mut ring = Self::REST;
        for _ in 0..window {
            ring.push(i16::take(rest)?.into());
        }
        Some(ring)
    }

    /// Makes the ring as it is after many samples at this velocity. The sum of its differences differs from the motion
    /// at this velocity by at most a count.
    pub(super) fn at(velocity: Velocity) -> Self {
        const FRACTION: i32 = (1 << Velocity::FRACTION_BITS) - 1;
        let bits = velocity.bits();
        let mut state = Self::REST;
        let mut rest = 0;
        for place in &mut state.differences {
            rest += bits & FRACTION;
            #[expect(clippy::cast_possible_truncation, reason = "Velocity is within +-32767")]
            let difference =
                ((bits >> Velocity::FRACTION_BITS) + (rest >> Velocity::FRACTION_BITS)) as i16;
            rest &= FRACTION;
            *place = difference;
        }
        // Each difference includes what the rounding of the earlier ones has left over.
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_possible_wrap,
            reason = "at most 256 times 15 bits"
        )]
        let sum = ((i64::from(bits) * LENGTH as i64) >> Velocity::FRACTION_BITS) as i32;
        state.sum = sum.cast_unsigned();
        #[expect(clippy::cast_possible_truncation, reason = "at most 255")]
        let newest = (LENGTH - 1) as u8;
        state.newest = newest;
        state
    }
}

/// All differences. A form that uses fewer differences keeps fewer.
impl<const LENGTH: usize> Kept for Ring<LENGTH> {
    fn put(&self, bytes: &mut Bytes<'_>) {
        self.put_last(Self::ALL, bytes);
    }

    fn take(rest: &mut &[u8]) -> Option<Self> {
        Self::take_last(Self::ALL, rest)
    }

    #[inline(always)]
    fn sum(&self) -> u32 {
        self.sum.wrapping_add(self.newest.into())
    }

    #[inline(never)]
    fn is_whole(&self) -> bool {
        self.differences.sum() == self.sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flipped_difference_is_found_even_when_it_has_left() {
        let mut whole = History::at(Velocity::from_bits_in_range(70_000));
        for n in 0..200 {
            whole.push(n * n % 91 - 40);
            assert!(whole.is_whole());
        }
        for (place, bit) in (0..LENGTH).flat_map(|place| (0..16).map(move |bit| (place, bit))) {
            let mut broken = whole;
            broken.differences[place] ^= 1 << bit;
            for n in 0..100 {
                assert!(!broken.is_whole(), "{place} {bit} {n}");
                broken.push(n);
            }
        }
    }
}
