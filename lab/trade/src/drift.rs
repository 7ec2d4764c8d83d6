//! Drift of the position at a constant speed.

use std::cell::Cell;

use filter_forms::Filter;

use super::{Bench, larger, response::SETTLE_PERIODS};

/// Number of samples over which the drift is measured.
pub const SAMPLES: u32 = 1_000_000;
/// The two speeds of the test. Each is a number of counts and the number of samples in which the handle moves by them.
/// Both speeds are low, because a dead zone has the most effect at low speeds. A gain error at high speed belongs to
/// the error of the response.
const SPEEDS: [(i64, i64); 2] = [(3, 10), (-1, 1000)];

/// Measures the span of `sum(out - in)` over [`SAMPLES`] samples at each constant speed. Returns the largest span, in
/// counts.
pub fn measure(bench: &Bench, filter: &Filter, cutoff_hz: f64) -> f64 {
    let transient = bench.samples(SETTLE_PERIODS, cutoff_hz) + 200;
    let mut worst = 0f64;
    for (counts, samples) in SPEEDS {
        // Adds the whole counts up to the next sample. The remainder is below one count.
        let (mut left, moved) = (0, Cell::new(0));
        let next = |_| {
            left += counts;
            let whole = i32::from(left >= samples) - i32::from(left < 0);
            left -= i64::from(whole) * samples;
            moved.set(whole);
            whole << 16
        };
        // The sum of the inputs is an integer. The sum of the differences is small, so `f64` has enough digits.
        let (mut sum, mut low, mut high) = (0.0, f64::INFINITY, f64::NEG_INFINITY);
        let mut filter = *filter;
        filter.run(transient + SAMPLES, next, |n, out| {
            if n >= transient {
                sum += out - f64::from(moved.get());
                low = f64::min(low, sum);
                high = f64::max(high, sum);
            }
        });
        worst = larger(worst, if sum.is_finite() { high - low } else { f64::INFINITY });
    }
    worst
}
