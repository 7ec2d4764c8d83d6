//! Computes the population RMS of counts or output codes about their mean. The computation is exact, in integers.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::units::Position;

/// Limit of the RMS, in counts with 16 fractional bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RmsLimit(u32);

impl RmsLimit {
    const FRACTION_BITS: u32 = 16;

    /// The limit nearest to `counts`. It lies from 0 to below 65536 counts.
    #[expect(clippy::float_arithmetic, reason = "design time: settings to integers")]
    pub fn from_counts(counts: f64) -> Self {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a float-to-integer cast saturates, which is what is documented"
        )]
        Self(libm::round(counts * f64::from(1u32 << Self::FRACTION_BITS)) as u32)
    }

    /// A limit of `bits` times 2^-16 counts.
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// The smallest value of `n * sum(d^2) - sum(d)^2` whose RMS reaches the limit. `n` is `samples`, at most 2^24.
    fn scatter_limit(self, samples: u32) -> u128 {
        let product = u128::from(samples) * u128::from(self.0);
        (product * product).div_ceil(1 << (2 * Self::FRACTION_BITS))
    }
}

/// Sums that give mean and RMS of at most 2^24 positions without rounding.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunningVariance {
    samples: u32,
    /// The first position. The sums are over the differences of all positions from this first position. These
    /// differences stay small.
    origin: i32,
    sum: i64,
    sum_of_squares: u128,
}

impl RunningVariance {
    /// The sums when no position has come yet.
    pub const EMPTY: Self = Self { samples: 0, origin: 0, sum: 0, sum_of_squares: 0 };

    /// Takes the position of one sample.
    #[inline]
    pub fn push(&mut self, position: Position) {
        self.push_number(position.counts());
    }

    /// Takes the code of an output, in the same way as a position.
    #[inline]
    pub fn push_number(&mut self, number: i32) {
        if self.samples == 0 {
            self.origin = number;
        }
        let difference = i64::from(number) - i64::from(self.origin);
        let magnitude = u64::from(number.abs_diff(self.origin));
        self.add(1, difference, u128::from(magnitude * magnitude));
    }

    /// Adds positions that were summed up elsewhere. The first position must have been pushed before. `samples` is the
    /// number of added positions, `sum` the sum of their differences from the first position, and `sum_of_squares` the
    /// sum of the squares of these differences.
    #[inline]
    pub fn add(&mut self, samples: u32, sum: i64, sum_of_squares: u128) {
        self.samples += samples;
        self.sum += sum;
        self.sum_of_squares += sum_of_squares;
    }

    /// Number of positions taken.
    #[inline]
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// Whether the RMS of all positions is below `limit`. It is also true without any position.
    pub fn is_below(&self, limit: RmsLimit) -> bool {
        self.samples == 0 || self.scatter() < limit.scatter_limit(self.samples)
    }

    /// Whether the RMS after `total` positions will certainly reach `limit`. This is certain if the sum of squares
    /// about the mean is already large enough, because this sum never falls.
    pub fn must_reach(&self, limit: RmsLimit, total: u32) -> bool {
        // scatter / samples is the sum of squares about the mean. At the end this sum must be at least limit / total.
        // The right side stays below 2^104, so a left side that saturates is greater.
        let limit = limit.scatter_limit(total) * u128::from(self.samples);
        self.samples > 0 && self.scatter().saturating_mul(u128::from(total)) >= limit
    }

    /// Returns `n * sum(d^2) - sum(d)^2`, which is n^2 times the variance. `d` is a difference from the first position.
    fn scatter(&self) -> u128 {
        let sum = u128::from(self.sum.unsigned_abs());
        u128::from(self.samples) * self.sum_of_squares - sum * sum
    }

