//! Finds the tuning with the largest Z-width area, by the same rule for every estimator.
//!
//! As a function of the tuning, the area has one broad maximum and a rough surface. So the search first walks evenly
//! spaced tunings ([`Axes`]): a row of bandwidths for one parameter, a grid for two parameters. Then the search moves
//! from the best tuning to a neighbour that is better by more than [`GAIN`]. Neighbours are along the axes. With two
//! parameters, they are also along the diagonals (a compass search). If no neighbour is better, the steps are halved.
//! The search has *settled* when the steps are below [`LAST_STEP`] of bandwidth. If the allowed number of tunings is
//! used up before that, the search has not settled. A refused tuning, or a whole number that was already tried, is not
//! tried again.
//!
//! The search walks from two starts that no repeat uses. A tuning that can no longer win is walked from the first start
//! only (`looked.rs`). The result is walked again from the starts of a sweep. The area of the result is the area of
//! these last walks, so the selection does not bias the area. Wrong tunings are also walked from the starts of a sweep.

use std::{cell::RefCell, sync::atomic::AtomicBool};

use zwidth::{VelocitySettings, velocity::EstimatorName};

use super::{
    axis::Axes,
    bandwidth::bandwidth_hz,
    looked::{Look, Looked},
    tuned::{Edge, Tried, Tuned},
    with_filter,
};
use crate::{
    engine::{Engine, lanes_for},
    error::Error,
    interrupt,
    scene::Scene,
    simulation::prepared::{Numeric, PreparedScene},
    study::{How, boundary::Boundaries, filters::boundaries, schedule::Length, sweep::starts},
};

/// Limits on the cost of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Largest number of tunings that a search with one parameter may try, 3 or more. With two parameters the limit is
    /// [`OF_TWO`] times as large.
    pub tunings: u32,
    /// Number of walks of the result, 1 or more. Their starts are spread evenly over a count.
    pub repeats: u32,
}

impl Budget {
    /// Largest number of walks that one estimator can need: for its search, its result and four wrong tunings.
    pub fn most(&self) -> u64 {
        let walks = OF_TWO * self.tunings * WALKS_OF_A_TRY;
        u64::from(walks) + 5 * u64::from(self.repeats)
    }
}

/// Largest number of walks for one tried tuning of a search.
pub const WALKS_OF_A_TRY: u32 = 2;
/// Number of tunings that a search with two parameters may try, divided by the number for one parameter.
pub const OF_TWO: u32 = 4;
/// The share of the tunings that the evenly spaced first step uses, as numerator and denominator. The first fraction is
/// for one axis, the second is for two.
const FIRST_LOOK: [(u32, u32); 2] = [(3, 5), (3, 8)];
/// Number of lines of the first grid along the second axis. Each line is in the middle of one of `LINES` equal parts of
/// the axis.
const LINES: u32 = 3;
/// Smallest gain of area with which a neighbour counts as better, as a share.
pub const GAIN: f64 = 0.002;
/// The search ends at this step, a ratio of two bandwidths. For whole-number tunings it ends at `LEAST_STEP`.
pub const LAST_STEP: f64 = 1.03;
/// Smallest step on any axis, as a share of the axis.
const LEAST_STEP: f64 = 1e-4;
/// Factor by which the bandwidth of a wrong tuning is too large or too small. The loss of area at this tuning shows how
/// critical the tuning is.
pub const WRONG_BY: f64 = 1.2;
/// Relative error of the mass in a wrong model. Both a larger and a smaller mass are tried.
pub const MASS_WRONG_BY: f64 = 0.2;

pub struct Walker<'a, D> {
    pub engine: Engine,
    /// The scene. The scene's own estimator is not used.
    pub scene: &'a Scene,
    /// Becomes true when the search must stop.
    pub stop: &'a AtomicBool,
    /// Called with the number of finished walks.
    pub done: &'a D,
}

