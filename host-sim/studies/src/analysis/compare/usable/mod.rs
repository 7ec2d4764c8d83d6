//! Fidelity as a limit: the area of the walls that are stable and are rendered as commanded.
//!
//! A wall is usable within a limit if the magnitude of its rendered impedance is correct within this limit, from 1 to
//! 30 Hz ([`Rendered`]). The usable area is the part of a boundary's area with usable walls. The usable area is
//! computed from the walks of the whole area, without further hits. Each estimator is tuned again for each limit, with
//! the search of [`search`](super::search) and from the starts of that search.

mod table;

use std::{cell::RefCell, sync::atomic::AtomicBool};

use rayon::prelude::*;
use zwidth::{VelocitySettings, velocity::EstimatorName};

use super::{
    Entry,
    looked::Looked,
    search::{Budget, OF_TWO, Search, WALKS_OF_A_TRY, Walker},
    settings_of,
};
use crate::{
    analysis::rendered::Rendered,
    engine::Engine,
    error::Error,
    range::within,
    scene::Scene,
    study::boundary::{Boundaries, Boundary, BoundaryPoint},
    study::schedule::longest_first,
    study::sweep::starts,
};

/// Number of parts into which a column of K is divided. The error is computed in each part.
const PARTS: u32 = 100;

pub use table::{UsableArea, UsableStudy, parameters};

/// Default limits in percent, in the form that a user types.
pub const PERCENTS: &str = "5,10,20";
/// The estimators that are compared by default: the usual ones of each kind. The slowest comes first.
const USUAL: [EstimatorName; 10] = [
    EstimatorName::Observer,
    EstimatorName::Butterworth,
    EstimatorName::FirstOrder,
    EstimatorName::LeastSquares2,
    EstimatorName::TrackingLoop,
    EstimatorName::Kalman2,
    EstimatorName::Kalman3,
    EstimatorName::LevantExplicit,
    EstimatorName::FoawEnd,
    EstimatorName::FoawBest,
];

/// The default estimators whose inputs the scene has.
pub fn usual(scene: &Scene) -> Vec<Entry> {
    let all = Entry::all(scene);
    USUAL.map(Entry::Tuned).into_iter().filter(|entry| all.contains(entry)).collect()
}

/// Checks limits in percent. Returns them in ascending order and without repetition. Error messages name the list with
/// `name`.
///
/// # Errors
/// A limit is out of range.
pub fn percents(asked: &[f64], name: &str) -> Result<Vec<f64>, Error> {
    for &percent in asked {
        within(name, percent, 0.1..=1000.0).map_err(Error::Input)?;
    }
    let mut percents = asked.to_vec();
    percents.sort_by(f64::total_cmp);
    percents.dedup();
    Ok(percents)
}

#[derive(Clone, Debug)]
pub struct UsableQuestion {
    pub entries: Vec<Entry>,
    /// Limits of the error of a rendered impedance, as fractions. An infinite limit allows any error.
    pub limits: Vec<f64>,
    pub budget: Budget,
}

impl UsableQuestion {
    /// A question for these estimators. Its limits are `percents`, and then one limit that allows any error.
    pub fn of(entries: Vec<Entry>, percents: &[f64], budget: Budget) -> Self {
        let limits = percents.iter().map(|percent| percent / 100.0).chain([f64::INFINITY]);
        Self { entries, limits: limits.collect(), budget }
    }

    pub fn most_walks(&self) -> u64 {
        let search = u64::from(OF_TWO * self.budget.tunings * WALKS_OF_A_TRY);
        let each = self.limits.len() as u64 * (search + u64::from(self.budget.repeats));
        self.entries.len() as u64 * each
    }
}

/// An estimator at its best tuning for one limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Usable {
    pub entry: Entry,
    /// Limit of the error of a rendered impedance, as a fraction.
    pub limit: f64,
    pub settings: VelocitySettings,
    /// Whether the search ended because no neighbour of its result is better.
    pub settled: bool,
    /// Boundaries of the stable walls. Each start has one boundary.
    pub boundaries: Boundaries,
    /// The part of each boundary's area that is usable within the limit, in N^2 s/m^2.
    pub areas: Vec<f64>,
    /// The largest usable K in all boundaries, in N/m.
    pub stiffness_peak_n_per_m: f64,
    /// Mean error over the stable walls of all boundaries. All walls have the same weight.
    pub error_mean: f64,
    /// For each B of the first boundary, the largest usable K.
    pub outline: Vec<BoundaryPoint>,
    /// Number of hits of the walks for this limit. Hits that were already made for earlier limits are not counted
    /// again.
    pub hits: u64,
}

impl Usable {
    /// Mean of `areas`, in N^2 s/m^2.
    pub fn area(&self) -> f64 {
        self.repeats().mean
    }

    pub fn repeats(&self) -> crate::numerics::statistics::Repeats {
        crate::numerics::statistics::Repeats::of(self.areas.iter().copied())
    }
}

