//! The tuning with the largest Z-width area, found with the same number of walks for every estimator.
//!
//! The area over the tuning has one broad top and a rough surface. So the search looks at evenly
//! spaced bandwidths first ([`Axes`]) and then goes from the best point to its neighbours, along both
//! axes if there are two, by steps that are halved where no neighbour is better, until its walks are
//! used up (a compass search). What is refused, and a whole number that was tried already, costs no
//! walk; a range of few whole numbers can be exhausted before the walks are.
//!
//! The walks of the search all start at the same place; the result is walked again from the starts of
//! a sweep, so that its area is not the luckiest of many. What is left of it where the tuning is wrong
//! is walked from the same starts.

use std::sync::atomic::AtomicBool;

use zwidth::{VelocitySettings, velocity::EstimatorName};

use super::{
    axis::{Axes, Free},
    bandwidth::bandwidth_hz,
    tuned::{Edge, Tried, Tuned},
    with_estimator,
};
use crate::{
    error::Error,
    rig::{Numeric, Rig},
    scene::Scene,
    statistics::Repeats,
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

impl Budget {
    /// Most walks that one estimator takes: its search, the result, and four wrong tunings.
    pub fn most(&self) -> u64 {
        u64::from(self.walks) + 5 * u64::from(self.repeats)
    }
}

/// Share of the walks that go into the first look, with one axis and with two.
const FIRST_LOOK: [(u32, u32); 2] = [(3, 5), (1, 2)];
/// First step along the second axis, of its range.
const SECOND_STEP: f64 = 0.25;
/// A step of that part of the range is the last one.
const LEAST_STEP: f64 = 1e-4;
/// How much the bandwidth is put wrong to see how much the tuning matters.
pub const WRONG_BY: f64 = 1.2;
/// How much the mass of a model is put wrong.
pub const MASS_WRONG_BY: f64 = 0.2;

/// Tunes what is free of `start`. `done` is called with the number of walks made.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn tune(
    scene: &Scene,
    start: &VelocitySettings,
    free: Free,
    budget: Budget,
    stop: &AtomicBool,
    done: &(impl Fn(u64) + Sync),
) -> Result<(VelocitySettings, Tuned), Error> {
    let walks = |settings: &VelocitySettings, starts: &[f64]| -> Result<Vec<Boundary>, Error> {
        let (scene, cutoff_hz) = with_estimator(scene, settings);
        let rig = Rig::new(&scene)?;
        let each = |&start: &f64| walk(&rig, Numeric::Fixed, cutoff_hz, start, stop);
        let boundaries = starts.iter().map(each).collect();
        done(starts.len() as u64);
        boundaries
    };
    let starts: Vec<f64> =
        (0..budget.repeats).map(|repeat| start_offset_counts(repeat, budget.repeats)).collect();
    let design = scene.design();
    let axes = Axes::new(start, &design, scene.device.mass_kg, free);
    let mut tuned = Tuned {
        tried: vec![],
        boundaries: vec![],
        bandwidth_hz: 0.0,
        left_when_mistuned: [None; 2],
        left_when_mass_is_wrong: [None; 2],
        edges: [None; 2],
    };
    let mut best = *start;
    if let Some(axes) = &axes {
        let look = |settings: &VelocitySettings| {
            Ok(walks(settings, &[0.0])?.first().map_or(0.0, |boundary| boundary.area))
        };
        let search = Search::over(axes, budget.walks, look)?;
        best = search.best().map_or(best, |tried| tried.settings);
        tuned.edges = edges(axes, &best);
        tuned.tried = search.tried;
    }
    tuned.bandwidth_hz = bandwidth_hz(&best, &design).map_err(Error::input)?;
    tuned.boundaries = walks(&best, &starts)?;
    let area = tuned.area();
    let left = |wrong: &VelocitySettings| -> Result<f64, Error> {
        Ok(Repeats::of(walks(wrong, &starts)?.iter().map(|b| b.area)).mean / area)
    };
    for (side, factor) in [1.0 / WRONG_BY, WRONG_BY].into_iter().enumerate() {
        let wrong = axes.as_ref().and_then(|axes| axes.off_by(&best, factor));
        if let Some((wrong, reached)) = wrong.filter(|_| area > 0.0) {
            // whole numbers miss the factor: the loss at it is in proportion on the logarithmic scale
            let share = factor.ln() / reached.ln();
            tuned.left_when_mistuned[side] = Some(1.0 - share * (1.0 - left(&wrong)?));
        }
    }
    for (side, factor) in [1.0 - MASS_WRONG_BY, 1.0 + MASS_WRONG_BY].into_iter().enumerate() {
        if let VelocitySettings::Observer { bandwidth_hz, mass_kg } = best {
            let wrong = VelocitySettings::Observer { bandwidth_hz, mass_kg: factor * mass_kg };
            if area > 0.0 && wrong.build(&design).is_ok() {
                tuned.left_when_mass_is_wrong[side] = Some(left(&wrong)?);
            }
        }
    }
    Ok((best, tuned))
}