impl<D: Fn(u64) + Sync> Walker<'_, D> {
    /// Walks tunings of one estimator from `starts`. Returns the boundaries.
    pub(in crate::analysis) fn walks(
        &self,
        settings: &[VelocitySettings],
        starts: &[f64],
    ) -> Result<Vec<Boundaries>, Error> {
        let Some(first) = settings.first() else { return Ok(vec![]) };
        let scenes = [PreparedScene::new(&with_filter(self.scene, first))?];
        let how = How { engine: self.engine, numeric: Numeric::Fixed, stop: self.stop };
        let made = boundaries(how, &scenes, settings, starts, |_| (self.done)(1))?;
        Ok(made.into_iter().flatten().collect())
    }

    /// Walks a result from the starts of the repeats. Returns the boundaries.
    ///
    /// # Errors
    /// An error of [`best`](Self::best).
    pub fn boundaries(
        &self,
        settings: &VelocitySettings,
        budget: Budget,
    ) -> Result<Boundaries, Error> {
        Ok(self.walks(&[*settings], &starts(budget.repeats))?.pop().unwrap_or_default())
    }

    /// Searches the best tuning, beginning at `start`. Returns the tuning and its boundaries. Wrong tunings are not
    /// walked. Settings that are not free are walked unchanged.
    ///
    /// # Errors
    /// The handle does not reach the wall, or `stop` was set.
    pub fn best(
        &self,
        start: &VelocitySettings,
        is_free: bool,
        budget: Budget,
    ) -> Result<(VelocitySettings, Tuned), Error> {
        interrupt::unless(self.stop)?; // for some estimators the axes take long
        let axes = self.axes(start, is_free);
        let mut tuned = Tuned {
            tried: vec![],
            settled: true,
            boundaries: Boundaries::default(),
            bandwidth_hz: 0.0,
            left_when_mistuned: [None; 2],
            left_when_mass_is_wrong: [None; 2],
            edges: [None; 2],
            hits: 0,
        };
        let mut best = *start;
        if let Some(axes) = &axes {
            let looked: RefCell<Looked<()>> = RefCell::default();
            let walk = |settings: &[VelocitySettings], start: f64| {
                let made = self.walks(settings, &[start])?.into_iter();
                Ok(made.flatten().map(|boundary| ((), boundary)).collect())
            };
            let look = |settings: &[_], soon: &[_], best| {
                let soon = if self.has_lanes(start)? { soon } else { &[] };
                looked.borrow_mut().look(settings, soon, best, |(_, walked)| walked.area, walk)
            };
            let search = Search::over(axes, budget.tunings, look)?;
            tuned.hits = looked.borrow().hits;
            best = search.best().map_or(best, |tried| tried.settings);
            tuned.edges = edges(axes, &best);
            tuned.settled = search.settled;
            tuned.tried = search.tried;
        }
        tuned.bandwidth_hz = bandwidth_hz(&best, &self.scene.design()).map_err(Error::input)?;
        tuned.boundaries = self.boundaries(&best, budget)?;
        tuned.hits += tuned.boundaries.hits();
        Ok((best, tuned))
    }

    /// Whether walks of this estimator can run in lanes. The answer does not depend on the engine that is used.
    ///
    /// # Errors
    /// The scene is not allowed with this estimator.
    pub fn has_lanes(&self, settings: &VelocitySettings) -> Result<bool, Error> {
        let prepared = PreparedScene::new(&with_filter(self.scene, settings))?;
        Ok(lanes_for(&prepared, Numeric::Fixed))
    }

    /// Approximate duration of this estimator's search.
    ///
    /// # Errors
    /// An error of [`has_lanes`](Self::has_lanes).
    pub fn length(&self, start: &VelocitySettings) -> Result<Length, Error> {
        Ok(match (self.has_lanes(start)?, start.name().parameters()[1]) {
            (false, _) => Length::Longest,
            (true, Some(_)) => Length::Long,
            (true, None) => Length::Short,
        })
    }

    /// Whether a tuning lies at an end of the search range.
    pub(in crate::analysis) fn is_at_edge(&self, settings: &VelocitySettings) -> bool {
        let axes = self.axes(settings, true);
        axes.is_some_and(|axes| edges(&axes, settings).iter().any(Option::is_some))
    }

    pub(super) fn axes(&self, start: &VelocitySettings, is_free: bool) -> Option<Axes> {
        let mass_kg = self.scene.device.mass_kg;
        is_free.then(|| Axes::new(start, &self.scene.design(), mass_kg)).flatten()
    }
}