    /// Mean of the positions, in counts.
    #[expect(clippy::float_arithmetic, reason = "for reports")]
    pub fn mean_counts(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "for reports")]
        let mean = self.sum as f64 / f64::from(self.samples.max(1));
        f64::from(self.origin) + mean
    }

    /// Population RMS about the mean, in counts.
    #[expect(clippy::float_arithmetic, reason = "for reports")]
    pub fn rms_counts(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "for reports")]
        let scatter = self.scatter() as f64;
        libm::sqrt(scatter) / f64::from(self.samples.max(1))
    }
}

#[cfg(test)]
impl RunningVariance {
    /// The sums at their largest, one position before a window of `samples` positions is full.
    pub(crate) fn at_its_widest(samples: u32) -> Self {
        let (before, widest) = (samples - 1, 1i64 << 32);
        Self {
            samples: before,
            origin: i32::MIN,
            sum: i64::from(before) * widest,
            sum_of_squares: u128::from(before) * (1u128 << 64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Samples of a window.
    const HIT: u32 = if cfg!(miri) { 200 } else { 20_000 };
    const ANY_HIT: usize = if cfg!(miri) { 20 } else { 300 };

    fn scatter(counts: &[i32]) -> RunningVariance {
        let mut scatter = RunningVariance::default();
        counts.iter().for_each(|&c| scatter.push(Position::from_counts(c)));
        scatter
    }

    #[test]
    fn the_verdict_turns_exactly_at_the_limit() {
        // The positions are +-15 about their mean, so the RMS is exactly 15. A hit is `stable` only strictly below the
        // limit.
        let square: Vec<i32> =
            (0..HIT).map(|n| 70_000 + if n % 2 == 0 { 15 } else { -15 }).collect();
        let at = scatter(&square);
        assert_eq!(at.rms_counts(), 15.0);
        assert!(!at.is_below(RmsLimit::from_counts(1.5e-5 / 1e-6)));
        assert!(at.is_below(RmsLimit::from_counts(15.0 + 1.0 / 65_536.0)));
        assert_eq!(at.mean_counts(), 70_000.0);
    }

    #[test]
    fn the_ends_of_the_range_do_not_overflow() {
        let wide: Vec<i32> =
            (0..1000).map(|n| if n % 2 == 0 { i32::MIN } else { i32::MAX }).collect();
        let scatter = scatter(&wide);
        assert!(!scatter.is_below(RmsLimit::from_counts(65_535.0)));
        assert!((scatter.rms_counts() / 2f64.powi(31) - 1.0).abs() < 1e-9);
        let most = RunningVariance {
            samples: 1 << 24,
            sum: 0,
            sum_of_squares: (1u128 << 64) << 24,
            ..RunningVariance::default()
        };
        assert!(!most.is_below(RmsLimit::from_counts(65_535.0)));
        assert!(most.must_reach(RmsLimit::from_counts(65_535.0), 1 << 24));
    }

    #[test]
    fn nothing_is_certain_without_a_position() {
        for limit in [0, 1, u32::MAX].map(RmsLimit::from_bits) {
            assert!(!RunningVariance::default().must_reach(limit, 10));
        }
        assert!(scatter(&[0, 100]).must_reach(RmsLimit::from_counts(10.0), 10));
    }

    proptest! {
        #[test]
        fn it_agrees_with_floats_and_an_early_verdict_agrees_with_the_late_one(
            counts in prop::collection::vec(-100i32..100, 1..ANY_HIT), limit in 0.5..60.0f64
        ) {
            let all = scatter(&counts);
            let n = counts.len() as f64;
            let mean = counts.iter().map(|&c| f64::from(c)).sum::<f64>() / n;
            let var = counts.iter().map(|&c| (f64::from(c) - mean).powi(2)).sum::<f64>() / n;
            prop_assert!((all.rms_counts() - var.sqrt()).abs() < 1e-9);
            prop_assert!((all.mean_counts() - mean).abs() < 1e-9);
            let limit = RmsLimit::from_counts(limit);
            let total = u32::try_from(counts.len()).unwrap();
            for taken in 1..=counts.len() {
                if scatter(&counts[..taken]).must_reach(limit, total) {
                    prop_assert!(!all.is_below(limit));
                }
            }
        }
    }
}