/// Which parameters of `best` are at an end of what was searched, to within the last step.
fn edges(axes: &Axes, best: &VelocitySettings) -> [Option<Edge>; 2] {
    let (_, [tuning, second]) = EstimatorName::of(best);
    let near = |value: f64, end: f64| (value / end).ln().abs() < 1e-6;
    let of = |refused: bool| if refused { Edge::Core } else { Edge::Search };
    let mut edges = [None; 2];
    for side in 0..2 {
        if near(tuning, axes.tuning[side]) {
            edges[0] = Some(of(axes.refused_beyond[side]));
        }
        if axes.second.is_some_and(|ends| near(second, ends[side])) {
            edges[1] = Some(of(axes.second_refused_beyond));
        }
    }
    edges
}

/// What was tried so far.
struct Search {
    tried: Vec<Tried>,
}

impl Search {
    /// Spends that many walks, fewer if nothing is left to try.
    fn over(
        axes: &Axes,
        walks: u32,
        mut look: impl FnMut(&VelocitySettings) -> Result<f64, Error>,
    ) -> Result<Self, Error> {
        let mut search = Self { tried: vec![] };
        let mut left = walks;
        let mut look_at = |search: &mut Self, place: [f64; 2]| -> Result<bool, Error> {
            let settings = axes.at(place);
            let known = search.tried.iter().any(|tried| tried.settings == settings);
            if known || !axes.accepts(&settings) || left == 0 {
                return Ok(false);
            }
            left -= 1;
            let area = look(&settings)?;
            search.tried.push(Tried { place, settings, area });
            Ok(true)
        };
        let (part, of) = FIRST_LOOK[usize::from(axes.second.is_some())];
        let first = (walks * part / of).max(2);
        let second = axes.start_second();
        for n in 0..first {
            look_at(&mut search, [f64::from(n) / f64::from(first - 1), second])?;
        }
        let mut steps = [0.5 / f64::from(first - 1), SECOND_STEP];
        let directions = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
        let directions = if axes.second.is_some() { &directions[..] } else { &directions[..2] };
        while steps[0] > LEAST_STEP {
            let Some(best) = search.best() else { break };
            let [x, y] = best.place;
            let (mut looked, before) = (false, search.tried.len());
            for [dx, dy] in directions {
                let place = [x + dx * steps[0], y + dy * steps[1]].map(|at| at.clamp(0.0, 1.0));
                looked = look_at(&mut search, place)?;
                if looked {
                    break;
                }
            }
            if !looked && before == search.tried.len() {
                steps = steps.map(|step| 0.5 * step);
            }
        }
        Ok(search)
    }