/// Tunes the estimator `start` if `is_free` says so. Otherwise walks its settings unchanged. Calls `done` with the
/// number of finished walks.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn tune(
    engine: Engine,
    scene: &Scene,
    start: &VelocitySettings,
    is_free: bool,
    budget: Budget,
    stop: &AtomicBool,
    done: &(impl Fn(u64) + Sync),
) -> Result<(VelocitySettings, Tuned), Error> {
    let walker = Walker { engine, scene, stop, done };
    let (best, mut tuned) = walker.best(start, is_free, budget)?;
    let area = tuned.boundaries.area();
    // Settings that are wrong: below and above the best settings. At a wrong tuning, the loss of area is multiplied by
    // a share. At a wrong mass of a model, the loss is not scaled.
    let mut wrongs: Vec<(usize, Option<f64>, VelocitySettings)> = vec![];
    let axes = walker.axes(start, is_free);
    for (side, factor) in [1.0 / WRONG_BY, WRONG_BY].into_iter().enumerate() {
        let wrong = axes.as_ref().and_then(|axes| axes.off_by(&best, factor));
        // A whole-number tuning is not wrong by exactly the wanted factor. So the loss is multiplied by the logarithm
        // of the wanted factor, divided by the logarithm of the reached factor.
        let share = |reached: f64| Some(factor.ln() / reached.ln());
        wrongs.extend(wrong.map(|(wrong, reached)| (side, share(reached), wrong)));
    }
    if let VelocitySettings::Observer { mass_kg, .. } = best {
        let factors = [1.0 - MASS_WRONG_BY, 1.0 + MASS_WRONG_BY].into_iter().enumerate();
        let wrong = factors.map(|(side, by)| (side, None, best.with_second(by * mass_kg)));
        wrongs.extend(wrong.filter(|(.., wrong)| wrong.build(&scene.design()).is_ok()));
    }
    wrongs.retain(|_| area > 0.0);
    let settings: Vec<VelocitySettings> = wrongs.iter().map(|(.., settings)| *settings).collect();
    let walked = walker.walks(&settings, &starts(budget.repeats))?;
    for ((side, share, _), boundaries) in wrongs.into_iter().zip(walked) {
        let left = boundaries.area() / area;
        tuned.hits += boundaries.hits();
        match share {
            Some(share) => tuned.left_when_mistuned[side] = Some(1.0 - share * (1.0 - left)),
            None => tuned.left_when_mass_is_wrong[side] = Some(left),
        }
    }
    Ok((best, tuned))
}

