//! Central difference: half the counts of the last two samples.
//!
//! ```text
//! v T = (x[n] - x[n-2]) / 2 = (d[n] + d[n-1]) / 2,   d[n] = x[n] - x[n-1]
//! ```
//!
//! It is the derivative of the parabola through three samples in the middle of them, and so late by one sample. A motion
//! at half the rate reads as standstill. Half a count per sample is 2^15 LSB: nothing is rounded, and at rest it is 0
//! from the second sample on.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Form, Senses};
use crate::units::Velocity;

/// Central difference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CentralDifference;

impl Form for CentralDifference {
    /// The last difference, saturated.
    type State = Velocity;
    const REST: Velocity = Velocity::ZERO;

    fn at(&self, velocity: Velocity) -> Velocity {
        velocity
    }

    #[inline]
    fn step(&self, last: &mut Velocity, difference: i32, _: &Senses) -> Velocity {
        let now = Velocity::saturating_from_counts(difference);
        let half = (now.bits() >> 1) + (last.bits() >> 1); // exact: both are whole counts
        *last = now;
        Velocity::saturating_from_bits(half)
    }
}

#[cfg(test)]
#[cfg(feature = "estimators")]
mod tests {
    use super::*;
    use crate::{
        design::tests::DESIGN,
        units::Position,
        velocity::{EstimatorName, State},
    };

    /// LSB of half a count per sample.
    const HALF: i32 = 1 << 15;

    /// Velocities at those positions, in half counts per sample; the handle rests at the first.
    fn halves(positions: impl IntoIterator<Item = i32>) -> std::vec::Vec<i32> {
        let estimator = EstimatorName::CentralDifference.defaults().build(&DESIGN).unwrap();
        let mut positions = positions.into_iter().map(Position::from_counts);
        let mut state = State::at_rest(positions.next().unwrap());
        // whatever is at rest takes over from the difference
        let velocities = positions.map(|now| estimator.update(&mut state, now, &Senses::NONE));
        velocities
            .map(|velocity| {
                assert_eq!(velocity.bits() % HALF, 0, "nothing is rounded");
                velocity.bits() / HALF
            })
            .collect()
    }

    #[test]
    fn it_is_half_the_counts_of_two_samples_in_both_directions_and_across_a_wrap() {
        for start in [0, -5, i32::MAX - 4, i32::MIN + 2] {
            let at = |counts: i32| start.wrapping_add(counts);
            let there = halves([0, 3, 7, 0, 1, 1].map(at));
            assert_eq!(there, [3, 7, -3, -6, 1]);
            let back = halves([0, -3, -7, 0, -1, -1].map(at));
            assert_eq!(back, there.iter().map(|half| -half).collect::<std::vec::Vec<_>>());
        }
    }

    #[test]
    fn a_handle_that_stops_reads_zero_from_the_second_sample_on() {
        assert_eq!(halves([0, 9, 9, 9, 9]), [9, 9, 0, 0]);
        assert_eq!(halves([7; 5]), [0; 4]);
    }

    #[test]
    fn of_a_parabola_it_is_the_slope_one_sample_ago() {
        // x = k^2, whose slope is 2 k; the first sample has a handle at rest behind it
        let of = halves((0..100).map(|k| k * k));
        for (half, k) in of.iter().zip(1..).skip(1) {
            assert_eq!(*half, 2 * 2 * (k - 1));
        }
    }

    #[test]
    fn differences_beyond_the_range_saturate_one_by_one() {
        let limit = Velocity::LIMIT;
        let positions = [0, i32::MAX, i32::MAX, i32::MAX - 1, 0, 1 - i32::MAX];
        assert_eq!(halves(positions), [limit, limit, -1, -1 - limit, -2 * limit]);
    }

    #[test]
    fn it_goes_on_from_the_velocity_of_the_estimator_before() {
        for counts in [-4, 0, 9] {
            let mut memory = CentralDifference.at(Velocity::saturating_from_counts(counts));
            let velocity = CentralDifference.step(&mut memory, counts, &Senses::NONE);
            assert_eq!(velocity, Velocity::saturating_from_counts(counts));
        }
    }
}
