//! A weighted sum of the last differences of the position: what Taylor expansions and least-squares
//! fits come to ([`polynomial`](super::polynomial) has their equations).
//!
//! The differences are small and exact across a wrap of the position, and with weights that add up
//! to exactly 2^30 a constant speed comes out exactly.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::units::Velocity;

/// Longest window, in samples.
pub const WINDOW_MAX: u32 = 64;

pub(super) const LENGTH: usize = WINDOW_MAX as usize;
/// Fractional bits of a weight.
pub(super) const FRACTION_BITS: u32 = 30;

/// Weights of the last differences, newest first, in LSB of 2^-30; they add up to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fir {
    pub(super) weights: [i32; LENGTH],
    /// How many are in use, 1 to [`WINDOW_MAX`].
    pub(super) window: u32,
}

/// The last differences, in counts per sample, saturated to the range of [`Velocity`].
#[derive(Clone, Copy, Debug)]
pub(super) struct FirState {
    differences: [i16; LENGTH],
    /// Place of the newest one.
    newest: u8,
}

impl Fir {
    /// The weights in use, newest first, in LSB of 2^-30.
    pub fn weights(&self) -> &[i32] {
        self.weights.get(..self.window as usize).unwrap_or(&self.weights)
    }

    /// The velocity after a move by `difference` counts.
    ///
    /// Its error against the exact weighted sum is at most half an LSB and 2^-31 of the sum of the
    /// magnitudes of the differences; at constant speed it is exact.
    #[inline(never)] // so that the state of the usual estimator stays in registers
    pub(super) fn update(&self, state: &mut FirState, difference: i32) -> Velocity {
        state.push(difference);
        let mut sum = 1i64 << (FRACTION_BITS - Velocity::FRACTION_BITS - 1);
        for (weight, place) in self.weights().iter().zip(0u8..) {
            let at = usize::from(state.newest.wrapping_sub(place)) % LENGTH;
            let difference = state.differences.get(at).copied().unwrap_or(0);
            sum += i64::from(*weight) * i64::from(difference);
        }
        let bits = sum >> (FRACTION_BITS - Velocity::FRACTION_BITS);
        let limit = i64::from(Velocity::LIMIT_BITS);
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 31 bits")]
        Velocity::saturating_from_bits(bits.clamp(-limit, limit) as i32)
    }
}

impl FirState {
    pub(super) const REST: Self = Self { differences: [0; LENGTH], newest: 0 };

    fn push(&mut self, difference: i32) {
        self.newest = self.newest.wrapping_add(1);
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 16 bits")]
        let difference = difference.clamp(-Velocity::LIMIT, Velocity::LIMIT) as i16;
        if let Some(place) = self.differences.get_mut(usize::from(self.newest) % LENGTH) {
            *place = difference;
        }
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