    fn best(&self) -> Option<Tried> {
        self.tried.iter().max_by(|a, b| a.area.total_cmp(&b.area)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    /// Searches a made-up surface; which settings were looked at, and the best of them.
    fn search(
        name: EstimatorName,
        walks: u32,
        area: impl Fn([f64; 2]) -> f64,
    ) -> (Vec<[f64; 2]>, [f64; 2]) {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let axes = Axes::new(&name.defaults(), &scene.design(), 0.416, Free::All).unwrap();
        let mut looked = vec![];
        let search = Search::over(&axes, walks, |settings| {
            looked.push(EstimatorName::of(settings).1);
            Ok(area(EstimatorName::of(settings).1))
        });
        let best = search.unwrap().best().unwrap();
        (looked, EstimatorName::of(&best.settings).1)
    }

    #[test]
    fn it_finds_the_top_of_a_hill_with_the_walks_that_it_has() {
        for top in [60.0, 120.0, 1700.0, 4000.0] {
            let hill = |[hz, _]: [f64; 2]| -(hz / top).ln().powi(2);
            let (looked, [found, _]) = search(EstimatorName::FirstOrder, 24, hill);
            assert!((found / top).ln().abs() < 0.06, "{found} for {top}");
            assert_eq!(looked.len(), 24);
        }
    }

    #[test]
    fn a_second_parameter_is_found_with_the_same_number_of_walks() {
        for (top, ratio) in [(3.0, 2.2), (40.0, 0.6), (15.0, 1.0)] {
            let hill = |[c, lambda]: [f64; 2]| {
                -(c / top).ln().powi(2) - 4.0 * (lambda / ratio).ln().powi(2)
            };
            let (looked, [c, lambda]) = search(EstimatorName::LevantExplicit, 24, hill);
            assert_eq!(looked.len(), 24);
            assert!((c / top).ln().abs() < 0.25, "{c} for {top}");
            assert!((lambda / ratio).ln().abs() < 0.25, "{lambda} for {ratio}");
        }
    }

    #[test]
    fn whole_numbers_are_looked_at_once_from_the_smallest_that_is_accepted() {
        for (name, smallest) in [
            (EstimatorName::LeastSquares1, 1.0),
            (EstimatorName::LeastSquares2, 2.0),
            (EstimatorName::TimeStamps, 1.0),
        ] {
            for top in [smallest, 3.0, 17.0, 40.0] {
                let (mut looked, [found, _]) = search(name, 24, |[n, _]| -(n / top).ln().abs());
                assert_eq!(found, top, "{name:?}");
                assert!(looked.iter().any(|[n, _]| *n == smallest), "{name:?}: {looked:?}");
                let walks = looked.len();
                looked.sort_by(|a, b| a[0].total_cmp(&b[0]));
                looked.dedup();
                assert_eq!(looked.len(), walks, "one was looked at twice");
            }
        }
        // few whole numbers, many walks: every one of them, and no more
        let (looked, _) = search(EstimatorName::TimeStamps, 1000, |[n, _]| -n);
        assert!(looked.len() <= 62, "{}", looked.len());
    }

    #[test]
    fn an_end_of_the_range_is_named_with_its_reason() {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let of = |name: EstimatorName, place| {
            let axes = Axes::new(&name.defaults(), &scene.design(), 0.416, Free::All).unwrap();
            edges(&axes, &axes.at(place))
        };
        assert_eq!(of(EstimatorName::TrackingLoop, [1.0, 0.0]), [Some(Edge::Core), None]);
        assert_eq!(of(EstimatorName::Butterworth, [0.0, 0.0]), [Some(Edge::Search), None]);
        assert_eq!(of(EstimatorName::Butterworth, [0.5, 0.0]), [None; 2]);
        assert_eq!(of(EstimatorName::LevantExplicit, [0.5, 1.0]), [None, Some(Edge::Core)]);
        assert_eq!(of(EstimatorName::FoawEnd, [0.5, 0.0])[1], Some(Edge::Search));
    }
}
