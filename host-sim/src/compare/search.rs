//! The tuning with the largest Z-width area, found with the same number of walks for every estimator.
//!
//! The area over the tuning has one broad top and a rough surface. So the search looks at evenly
//! spaced points on a logarithmic axis first and then halves the distance around the best one, again
//! and again, until its walks are used up. The walks of the search all start at the same place; the
//! result is walked again from the starts of a sweep, so that its area is not the luckiest of many.

use std::sync::atomic::AtomicBool;

use zwidth::{VelocitySettings, velocity::Parameter};

use super::with_estimator;
use crate::{
    error::Error,
    rig::{Numeric, Rig},
    scene::Scene,
    sweep::start_offset_counts,
    walk::{Boundary, walk},
};

/// What a search may cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Walks of the search, 3 or more.
    pub walks: u32,
    /// Walks at its result, starts spread over a count, 1 or more.
    pub repeats: u32,
}

/// Share of the walks that go into the first look.
const FIRST_LOOK: (u32, u32) = (3, 5);
/// How much the tuning is put wrong to see how much it matters.
pub const MISTUNED_BY: f64 = 1.5;

/// The result of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct Tuned {
    /// Every tuning that was tried and its area, ascending; empty if there is nothing to tune.
    pub tried: Vec<(f64, f64)>,
    /// Boundaries at the best tuning, one per start.
    pub boundaries: Vec<Boundary>,
    /// Area that is left when the tuning is too low and too high by [`MISTUNED_BY`], as a fraction of
    /// that of the best, both walked from the scene's own start; `None` where there is nothing to
    /// tune, or the core refuses that tuning.
    pub left_when_mistuned: [Option<f64>; 2],
    /// The best tuning is an end of what was tried.
    pub at_edge: bool,
}

impl Tuned {
    fn areas(&self) -> impl Iterator<Item = f64> {
        self.boundaries.iter().map(|boundary| boundary.area)
    }

    /// Mean area, N^2 s/m^2.
    pub fn area(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a handful of repeats")]
        let walks = self.boundaries.len().max(1) as f64;
        self.areas().sum::<f64>() / walks
    }

    /// Smallest and largest area of the repeats, N^2 s/m^2.
    pub fn area_range(&self) -> [f64; 2] {
        let low = self.areas().reduce(f64::min).unwrap_or(0.0);
        [low, self.areas().reduce(f64::max).unwrap_or(0.0)]
    }

    /// Largest K of any repeat, N/m.
    pub fn stiffness_peak_n_per_m(&self) -> f64 {
        self.boundaries.iter().map(Boundary::stiffness_peak_n_per_m).fold(0.0, f64::max)
    }

    /// Largest B of any repeat, N s/m.
    pub fn damping_max_n_s_per_m(&self) -> f64 {
        self.boundaries.iter().map(Boundary::damping_max_n_s_per_m).fold(0.0, f64::max)
    }

    /// Smallest K of the repeats at the grid's B nearest to this one, N/m; `None` if a boundary ends
    /// before.
    pub fn stiffness_at(&self, damping_n_s_per_m: f64) -> Option<f64> {
        let at = |boundary: &Boundary| {
            let distance = |b: f64| (b - damping_n_s_per_m).abs();
            let reaches = boundary.damping_max_n_s_per_m() >= damping_n_s_per_m;
            let nearest = boundary.points.iter().min_by(|p, q| {
                distance(p.damping_n_s_per_m).total_cmp(&distance(q.damping_n_s_per_m))
            });
            nearest.filter(|_| reaches).map(|point| point.stiffness_n_per_m)
        };
        let all: Option<Vec<f64>> = self.boundaries.iter().map(at).collect();
        all?.into_iter().reduce(f64::min)
    }
}

/// The range of tunings that a search looks at: what the field uses, as far as the core accepts it.
fn range(parameter: &Parameter, rate_hz: f64) -> [f64; 2] {
    match parameter.unit {
        "Hz" => [10.0, 0.45 * rate_hz],
        "samples" => [2.0, 64.0],
        // accelerations from a slow hand to a hard stop, and their rates of change
        "m/s^2" => [0.1, 1e4],
        "m/s^3" => [1e1, 1e7],
        _ => [parameter.default / 30.0, parameter.default * 30.0],
    }
}

/// The part of the range that the core accepts, to within 5 %.
fn narrowed([mut low, mut high]: [f64; 2], accepted: impl Fn(f64) -> bool) -> [f64; 2] {
    const STEP: f64 = 1.05;
    while low < high && !accepted(low) {
        low *= STEP;
    }
    while high > low && !accepted(high) {
        high /= STEP;
    }
    [low, high]
}

