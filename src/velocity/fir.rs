//! A weighted sum of the last differences of the position: what Taylor expansions and least-squares
//! fits come to ([`polynomial`](super::polynomial) has their equations).
//!
//! The differences are small and exact across a wrap of the position, and with weights that add up
//! to exactly 2^30 a constant speed comes out exactly.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::history::{History, LENGTH};
use crate::units::Velocity;

/// Fractional bits of a weight.
pub(super) const FRACTION_BITS: u32 = 30;

/// Weights of the last differences, newest first, in LSB of 2^-30; they add up to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fir {
    pub(super) weights: [i32; LENGTH],
    /// How many are in use, 1 to [`WINDOW_MAX`](super::WINDOW_MAX).
    pub(super) window: u32,
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
    pub(super) fn update(&self, history: &mut History, difference: i32) -> Velocity {
        history.push(difference);
        let mut sum = 1i64 << (FRACTION_BITS - Velocity::FRACTION_BITS - 1);
        for (weight, age) in self.weights().iter().zip(0u8..) {
            sum += i64::from(*weight) * i64::from(history.back(age));
        }
        let bits = sum >> (FRACTION_BITS - Velocity::FRACTION_BITS);
        let limit = i64::from(Velocity::LIMIT_BITS);
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 31 bits")]
        Velocity::saturating_from_bits(bits.clamp(-limit, limit) as i32)
    }
}