/// For each parameter of `best`, the end of the search range that it has reached. `None` if the parameter is further
/// from both ends than the last step.
fn edges(axes: &Axes, best: &VelocitySettings) -> [Option<Edge>; 2] {
    let (_, [tuning, second, ..]) = EstimatorName::of(best);
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

/// The state of a search: the tunings that were tried so far.
pub(super) struct Search {
    pub(super) tried: Vec<Tried>,
    /// Whether the search ended because its steps became small. It is false if the search had to stop before.
    pub(super) settled: bool,
}

impl Search {
    /// Tries at most `tunings` tunings. With two axes, the limit is [`OF_TWO`] times as large. `look` gets the tunings
    /// to try now, the tunings to try next if none of the first is better, and the largest area so far. It returns the
    /// result of each tuning to try now.
    pub(super) fn over(
        axes: &Axes,
        tunings: u32,
        look: impl Fn(&[VelocitySettings], &[VelocitySettings], f64) -> Result<Vec<Look>, Error>,
    ) -> Result<Self, Error> {
        let two = axes.second.is_some();
        let (limit, (part, of)) = match two {
            false => (tunings, FIRST_LOOK[0]),
            true => (OF_TWO * tunings, FIRST_LOOK[1]),
        };
        let lines: &[f64] = &if two { even(LINES) } else { vec![axes.start_second()] };
        let columns = (limit * part / of / if two { LINES } else { 1 }).max(2);
        let mut search = Self { tried: vec![], settled: false };
        let grid = (0..columns).flat_map(|n| {
            let along = f64::from(n) / f64::from(columns - 1);
            lines.iter().map(move |&second| [along, second])
        });
        search.look_at(axes, grid.collect(), &[], limit, &look)?;
        let mut steps = [0.5 / f64::from(columns - 1), 0.5 / f64::from(LINES)];
        let directions = if two { &DIRECTIONS[..] } else { &DIRECTIONS[..2] };
        let [low, high] = axes.bandwidth_hz;
        let last = if axes.whole { LEAST_STEP } else { LAST_STEP.ln() / (high / low).ln() };
        while let Some(centre) = search.best() {
            if steps[0] < last.max(LEAST_STEP) {
                search.settled = true;
                break;
            }
            let mut better = false;
            let [x, y] = centre.place;
            let to = |[dx, dy]: [f64; 2]| {
                [x + dx * steps[0], y + dy * steps[1]].map(|at| at.clamp(0.0, 1.0))
            };
            for (n, &direction) in directions.iter().enumerate() {
                let place = to(direction);
                // The opposite direction may be needed next, so it is walked in parallel with the present direction.
                let soon = directions.get(n + 1).filter(|_| n % 2 == 0).map(|next| to(*next));
                if search.tried.len() >= limit as usize && search.is_new(axes, place) {
                    return Ok(search);
                }
                search.look_at(axes, vec![place], soon.as_slice(), limit, &look)?;
                better = search.best().is_some_and(|best| best.area > centre.area * (1.0 + GAIN));
                if better {
                    break;
                }
            }
            if !better {
                steps = steps.map(|step| 0.5 * step);
            }
        }
        Ok(search)
    }

    /// Tries the new ones of the places, as long as the limit allows it.
    fn look_at(
        &mut self,
        axes: &Axes,
        places: Vec<[f64; 2]>,
        soon: &[[f64; 2]],
        limit: u32,
        look: &impl Fn(&[VelocitySettings], &[VelocitySettings], f64) -> Result<Vec<Look>, Error>,
    ) -> Result<(), Error> {
        let mut fresh: Vec<([f64; 2], VelocitySettings)> = vec![];
        for place in places {
            let settings = axes.at(place);
            let again = fresh.iter().any(|(_, other)| *other == settings);
            let room = self.tried.len() + fresh.len() < limit as usize;
            if room && !again && self.is_new(axes, place) {
                fresh.push((place, settings));
            }
        }
        let settings: Vec<VelocitySettings> = fresh.iter().map(|(_, settings)| *settings).collect();
        let best = self.best().map_or(0.0, |tried| tried.area);
        let room = (limit as usize).saturating_sub(self.tried.len() + fresh.len());
        let mut later: Vec<VelocitySettings> = vec![];
        for place in soon.iter().filter(|place| self.is_new(axes, **place)).take(room) {
            let next = axes.at(*place);
            if !settings.contains(&next) {
                later.push(next);
            }
        }
        let looks = look(&settings, &later, best)?;
        let tried = fresh.into_iter().zip(looks);
        self.tried.extend(tried.map(|((place, settings), Look { area, walks })| Tried {
            place,
            settings,
            area,
            walks,
        }));
        Ok(())
    }

    fn is_new(&self, axes: &Axes, place: [f64; 2]) -> bool {
        let settings = axes.at(place);
        axes.accepts(&settings) && self.tried.iter().all(|tried| tried.settings != settings)
    }

    pub(super) fn best(&self) -> Option<Tried> {
        self.tried.iter().max_by(|a, b| a.area.total_cmp(&b.area)).copied()
    }
}

/// Steps to the neighbours of a tuning: along the first axis, along the second axis, and along both at once.
const DIRECTIONS: [[f64; 2]; 8] = [
    [1.0, 0.0],
    [-1.0, 0.0],
    [0.0, 1.0],
    [0.0, -1.0],
    [1.0, 1.0],
    [-1.0, -1.0],
    [1.0, -1.0],
    [-1.0, 1.0],
];

/// The interval from 0 to 1 is divided into `parts` equal parts. Returns the middle of each part.
fn even(parts: u32) -> Vec<f64> {
    (0..parts).map(|n| (f64::from(n) + 0.5) / f64::from(parts)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::looked::STARTS;
    use super::*;
    use crate::scene::NamedScene;
    use crate::study::sweep::start_offset_counts;

    fn first_two(settings: &VelocitySettings) -> [f64; 2] {
        let (_, [tuning, second, ..]) = EstimatorName::of(settings);
        [tuning, second]
    }

    /// Searches a synthetic surface. Returns the tried tunings, the best tuning, and whether the search settled.
    fn search(
        name: EstimatorName,
        tunings: u32,
        area: impl Fn([f64; 2]) -> f64,
    ) -> (Vec<[f64; 2]>, [f64; 2], bool) {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let axes = Axes::new(&name.defaults(), &scene.design(), 0.416).unwrap();
        let of = |settings: &VelocitySettings| Look { area: area(first_two(settings)), walks: 2 };
        let look =
            |settings: &[VelocitySettings], _: &[_], _| Ok(settings.iter().map(of).collect());
        let search = Search::over(&axes, tunings, look).unwrap();
        let looked = search.tried.iter().map(|tried| first_two(&tried.settings));
        let best = first_two(&search.best().unwrap().settings);
        (looked.collect(), best, search.settled)
    }

    /// A hill of height 1. At a ratio of 1.2 its height is 95 %.
    fn hill(ratio: f64) -> f64 {
        (-0.05 * (ratio.ln() / 1.2f64.ln()).powi(2)).exp()
    }

    #[test]
    fn it_settles_at_the_top_of_a_hill() {
        for top in [60.0, 120.0, 1700.0, 4000.0] {
            let (looked, [found, _], settled) =
                search(EstimatorName::FirstOrder, 24, |[hz, _]| hill(hz / top));
            assert!(settled && hill(found / top) > 0.995, "{found} for {top}");
            assert!((14..=24).contains(&looked.len()), "{}", looked.len());
            // A larger budget finds no larger area. The search starts with a finer grid, and it also settles.
            let (_, [again, _], settled) =
                search(EstimatorName::FirstOrder, 48, |[hz, _]| hill(hz / top));
            assert!(settled && hill(again / top) > 0.995, "{again} for {top}");
        }
    }

    #[test]
    fn a_second_parameter_is_found_on_a_ridge_across_the_axes() {
        for (top, best) in [(3.0, 2.2), (40.0, 0.6), (15.0, 1.0)] {
            // The bandwidth is proportional to sqrt(C). The ridge is narrow across the diagonal and flat along the
            // diagonal.
            let ridge = |[c, lambda]: [f64; 2]| {
                let (x, y) = ((c / top).sqrt().ln(), (lambda / best).ln());
                hill((2.0 * (x + y)).exp()) * hill((0.5 * (x - y)).exp())
            };
            let (looked, [c, lambda], settled) = search(EstimatorName::LevantExplicit, 24, ridge);
            assert!(settled && ridge([c, lambda]) > 0.99, "{c} {lambda} for {top} {best}");
            assert!(looked.len() <= 96);
        }
    }

    #[test]
    fn a_search_that_runs_out_of_tunings_says_so() {
        let (looked, _, settled) =
            search(EstimatorName::LevantExplicit, 4, |[c, _]| hill(c / 13.0));
        assert!(!settled && looked.len() == 16, "{}", looked.len());
        let (looked, _, settled) = search(EstimatorName::FirstOrder, 3, |[hz, _]| hill(hz / 900.0));
        assert!(!settled && looked.len() == 3, "{}", looked.len());
    }

    #[test]
    fn a_start_of_the_search_is_no_repeats() {
        for repeats in 1..=1000 {
            for repeat in 0..repeats {
                let offset = start_offset_counts(repeat, repeats);
                assert!(STARTS.iter().all(|start| (start - offset).abs() > 1e-7), "{repeats}");
            }
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
                let (mut looked, [found, _], settled) = search(name, 24, |[n, _]| hill(n / top));
                assert!(settled && found == top, "{name:?}: {found} for {top}");
                assert!(looked.iter().any(|[n, _]| *n == smallest), "{name:?}: {looked:?}");
                let tried = looked.len();
                looked.sort_by(|a, b| a[0].total_cmp(&b[0]));
                looked.dedup();
                assert_eq!(looked.len(), tried, "one was looked at twice");
            }
        }
    }

    #[test]
    fn an_end_of_the_range_is_named_with_its_reason() {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let of = |name: EstimatorName, place| {
            let axes = Axes::new(&name.defaults(), &scene.design(), 0.416).unwrap();
            edges(&axes, &axes.at(place))
        };
        assert_eq!(of(EstimatorName::TrackingLoop, [1.0, 0.0]), [Some(Edge::Core), None]);
        assert_eq!(of(EstimatorName::Butterworth, [0.0, 0.0]), [Some(Edge::Search), None]);
        assert_eq!(of(EstimatorName::Butterworth, [0.5, 0.0]), [None; 2]);
        assert_eq!(of(EstimatorName::LevantExplicit, [0.5, 1.0]), [None, Some(Edge::Core)]);
        assert_eq!(of(EstimatorName::FoawEnd, [0.5, 0.0])[1], Some(Edge::Search));
    }
}
