//! The contour of the walls at which a share of the draws is stable, and a test of this contour with fresh draws.
//!
//! At each B of a map, the contour is the longest interval of K in which at least the share is stable. The ends of the
//! interval are interpolated linearly between cells. With few draws, share and contour are not exact. So the firmware's
//! contour is fitted with fresh draws. Each draw has a random position on the contour. At this position the draw is
//! tried with interval lengths from 70 to 110 %. The length at which 95 % of the draws are stable is used. Then
//! [`TRIED`] other draws measure the stable share along the result.

use rayon::prelude::*;
use statrs::distribution::{Beta, ContinuousCDF as _};

use super::{Draws, How, Map, held};
use zwidth::VelocitySettings;

use crate::{
    error::Error,
    numerics::{random, whole},
    simulation::prepared::WallHit,
    study::envelope::Interval,
};

/// Share of the draws that should be stable along the firmware's contour.
pub const SHARE: f64 = 0.95;
/// Number of draws with which a contour is tested.
pub const TRIED: u32 = 2000;
/// Number of draws with which the length of the intervals is fitted.
const FITTED: u32 = 4000;
/// Lengths of the intervals that are tried, as multiples of the length in the map.
const LENGTHS: [f64; 9] = [0.70, 0.75, 0.80, 0.85, 0.90, 0.95, 1.0, 1.05, 1.10];
/// Accuracy with which the length is fitted, as a multiple of the length in the map.
const LAST: f64 = 0.002;
/// Seed of the random positions on the contour.
const PLACES: u64 = 0x5eed_0003;
/// Probability with which the interval of a share does not contain the true share.
const MISS: f64 = 0.05;

/// For each B, the interval of K in which at least `share` of the draws is stable. The list begins at the first B that
/// has an interval. It ends before the next B that has none.
pub fn contour(map: &Map, share: f64) -> Vec<Interval> {
    let [cells, columns] = map.cells;
    let of_column = |column: u32| {
        let at = |cell: u32| f64::from(map.held([cell, column])) / f64::from(map.trials);
        let [_, damping_n_s_per_m] = map.wall([0, column]);
        let k = |cell: u32| map.wall([cell, column])[0];
        // The share is interpolated linearly between two cells.
        let crossing = |inside: u32, outside: u32| {
            let (a, b) = (at(inside), at(outside));
            k(inside) + (k(outside) - k(inside)) * ((a - share) / (a - b)).clamp(0.0, 1.0)
        };
        let mut longest: Option<Interval> = None;
        let mut from: Option<u32> = None;
        for cell in 0..=cells {
            let holds = cell < cells && at(cell) >= share;
            match (holds, from) {
                (true, None) => from = Some(cell),
                (false, Some(first)) => {
                    let stiffness_low_n_per_m =
                        if first == 0 { 0.0 } else { crossing(first, first - 1) };
                    let last = cell - 1;
                    let stiffness_high_n_per_m =
                        if cell == cells { k(last) } else { crossing(last, cell) };
                    let run = Interval {
                        damping_n_s_per_m,
                        stiffness_low_n_per_m,
                        stiffness_high_n_per_m,
                    };
                    if longest.is_none_or(|longest| length(&run) > length(&longest)) {
                        longest = Some(run);
                    }
                    from = None;
                }
                _ => {}
            }
        }
        longest
    };
    // A wall may need a minimum damping. So the first B may have no interval.
    (0..columns).map(of_column).skip_while(Option::is_none).map_while(|one| one).collect()
}

fn length(interval: &Interval) -> f64 {
    interval.stiffness_high_n_per_m - interval.stiffness_low_n_per_m
}

/// A contour that was tested with fresh draws.
#[derive(Clone, Debug, PartialEq)]
pub struct Tried {
    pub intervals: Vec<Interval>,
    /// Length of the intervals divided by the length that they have in the map.
    pub length: f64,
    /// Number of fresh draws in the test.
    pub draws: u32,
    /// Number of the fresh draws that are stable.
    pub held: u32,
}

impl Tried {
    /// The stable share, and its 95 % interval (Clopper and Pearson, Biometrika 26, 1934).
    pub fn share(&self) -> [f64; 3] {
        let (held, draws) = (f64::from(self.held), f64::from(self.draws));
        let missed = draws - held;
        let bound = |a: f64, b: f64, at: f64, else_: f64| match Beta::new(a, b) {
            Ok(beta) => beta.inverse_cdf(at),
            Err(_) => else_, // none or all are stable
        };
        let low = bound(held, missed + 1.0, MISS / 2.0, 0.0);
        let high = bound(held + 1.0, missed, 1.0 - MISS / 2.0, 1.0);
        [held / draws, low, high]
    }
}

/// The random position of a draw on the contour. It has the interval of K there as `[low, high]`, and B.
fn place(intervals: &[Interval], number: u64) -> Option<([f64; 2], f64)> {
    let along = random::uniform(PLACES, number) * (intervals.len() as f64 - 1.0);
    let before = whole(along);
    let (a, b) = (intervals.get(before)?, intervals.get(before + 1).or(intervals.get(before))?);
    let between = |of: fn(&Interval) -> f64| of(a) + (of(b) - of(a)) * along.fract();
    let ends = [between(|i| i.stiffness_low_n_per_m), between(|i| i.stiffness_high_n_per_m)];
    Some((ends, between(|i| i.damping_n_s_per_m)))
}

