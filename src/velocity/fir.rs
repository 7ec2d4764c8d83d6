//! A weighted sum of the last differences of the position. Taylor expansions and least-squares fits are such sums
//! ([`polynomial`](super::polynomial) has their equations).
//!
//! The differences are small, and exact across a wrap of the position. The weights add up to exactly 2^30, so a
//! constant speed is exact.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{
    Form, Senses,
    history::{History, LENGTH},
    kept::Bytes,
};
use crate::units::Velocity;

pub(super) const FRACTION_BITS: u32 = 30;

/// Weights of the last differences, newest first, in LSB of 2^-30. They add up to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fir {
    pub(super) weights: [i32; LENGTH],
    /// Number of weights in use, 1 to [`WINDOW_MAX`](super::WINDOW_MAX).
    pub(super) window: u32,
}

impl Fir {
    /// The weights in use, newest first, in LSB of 2^-30.
    pub fn weights(&self) -> &[i32] {
        self.weights.get(..self.window as usize).unwrap_or(&self.weights)
    }
}

impl Form for Fir {
    type State = History;
    const REST: History = History::REST;

    fn at(&self, velocity: Velocity) -> History {
        History::at(velocity)
    }

    fn put(&self, history: &History, bytes: &mut Bytes<'_>) {
        history.put_last(u8::try_from(self.window).unwrap_or(u8::MAX), bytes);
    }

    fn take(&self, rest: &mut &[u8]) -> Option<History> {
        History::take_last(u8::try_from(self.window).unwrap_or(u8::MAX), rest)
    }

    /// The error against the exact weighted sum has two parts. The first part is at most half an LSB. The second part
    /// is the sum, over all weights, of the weight's rounding error times the magnitude of its difference. A rounding
    /// error is at most 2^-31, except for the largest weight: it gets the rounding errors of all weights. At constant
    /// speed the sum is exact.
    #[inline]
    fn step(&self, history: &mut History, difference: i32, _: &Senses) -> Velocity {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::velocity::FirDesign;

    /// The sum is linear. So it is largest when each difference is at the end of its range that has the sign of its
    /// weight.
    #[test]
    fn no_sum_overflows_at_its_ends() {
        let fits = (1..=2).flat_map(|degree| {
            (degree..=64).map(move |window| FirDesign::least_squares(degree, window).unwrap())
        });
        let taylor = (1..=3).map(|order| FirDesign::taylor(order).unwrap());
        for fir in fits.chain(taylor).map(|design| design.quantise()) {
            for end in [i32::MIN + 1, i32::MAX] {
                let mut history = History::REST;
                let mut worst: [i32; LENGTH] = [0; LENGTH];
                for (difference, weight) in worst.iter_mut().zip(fir.weights()) {
                    *difference = if *weight < 0 { -end } else { end };
                }
                for difference in worst.iter().skip(1).rev() {
                    history.push(*difference);
                }
                let speed = fir.step(&mut history, worst[0], &Senses::NONE);
                assert_eq!(speed.bits().abs(), Velocity::LIMIT_BITS);
            }
        }
    }
}
