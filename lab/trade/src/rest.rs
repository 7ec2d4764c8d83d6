//! Largest output after the handle has stopped. A large value means a limit cycle, or an output that does not return to
//! 0.

use filter_forms::Filter;

use super::{Bench, LSB_PER_COUNT, larger};

/// Number of periods of the cutoff after which the exact output is below 10^-38 of its value at the stop.
const PERIODS: f64 = 20.0;
/// Smallest number of samples for which the output is measured after `PERIODS` periods. It is also measured for at
/// least `WATCHED_PERIODS` periods of the cutoff.
const WATCHED: u32 = 5000;
const WATCHED_PERIODS: f64 = 1.0;
/// Smallest number of samples for which the handle moves at random.
const MOVING: u32 = 1000;

/// Largest output after the stop, in counts per sample.
pub fn measure(bench: &Bench, filter: &Filter, cutoff_hz: f64) -> f64 {
    let mut filter = *filter;
    let moving = bench.samples(2.0, cutoff_hz).max(MOVING);
    let wait = bench.samples(PERIODS, cutoff_hz);
    let watched = bench.samples(WATCHED_PERIODS, cutoff_hz).max(WATCHED);
    #[expect(clippy::cast_possible_truncation, reason = "below 2^31")]
    let half_scale = (0.5 * bench.q15_full_scale_counts() * LSB_PER_COUNT) as i32;
    let mut seed = 1u32;
    let mut worst = 0f64;
    filter.run(
        moving + wait + watched,
        |n| {
            if n >= moving {
                return 0;
            }
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 1).cast_signed() % half_scale
        },
        |n, out| {
            if n >= moving + wait {
                worst = larger(worst, out.abs());
            }
        },
    );
    worst
}