/// Tunes `start`; with `fixed` it is only walked. `done` is called after each walk.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn tune(
    scene: &Scene,
    start: &VelocitySettings,
    fixed: bool,
    budget: Budget,
    stop: &AtomicBool,
    done: &(impl Fn() + Sync),
) -> Result<(VelocitySettings, Tuned), Error> {
    let boundary = |settings: &VelocitySettings, start_counts: f64| -> Result<Boundary, Error> {
        let (scene, cutoff_hz) = with_estimator(scene, settings);
        let rig = Rig::new(&scene)?;
        let boundary = walk(&rig, Numeric::Fixed, cutoff_hz, start_counts, stop)?;
        done();
        Ok(boundary)
    };
    let repeats = |settings: &VelocitySettings| -> Result<Vec<Boundary>, Error> {
        (0..budget.repeats)
            .map(|repeat| boundary(settings, start_offset_counts(repeat, budget.repeats)))
            .collect()
    };
    let Some((parameter, _)) = start.tuning().filter(|_| !fixed) else {
        let boundaries = repeats(start)?;
        let tuned =
            Tuned { tried: vec![], boundaries, left_when_mistuned: [None; 2], at_edge: false };
        return Ok((*start, tuned));
    };
    let whole = parameter.unit == "samples";
    let accepted = |tuning: f64| start.with_tuning(tuning).build(&scene.design()).is_ok();
    let range = narrowed(range(&parameter, scene.control.rate_hz), accepted);
    let mut tried = Tried { points: vec![], whole };
    let look = |tuning: f64| -> Result<f64, Error> {
        if accepted(tuning) { Ok(boundary(&start.with_tuning(tuning), 0.0)?.area) } else { Ok(0.0) }
    };
    let first = (budget.walks * FIRST_LOOK.0 / FIRST_LOOK.1).clamp(2, budget.walks);
    for n in 0..first {
        let share = f64::from(n) / f64::from(first - 1);
        tried.add(range[0] * (range[1] / range[0]).powf(share), look)?;
    }
    for _ in first..budget.walks {
        let Some(next) = tried.next() else { break };
        tried.add(next, look)?;
    }
    let best = tried.best();
    let settings = start.with_tuning(best);
    let boundaries = repeats(&settings)?;
    let mut tuned = Tuned {
        at_edge: tried.is_edge(best),
        tried: tried.points,
        boundaries,
        left_when_mistuned: [None; 2],
    };
    let area = tuned.boundaries.first().map_or(0.0, |first| first.area);
    for (left, factor) in tuned.left_when_mistuned.iter_mut().zip([1.0 / MISTUNED_BY, MISTUNED_BY])
    {
        let wrong = tried_value(best * factor, whole);
        if area > 0.0 && accepted(wrong) {
            *left = Some(look(wrong)? / area);
        }
    }
    Ok((settings, tuned))
}

fn tried_value(tuning: f64, whole: bool) -> f64 {
    if whole { tuning.round() } else { tuning }
}

/// Tunings and areas, ascending.
struct Tried {
    points: Vec<(f64, f64)>,
    /// The tuning is a whole number.
    whole: bool,
}

impl Tried {
    fn add(&mut self, tuning: f64, look: impl Fn(f64) -> Result<f64, Error>) -> Result<(), Error> {
        let tuning = tried_value(tuning, self.whole);
        let place = self.points.partition_point(|(known, _)| *known < tuning);
        if self.points.get(place).is_none_or(|(known, _)| *known != tuning) {
            self.points.insert(place, (tuning, look(tuning)?));
        }
        Ok(())
    }

    fn best_index(&self) -> usize {
        let best = self.points.iter().enumerate().max_by(|(_, p), (_, q)| p.1.total_cmp(&q.1));
        best.map_or(0, |(index, _)| index)
    }

    fn best(&self) -> f64 {
        self.points.get(self.best_index()).map_or(f64::NAN, |point| point.0)
    }

    fn is_edge(&self, tuning: f64) -> bool {
        let ends = [self.points.first(), self.points.last()];
        ends.into_iter().flatten().any(|end| end.0 == tuning)
    }

    /// The middle of the wider gap beside the best point; `None` if there is no room left.
    fn next(&self) -> Option<f64> {
        let best = self.best_index();
        let gap = |low: usize, high: usize| {
            let (low, high) = (self.points.get(low)?.0, self.points.get(high)?.0);
            let middle = tried_value((low * high).sqrt(), self.whole);
            (middle > low && middle < high).then_some((high / low, middle))
        };
        let gaps = [best.checked_sub(1).and_then(|low| gap(low, best)), gap(best, best + 1)];
        let widest = gaps.into_iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0));
        widest.map(|(_, middle)| middle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(area: impl Fn(f64) -> f64, whole: bool, walks: u32) -> f64 {
        let mut tried = Tried { points: vec![], whole };
        let look = |tuning: f64| Ok(area(tuning));
        for n in 0..10 {
            tried.add(10.0 * 450f64.powf(f64::from(n) / 9.0), look).unwrap();
        }
        for _ in 10..walks {
            let Some(next) = tried.next() else { break };
            tried.add(next, look).unwrap();
        }
        assert!(tried.points.is_sorted_by(|a, b| a.0 < b.0));
        tried.best()
    }

    #[test]
    fn it_finds_the_top_of_a_hill_on_a_logarithmic_axis() {
        for top in [15.0, 120.0, 1700.0, 4000.0] {
            let found = search(|tuning| -(tuning / top).ln().powi(2), false, 20);
            assert!((found / top).ln().abs() < 0.05, "{found} for {top}");
        }
    }

    #[test]
    fn whole_numbers_stay_whole_and_are_tried_once() {
        let found = search(|tuning| -(tuning - 17.0).abs(), true, 40);
        assert_eq!(found, 17.0);
    }
}
