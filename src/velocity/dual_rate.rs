//! Dual-rate sampling (Koul, Saha, Manivannan, "Enhancing the Z-width of haptic interfaces through dual-rate sampling"):
//! the position is taken with every sample, the velocity with every n-th one, where a count is worth less of it.
//!
//! ```text
//! v T = (x[k] - x[k-n]) / n    at every n-th sample k, held in between
//! ```
//!
//! Of the paper abstract and introduction were read, which say what is sampled when; the difference, and that nothing
//! filters it, is the plain reading.
//!
//! It is late by half of its n samples and by those since its last update: n - 1/2 on the mean. Which of these samples an
//! output comes with is settled by the restart, whose sample is an update: an output for each n samples, or a multiple
//! of that, then always has the same age of velocity. It is not time-invariant, and has no transfer function; on the
//! mean over that age it is a difference over n samples and a mean of n.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Form, Senses, kept::kept};
use crate::{
    range::{SettingsError, within},
    units::Velocity,
};

/// Most samples from update to update.
pub const DECIMATION_MAX: u8 = 255;

/// Fractional bits of the factor beyond those of a velocity: rounding it costs a quarter of an LSB.
const FACTOR_BITS: u32 = 24;

/// Difference over n samples, with every n-th one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DualRate {
    decimation: u8,
    /// One over it.
    factor: i64,
}

/// Since the last update: samples and counts; and its velocity.
#[derive(Clone, Copy, Debug)]
pub(super) struct DualRateState {
    samples: u16,
    counts: i32,
    held: Velocity,
}

kept!(DualRateState { samples, counts, held });

impl DualRate {
    /// With every sample of that many, 1 to [`DECIMATION_MAX`].
    ///
    /// # Errors
    /// Another number.
    pub fn new(decimation_samples: u32) -> Result<Self, SettingsError> {
        let range = 1.0..=f64::from(DECIMATION_MAX);
        within("decimation_samples", f64::from(decimation_samples), range)?;
        let decimation = u8::try_from(decimation_samples).unwrap_or(DECIMATION_MAX);
        let one = 1i64 << (Velocity::FRACTION_BITS + FACTOR_BITS);
        Ok(Self { decimation, factor: (one + i64::from(decimation) / 2) / i64::from(decimation) })
    }

    /// Samples from update to update.
    pub const fn decimation_samples(&self) -> u8 {
        self.decimation
    }

    /// One over them, in LSB of a velocity with [`FACTOR_BITS`](Self::FACTOR_BITS) fractional bits.
    pub const fn factor(&self) -> i64 {
        self.factor
    }

    /// Fractional bits of the factor beyond those of a velocity.
    pub const FACTOR_BITS: u32 = FACTOR_BITS;
}

impl Form for DualRate {
    type State = DualRateState;
    const REST: DualRateState = DualRateState { samples: 0, counts: 0, held: Velocity::ZERO };

    /// The next sample is an update.
    fn at(&self, velocity: Velocity) -> DualRateState {
        let samples = u16::from(self.decimation) - 1;
        let bits = i64::from(samples) * i64::from(velocity.bits());
        let counts = (bits + (1 << (Velocity::FRACTION_BITS - 1))) >> Velocity::FRACTION_BITS;
        #[expect(clippy::cast_possible_truncation, reason = "254 times 2^15 at most")]
        let counts = counts as i32;
        DualRateState { samples, counts, held: velocity }
    }

