//! The last differences of the position, for estimators that look at a window.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::units::Velocity;

/// Longest window, in samples.
pub const WINDOW_MAX: u32 = 64;

pub(super) const LENGTH: usize = WINDOW_MAX as usize;

/// The last differences, in counts per sample, saturated to the range of [`Velocity`].
#[derive(Clone, Copy, Debug)]
pub(super) struct History {
    differences: [i16; LENGTH],
    /// Place of the newest one.
    newest: u8,
}

impl History {
    pub(super) const REST: Self = Self { differences: [0; LENGTH], newest: 0 };

    pub(super) fn push(&mut self, difference: i32) {
        self.newest = self.newest.wrapping_add(1);
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 16 bits")]
        let difference = difference.clamp(-Velocity::LIMIT, Velocity::LIMIT) as i16;
        if let Some(place) = self.differences.get_mut(usize::from(self.newest) % LENGTH) {
            *place = difference;
        }
    }

    /// The difference `age` samples before the newest one.
    #[inline]
    pub(super) fn back(&self, age: u8) -> i32 {
        let at = usize::from(self.newest.wrapping_sub(age)) % LENGTH;
        self.differences.get(at).copied().map_or(0, i32::from)
    }

    /// As after many samples at that velocity: differences whose sums follow it to within a count.
    pub(super) fn at(velocity: Velocity) -> Self {
        let mut state = Self::REST;
        let mut whole = 0;
        for n in 1..=WINDOW_MAX.cast_signed() {
            let position = (i64::from(velocity.bits()) * i64::from(n)) >> Velocity::FRACTION_BITS;
            #[expect(clippy::cast_possible_truncation, reason = "at most 2^15 * 64")]
            let position = position as i32;
            state.push(position - whole);
            whole = position;
        }
        state
    }
}