/// The usable part of one boundary for each limit, and the mean error over the boundary.
#[derive(Clone, Debug, Default)]
struct Parts {
    areas: Vec<f64>,
    peaks: Vec<f64>,
    outlines: Vec<Vec<BoundaryPoint>>,
    errors: f64,
}

/// A boundary with its usable parts.
type Judged = (Parts, Boundary);

fn parts(boundary: &Boundary, rendered: &Rendered, limits: &[f64]) -> Parts {
    let mut parts = Parts {
        areas: vec![0.0; limits.len()],
        peaks: vec![0.0; limits.len()],
        outlines: vec![vec![]; limits.len()],
        errors: 0.0,
    };
    let sum: f64 = boundary.points.iter().map(|point| point.stiffness_n_per_m).sum();
    if sum == 0.0 {
        return parts;
    }
    for &BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m } in &boundary.points {
        // Because of this factor, the sum of all columns is equal to the boundary's area.
        let column = boundary.area * stiffness_n_per_m / sum;
        let mut highest = vec![0.0; limits.len()];
        for part in 0..PARTS {
            let at = (f64::from(part) + 0.5) / f64::from(PARTS);
            let error = rendered.error(at * stiffness_n_per_m, damping_n_s_per_m);
            parts.errors += error * column / f64::from(PARTS);
            for (n, _) in limits.iter().enumerate().filter(|(_, limit)| error <= **limit) {
                parts.areas[n] += column / f64::from(PARTS);
                highest[n] = f64::from(part + 1) / f64::from(PARTS) * stiffness_n_per_m;
            }
        }
        for (n, stiffness_n_per_m) in highest.into_iter().enumerate().filter(|(_, k)| *k > 0.0) {
            parts.peaks[n] = parts.peaks[n].max(stiffness_n_per_m);
            parts.outlines[n].push(BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m });
        }
    }
    parts.errors /= boundary.area;
    parts
}

/// Tunes every estimator for every limit. Calls `done` with the number of finished walks.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn usable(
    engine: Engine,
    scene: &Scene,
    question: &UsableQuestion,
    stop: &AtomicBool,
    done: impl Fn(u64) + Sync,
) -> Result<Vec<Usable>, Error> {
    let entries = &question.entries;
    let lengths = entries.iter().map(|entry| entry.length(engine, scene, stop));
    let lengths = lengths.collect::<Result<Vec<_>, Error>>()?;
    let all =
        longest_first(&lengths, |n| of_entry(engine, scene, entries[n], question, stop, &done));
    Ok(all.into_iter().collect::<Result<Vec<_>, Error>>()?.concat())
}