    #[inline]
    fn step(&self, state: &mut DualRateState, difference: i32, _: &Senses) -> Velocity {
        state.samples += 1;
        state.counts += difference.clamp(-Velocity::LIMIT, Velocity::LIMIT);
        if state.samples >= u16::from(self.decimation) {
            // at most 255 * 32767 * 2^40 / 255, below 2^56
            let sum = i64::from(state.counts) * self.factor + (1 << (FACTOR_BITS - 1));
            #[expect(clippy::cast_possible_truncation, reason = "a mean of differences in range")]
            let mean = (sum >> FACTOR_BITS) as i32;
            *state = DualRateState { held: Velocity::saturating_from_bits(mean), ..Self::REST };
        }
        state.held
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
    use proptest::prelude::*;
    use std::vec::Vec;

    const LSB: f64 = (1u32 << Velocity::FRACTION_BITS) as f64;

    /// Velocities at those positions, counts per sample; the handle rests at the first.
    fn velocities(decimation: u32, positions: &[i32]) -> Vec<f64> {
        let settings = EstimatorName::DualRate.defaults().with_tuning(decimation.into());
        let estimator = settings.build(&DESIGN).unwrap();
        let mut state = State::at_rest(Position::from_counts(positions[0]));
        let each = positions.iter().map(|now| {
            let now = Position::from_counts(*now);
            f64::from(estimator.update(&mut state, now, &Senses::NONE).bits()) / LSB
        });
        each.collect()
    }

    proptest! {
        /// With every n-th sample from the first one on the counts of the last n over n, else the same again.
        #[test]
        fn it_is_the_difference_of_every_nth_sample_held(
            decimation in 1u8..=255,
            start in any::<i32>(),
            steps in prop::collection::vec(-32_767i32..=32_767, 1..900),
        ) {
            let mut positions = std::vec![start];
            for step in steps {
                positions.push(positions.last().unwrap().wrapping_add(step));
            }
            let found = velocities(decimation.into(), &positions);
            for (k, found) in found.iter().enumerate() {
                let update = k - k % usize::from(decimation);
                let before = positions[update.saturating_sub(decimation.into())];
                let counts = f64::from(positions[update].wrapping_sub(before));
                let exact = counts / f64::from(decimation);
                prop_assert!((found - exact).abs() <= 0.76 / LSB, "{k}: {found} {exact}");
            }
        }
    }

    #[test]
    fn whole_counts_per_sample_and_rest_are_exact() {
        for decimation in [1, 2, 3, 10, 255] {
            for speed in [0i32, 1, -7, 32_767, -32_767] {
                let positions: Vec<i32> = (0..1200).map(|k: i32| k.wrapping_mul(speed)).collect();
                let found = velocities(decimation, &positions);
                assert!(
                    found[256..].iter().all(|v| *v == f64::from(speed)),
                    "{decimation} {speed}"
                );
            }
        }
    }

    #[test]
    fn differences_of_the_largest_size_saturate_and_leave_nothing_behind() {
        for decimation in [1, 255] {
            for step in [i32::MIN, i32::MAX] {
                let mut positions = std::vec![0i32];
                for n in 0..2000 {
                    let step = if n < 1000 { step } else { 0 };
                    positions.push(positions.last().unwrap().wrapping_add(step));
                }
                let found = velocities(decimation, &positions);
                assert_eq!(found[1000].abs(), f64::from(Velocity::LIMIT));
                assert_eq!(found[2000], 0.0);
            }
        }
    }

    /// From any velocity, also at the ends of the range.
    #[test]
    fn a_restart_is_an_update_and_jumps_by_a_part_of_the_difference() {
        for decimation in [1u8, 2, 10, 255] {
            let form = DualRate::new(decimation.into()).unwrap();
            for bits in [0, 1, -98_765, 7 << 16, Velocity::LIMIT_BITS, -Velocity::LIMIT_BITS] {
                for d in [-32_767, -3, 0, 5, 32_767] {
                    let velocity = Velocity::saturating_from_bits(bits);
                    let mut state = form.at(velocity);
                    let first = form.step(&mut state, d, &Senses::NONE);
                    let jump = (f64::from(first.bits()) - f64::from(bits)).abs() / LSB;
                    let off = (f64::from(d) - f64::from(bits) / LSB).abs();
                    assert!(jump <= (off + 0.5) / f64::from(decimation) + 1.0 / LSB, "{bits} {d}");
                    assert_eq!((state.samples, state.counts), (0, 0));
                }
            }
        }
    }

    #[test]
    fn other_numbers_are_refused() {
        for (decimation, is_good) in [(0, false), (1, true), (255, true), (256, false)] {
            assert_eq!(DualRate::new(decimation).is_ok(), is_good);
        }
    }
}