/// For each length of the intervals, counts the fresh draws that are stable at the upper ends.
fn tried(
    how: How<'_>,
    draws: &Draws,
    velocity: VelocitySettings,
    intervals: &[Interval],
    lengths: &[f64],
    numbers: std::ops::Range<u32>,
) -> Result<Vec<u32>, Error> {
    // Number of draws that are processed together. It is limited, because each draw may be a device of its own, which
    // needs memory.
    const PART: usize = 500;
    let numbers: Vec<u64> = numbers.map(u64::from).collect();
    let mut counts = vec![0; lengths.len()];
    for part in numbers.chunks(PART) {
        let drawn: Vec<_> =
            part.par_iter().map(|&number| draws.fresh(number)).collect::<Result<_, Error>>()?;
        let tasks = drawn.iter().zip(part).filter_map(|(drawn, &number)| {
            let ([low, high], damping_n_s_per_m) = place(intervals, number)?;
            let hit = |length: &f64| WallHit {
                velocity,
                stiffness_n_per_m: low + length * (high - low),
                damping_n_s_per_m,
                start_offset_counts: drawn.starts[0],
            };
            Some((&drawn.prepared, lengths.iter().map(hit).collect()))
        });
        for held in held(how, &tasks.collect::<Vec<_>>())? {
            for (count, held) in counts.iter_mut().zip(held) {
                *count += u32::from(held);
            }
        }
    }
    Ok(counts)
}

/// Finds the contour along which [`SHARE`] of the draws is stable. It is fitted and tested with fresh draws. `None` if
/// no wall is stable.
///
/// # Errors
/// A setting is out of range, or the run was interrupted.
pub fn fitted(how: How<'_>, draws: &Draws, map: &Map) -> Result<Option<Tried>, Error> {
    let intervals = contour(map, SHARE);
    if intervals.len() < 2 {
        return Ok(None);
    }
    let counts = tried(how, draws, map.velocity, &intervals, &LENGTHS, 0..FITTED)?;
    let enough = |count: u32| f64::from(count) >= SHARE * f64::from(FITTED);
    let [mut length, mut beyond] = bracket(&counts.into_iter().map(enough).collect::<Vec<bool>>());
    while beyond - length > LAST {
        let middle = 0.5 * (length + beyond);
        let count = tried(how, draws, map.velocity, &intervals, &[middle], 0..FITTED)?[0];
        if enough(count) { length = middle } else { beyond = middle }
    }
    let shorter = |interval: &Interval| Interval {
        stiffness_high_n_per_m: interval.stiffness_low_n_per_m + length * self::length(interval),
        ..*interval
    };
    let intervals: Vec<Interval> = intervals.iter().map(shorter).collect();
    let held = tried(how, draws, map.velocity, &intervals, &[1.0], FITTED..FITTED + TRIED)?[0];
    Ok(Some(Tried { intervals, length, draws: TRIED, held }))
}

/// The longest of [`LENGTHS`] up to which enough draws are stable, and the length after it.
fn bracket(enough: &[bool]) -> [f64; 2] {
    let last = LENGTHS.len() - 1;
    match enough.iter().position(|enough| !enough) {
        None => [LENGTHS[last]; 2],
        Some(0) => [LENGTHS[0]; 2],
        Some(first) => [LENGTHS[first - 1], LENGTHS[first]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contour_is_the_longest_run_and_lies_between_cells() {
        let shares = [[20, 20, 20, 20, 10, 0], [0, 20, 20, 19, 15, 0], [20, 0, 0, 20, 20, 20]];
        let mut map = Map {
            cutoff_hz: 500.0,
            velocity: VelocitySettings::Butterworth { cutoff_hz: 500.0 },
            step: [100.0, 10.0],
            cells: [6, 3],
            trials: 20,
            devices: 0,
            areas: vec![],
            is_capped: false,
            held: Default::default(),
        };
        for (b, column) in (0..).zip(shares) {
            for (k, held) in (0..).zip(column) {
                map.held.insert((k, b), held);
            }
        }
        let of = |share| {
            let ends = contour(&map, share).into_iter();
            ends.map(|i| [i.damping_n_s_per_m, i.stiffness_low_n_per_m, i.stiffness_high_n_per_m])
                .collect::<Vec<_>>()
        };
        // Between the shares 20 and 10, the line reaches 19 after a tenth of a cell. Between 0 and 20, it reaches 19
        // after 19 of 20 parts of a cell.
        assert_eq!(of(0.95), [[5.0, 0.0, 360.0], [15.0, 145.0, 350.0], [25.0, 345.0, 550.0]]);
        assert_eq!(of(0.5)[0], [5.0, 0.0, 450.0]);
    }

    #[test]
    fn the_interval_of_a_share_is_that_of_clopper_and_pearson() {
        let tried = |held, draws| Tried { intervals: vec![], length: 1.0, draws, held }.share();
        // Published intervals: 44.4 to 97.5 % for 8 of 10, and up to 30.8 % for 0 of 10.
        let [share, low, high] = tried(8, 10);
        assert!(share == 0.8 && (low - 0.4439).abs() < 1e-4 && (high - 0.9748).abs() < 1e-4);
        let [_, low, high] = tried(0, 10);
        assert!(low == 0.0 && (high - 0.3085).abs() < 1e-4, "{high}");
    }

    #[test]
    fn the_length_is_where_the_share_first_falls_below() {
        let first_four = [true, true, true, true, false, true, false, false, false];
        assert_eq!(bracket(&first_four), [LENGTHS[3], LENGTHS[4]]);
        assert_eq!(bracket(&[true; 9]), [1.1; 2]);
        assert_eq!(bracket(&[false; 9]), [0.7; 2]);
    }
}