fn of_entry(
    engine: Engine,
    scene: &Scene,
    entry: Entry,
    question: &UsableQuestion,
    stop: &AtomicBool,
    done: &(impl Fn(u64) + Sync),
) -> Result<Vec<Usable>, Error> {
    let UsableQuestion { limits, budget, .. } = question;
    let scene = &entry.told(scene);
    let walker = Walker { engine, scene, stop, done };
    let judged = |settings: &VelocitySettings, boundaries: Boundaries| {
        let rendered = Rendered::of(scene, *settings)?;
        let of = |boundary: Boundary| (parts(&boundary, &rendered, limits), boundary);
        Ok::<_, Error>(boundaries.into_iter().map(of).collect::<Vec<Judged>>())
    };
    let walk = |settings: &[VelocitySettings], start: f64| {
        let made = walker.walks(settings, &[start])?;
        let judged: Vec<Result<Vec<Judged>, Error>> =
            settings.par_iter().zip(made).map(|(one, made)| judged(one, made)).collect();
        Ok(judged.into_iter().collect::<Result<Vec<_>, Error>>()?.concat())
    };
    // Every tuning that was tried for one of the limits.
    let looked: RefCell<Looked<Parts>> = RefCell::default();
    let start = settings_of(entry, scene);
    let has_lanes = walker.has_lanes(&start)?;
    let axes = walker.axes(&start, entry != Entry::AdHoc);
    let mut results: Vec<(VelocitySettings, Vec<Judged>)> = vec![];
    let mut found: Vec<Usable> = vec![];
    for (n, &limit) in limits.iter().enumerate() {
        let (mut settings, mut settled, mut hits) = (start, true, 0);
        if let Some(axes) = &axes {
            let before = looked.borrow().hits;
            let look = |settings: &[_], soon: &[_], best| {
                let soon = if has_lanes { soon } else { &[] };
                looked.borrow_mut().look(settings, soon, best, |(parts, _)| parts.areas[n], walk)
            };
            let search = Search::over(axes, budget.tunings, look)?;
            settings = search.best().map_or(start, |tried| tried.settings);
            settled = search.settled;
            hits = looked.borrow().hits - before;
        }
        let result = match results.iter().find(|(other, _)| *other == settings) {
            Some((_, result)) => result.clone(),
            None => {
                let boundaries = walker.walks(&[settings], &starts(budget.repeats))?.pop();
                let boundaries = boundaries.unwrap_or_default();
                hits += boundaries.hits();
                let result = judged(&settings, boundaries)?;
                results.push((settings, result.clone()));
                result
            }
        };
        let area: f64 = result.iter().map(|(_, boundary)| boundary.area).sum();
        let errors = result.iter().map(|(parts, boundary)| parts.errors * boundary.area);
        let peaks = result.iter().map(|(parts, _)| parts.peaks[n]);
        found.push(Usable {
            entry,
            limit,
            settings,
            settled,
            areas: result.iter().map(|(parts, _)| parts.areas[n]).collect(),
            stiffness_peak_n_per_m: peaks.fold(0.0, f64::max),
            error_mean: if area > 0.0 { errors.sum::<f64>() / area } else { 0.0 },
            outline: result.first().map(|(parts, _)| parts.outlines[n].clone()).unwrap_or_default(),
            boundaries: result.into_iter().map(|(_, boundary)| boundary).collect(),
            hits,
        });
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;
    use zwidth::experiment::Ended;

    /// A boundary whose columns all have the same height.
    fn rectangle(stiffness_n_per_m: f64, dampings: u32) -> Boundary {
        let points = (1..=dampings)
            .map(|n| BoundaryPoint { damping_n_s_per_m: 10.0 * f64::from(n), stiffness_n_per_m });
        let area = stiffness_n_per_m * 10.0 * f64::from(dampings);
        Boundary { points: points.collect(), area, hits: 1, ended: Some(Ended::Closed) }
    }

    #[test]
    fn what_is_not_rendered_as_commanded_is_a_sector_of_the_plane() {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let filter = VelocitySettings::Butterworth { cutoff_hz: 200.0 };
        let rendered = Rendered::of(&scene, filter).unwrap();
        let boundary = rectangle(40_000.0, 40);
        let limits = [f64::INFINITY, 0.1, 0.05, 1e-6];
        let parts = parts(&boundary, &rendered, &limits);
        assert!((parts.areas[0] / boundary.area - 1.0).abs() < 1e-9);
        assert!(parts.areas[1] < 0.9 * parts.areas[0] && parts.areas[2] < 0.8 * parts.areas[1]);
        assert_eq!((parts.areas[3], parts.peaks[3], parts.outlines[3].len()), (0.0, 0.0, 0));
        assert_eq!(parts.peaks[..2], [40_000.0; 2], "at small B any K is rendered");
        // For comparison, the ratio K / B is computed directly at both edges of the usable sector. The ratio is the
        // same at every B.
        let within = |ratio: f64| rendered.error(ratio * 100.0, 100.0) <= 0.1;
        let ratios = (1..200_000).map(|n| 0.02 * f64::from(n));
        let share = |b: f64| {
            let inside = ratios.clone().filter(|r| r * b < 40_000.0);
            let (mut all, mut good) = (0u32, 0u32);
            for ratio in inside {
                all += 1;
                good += u32::from(within(ratio));
            }
            f64::from(good) / f64::from(all)
        };
        let by_hand: f64 = [50.0, 200.0, 400.0].map(share).iter().sum();
        let column = |b: f64| {
            let one = Boundary {
                points: vec![BoundaryPoint { damping_n_s_per_m: b, stiffness_n_per_m: 40_000.0 }],
                area: 1.0,
                ..rectangle(1.0, 1)
            };
            super::parts(&one, &rendered, &limits).areas[1]
        };
        let here: f64 = [50.0, 200.0, 400.0].map(column).iter().sum();
        assert!((here - by_hand).abs() < 0.05 && here < 2.9, "{here} {by_hand}");
    }

    #[test]
    fn a_stricter_limit_takes_a_faster_filter_and_leaves_less() {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        (scene.wall_hit.settle_s, scene.wall_hit.window_s) = (1.5, 0.5);
        scene.wall_hit.rms_limit_m = 1e-6;
        scene.wall_hit.rms_of = Some(crate::scene::RmsOf::Motion);
        (scene.walk.stiffness_step_n_per_m, scene.walk.damping_step_n_s_per_m) = (4000.0, 40.0);
        let question = UsableQuestion {
            entries: vec![Entry::Tuned(EstimatorName::Butterworth)],
            limits: vec![f64::INFINITY, 0.02],
            budget: Budget { tunings: 12, repeats: 1 },
        };
        let stop = AtomicBool::new(false);
        let found = usable(Engine::lanes(), &scene, &question, &stop, |_| {}).unwrap();
        let [any, strict] = &found[..] else { panic!("{found:?}") };
        assert!(strict.area() < any.area() && strict.area() > 0.0, "{found:?}");
        let hz = |usable: &Usable| match usable.settings {
            VelocitySettings::Butterworth { cutoff_hz } => cutoff_hz,
            _ => 0.0,
        };
        assert!(hz(strict) > hz(any), "{} {}", hz(strict), hz(any));
        assert_eq!(any.area(), any.boundaries.area());
        assert!(strict.error_mean < any.error_mean);
    }
}
