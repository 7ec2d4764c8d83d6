//! Decides whether two results differ, with Welch's unequal variances t-test (Biometrika 34, 1947).

use statrs::distribution::{ContinuousCDF as _, StudentsT};

/// Smallest mean of a result that is as good as the best result, as a fraction of the best mean.
pub const AS_GOOD_AS_BEST: f64 = 0.98;
/// Probability that the test rejects a result whose mean is exactly at the limit.
pub const LEVEL: f64 = 0.05;

/// Mean of several repeats, and the squared standard error of this mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Repeats {
    pub count: f64,
    /// Mean of the repeats. It is 0 without repeats.
    pub mean: f64,
    /// Square of the standard error of the mean. It is 0 with a single repeat.
    pub squared_error: f64,
}

impl Repeats {
    pub fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let count = values.clone().count().max(1) as f64;
        let mean = values.clone().sum::<f64>() / count;
        let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
        Self { count, mean, squared_error: squares / (count - 1.0).max(1.0) / count }
    }

    /// Half width of the mean's 95 % confidence interval, by Student's t. It is infinite with a single repeat.
    pub fn half_width(&self) -> f64 {
        if self.squared_error == 0.0 && self.count > 1.0 {
            return 0.0;
        }
        match StudentsT::new(0.0, 1.0, self.count - 1.0) {
            Ok(distribution) => distribution.inverse_cdf(0.975) * self.squared_error.sqrt(),
            Err(_) => f64::INFINITY,
        }
    }

    /// Whether the repeats show that the mean is below `share` times the mean of `best`. The test is one-sided, at
    /// [`LEVEL`]. If neither result has any spread, the means are compared directly.
    pub fn is_below(&self, share: f64, best: &Self) -> bool {
        let lacking = share * best.mean - self.mean;
        let errors = [self.squared_error, share * share * best.squared_error];
        let squared_error = errors[0] + errors[1];
        if lacking <= 0.0 || squared_error == 0.0 {
            return lacking > 0.0;
        }
        let weight = |count: f64, error: f64| error * error / (count - 1.0).max(1.0);
        let weights = weight(self.count, errors[0]) + weight(best.count, errors[1]);
        let freedom = squared_error * squared_error / weights;
        match StudentsT::new(0.0, 1.0, freedom) {
            Ok(distribution) => {
                lacking > distribution.inverse_cdf(1.0 - LEVEL) * squared_error.sqrt()
            }
            Err(_) => true, // the degrees of freedom are at least 1 by definition
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_counts_only_where_it_exceeds_the_spread() {
        let of = |values: &[f64]| Repeats::of(values.iter().copied());
        let best = of(&[99.0, 100.0, 101.0, 100.0]);
        // Both means are 4 below the limit of 98. With the small spread, t is far above the threshold for 5 %. With the
        // large spread, t is far below the threshold.
        assert!(of(&[93.0, 94.0, 95.0, 94.0]).is_below(AS_GOOD_AS_BEST, &best));
        assert!(!of(&[80.0, 108.0, 95.0, 93.0]).is_below(AS_GOOD_AS_BEST, &best));
        assert!(!of(&[98.5; 4]).is_below(AS_GOOD_AS_BEST, &best));
        // without spread the means are compared directly
        assert!(of(&[97.9]).is_below(AS_GOOD_AS_BEST, &of(&[100.0])));
        assert!(!of(&[98.1]).is_below(AS_GOOD_AS_BEST, &of(&[100.0])));
        assert_eq!(of(&[]).mean, 0.0);
    }

    #[test]
    fn the_threshold_is_that_of_the_t_distribution() {
        // Both results have equal spread and four repeats: 6 degrees of freedom, t(95 %) = 1.9432. The squared error of
        // each mean is 1/12, the squared error of their difference 1/6.
        let around = |mean: f64| Repeats::of([-0.5, 0.5, -0.5, 0.5].map(|d| mean + d).into_iter());
        let spread = around(0.0).squared_error;
        assert!((spread - 1.0 / 12.0).abs() < 1e-12, "{spread}");
        let least = 1.943_2 * (2.0 * spread).sqrt();
        assert!(!around(100.0 - 0.99 * least).is_below(1.0, &around(100.0)));
        assert!(around(100.0 - 1.01 * least).is_below(1.0, &around(100.0)));
    }
}
