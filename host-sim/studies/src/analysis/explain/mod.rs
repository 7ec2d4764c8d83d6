//! Finds what limits the walls of a device. One element is changed at a time. The velocity filter is tuned again for
//! each change.
//!
//! The tuning is the search of [`compare`](super::compare), for the area of the boundary. So each change has its best
//! filter, and the remaining difference comes from the element. The estimator is also an element. All estimators that
//! need only the position are screened from one start. The best three are searched with twice the usual number of
//! tunings, because each estimator has its own rough surface.
//!
//! **Errors of a search.** The surface of areas is rough, so two searches may end at maxima of different heights. In
//! this case an element without effect would seem to have an effect. So the unchanged scene is tried with the tunings
//! of all changes. Each change is tried with the tuning of the scene. The best result is used. The gain over the result
//! of the search is the share that the search has [missed](Explained::missed). A difference between changes that is
//! smaller than this share is not reported.
//!
//! **Ranges.** Each boundary is walked from starts that are spread over a count. If the scene has noise, each start has
//! its own noise. One change ranks below another only if Welch's t-test (one-sided, 5 %) shows that its area is
//! smaller.

mod changes;
pub mod table;

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use zwidth::{VelocitySettings, velocity::EstimatorName};

pub use changes::{CLOCK_HZ, Change, Kind, changes, cost_of_estimator};

use super::compare::{
    Entry, Tuned, damping_of,
    looked::STARTS,
    search::{Budget, Walker},
    settings_of, signal,
};
use crate::{
    engine::Engine,
    error::Error,
    numerics::statistics::Repeats,
    scene::Scene,
    study::{
        boundary::Boundaries,
        schedule::{Length, longest_first},
        sweep::starts,
    },
};

/// Number of estimators that are searched in full after the screening.
const FINALISTS: usize = 3;
/// Number of tunings of an estimator's full search, divided by the usual number.
const FINAL_TUNINGS: u32 = 2;
/// Number of walks that each change needs in addition to its search. The scene is walked with the change's tuning. The
/// change is walked with its own tuning and with the scene's tuning.
const POOLED: u64 = 3 * STARTS.len() as u64;
/// Number of tunings that are tried if the plant is integrated step by step. Such a walk takes ten times as long.
const INTEGRATED_TUNINGS: u32 = 5;

/// A scene with one changed element, and the boundaries of its stable walls.
#[derive(Clone, Debug)]
pub struct Explained {
    pub change: Change,
    /// The estimator with its best tuning.
    pub settings: VelocitySettings,
    /// Boundaries with this tuning. Each start has one boundary.
    pub boundaries: Boundaries,
    /// Boundaries by the scene's own criterion. `None` if the search already used this criterion.
    pub beside: Option<Boundaries>,
    /// Noise of the velocity estimate in motion, in m/s RMS.
    pub noise_m_per_s: f64,
    /// Whether the search ended because no neighbour is better. It is false if the search has [missed](Self::missed) a
    /// better result.
    pub settled: bool,
    /// The share of area that the search has missed, as far as is known. The tuning of another change gives an area
    /// that is larger by this share.
    pub missed: f64,
    /// Whether the best tuning is at an end of the search range.
    pub at_edge: bool,
    /// Number of hits of the search and of the result. For the best estimator, the hits of all tried estimators are
    /// counted.
    pub hits: u64,
}

impl Explained {
    /// Mean, smallest and largest of the values. Each boundary has one value.
    pub fn range(values: &[f64]) -> [f64; 3] {
        let of = |pick: fn(f64, f64) -> f64| values.iter().copied().reduce(pick).unwrap_or(0.0);
        [Repeats::of(values.iter().copied()).mean, of(f64::min), of(f64::max)]
    }

    /// Mean, smallest and largest area of the boundaries, in N^2 s/m^2.
    pub fn area(&self) -> [f64; 3] {
        Self::range(&self.boundaries.areas())
    }

    /// Mean, smallest and largest of the boundaries' largest K, in N/m.
    pub fn stiffness_peak(&self) -> [f64; 3] {
        Self::range(&self.boundaries.stiffness_peaks_n_per_m())
    }

    /// Mean, smallest and largest K of the boundaries at B = `damping_n_s_per_m`, in N/m.
    pub fn stiffness_at(&self, damping_n_s_per_m: f64) -> [f64; 3] {
        Self::range(&self.boundaries.stiffnesses_at(damping_n_s_per_m))
    }

    /// The area divided by the area of the unchanged scene. The first value is the ratio of the means. The others are
    /// the smallest and the largest ratio that the starts allow.
    pub fn times(&self, base: &Self) -> Option<[f64; 3]> {
        let ([mean, low, high], [of, of_low, of_high]) = (self.area(), base.area());
        (of_low > 0.0).then(|| [mean / of, low / of_high, high / of_low])
    }
}

/// The answer to what limits the walls of a scene.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// The unchanged scene with its best tuning.
    pub base: Explained,
    /// The changes. The one with the largest area comes first.
    pub changes: Vec<Explained>,
    /// The B at which K is read, in N s/m.
    pub damping_n_s_per_m: f64,
}

impl Explanation {
    /// Rank of the change with the index `place`. It is 1 plus the number of changes that are certainly better.
    pub fn rank(&self, place: usize) -> usize {
        let own = &self.changes[place];
        let better = |other: &&Explained| own.is_below(other);
        1 + self.changes.iter().filter(better).count()
    }

    pub fn best_of(&self, kind: Kind) -> Option<&Explained> {
        self.changes.iter().find(|one| one.change.kind == kind)
    }

    /// Whether a change is certainly better than the unchanged scene.
    pub fn is_better(&self, change: &Explained) -> bool {
        self.base.is_below(change)
    }

    /// Whether a change is certainly worse than the unchanged scene.
    pub fn is_worse(&self, change: &Explained) -> bool {
        change.is_below(&self.base)
    }
}

/// Estimators that may replace the scene's estimator. These estimators need only the position. The scene's own
/// estimator is left out.
pub fn estimators(scene: &Scene) -> Vec<EstimatorName> {
    let own = scene.velocity.estimator();
    let named = Entry::usual(scene).into_iter().filter_map(|entry| match entry {
        Entry::Tuned(name) if name != own => Some(name),
        _ => None,
    });
    named.filter(|name| name.sense().is_none()).collect()
}

/// Budget for the screening of an estimator. The number of tunings is the same as for any other element. Each tuning is
/// walked from one start.
fn screening(budget: Budget) -> Budget {
    Budget { repeats: 1, ..budget }
}

fn final_search(budget: Budget) -> Budget {
    Budget { tunings: FINAL_TUNINGS * budget.tunings, ..budget }
}

pub fn most_walks(scene: &Scene, budget: Budget) -> u64 {
    let names = estimators(scene);
    let changes = changes(scene, &names).len() as u64;
    changes * (budget.most() + POOLED)
        + FINALISTS as u64 * final_search(budget).most()
        + names.len() as u64 * screening(budget).most()
}

/// Walks the scene and every changed scene. The result does not depend on the number of threads or on `engine`.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn explain(
    engine: Engine,
    (scene, beside): (&Scene, Option<&Scene>),
    damping_n_s_per_m: Option<f64>,
    budget: Budget,
    stop: &AtomicBool,
    done: impl Fn(u64) + Sync,
) -> Result<Explanation, Error> {
    let of = |changed: &Scene, start: &VelocitySettings, budget: Budget| {
        let quick = changed.integrator.is_none() || scene.integrator.is_some();
        let most = if quick { u32::MAX } else { INTEGRATED_TUNINGS };
        let budget = Budget { tunings: budget.tunings.min(most), ..budget };
        Walker { engine, scene: changed, stop, done: &done }.best(start, true, budget)
    };
    let found = |change: Change, (settings, tuned): (VelocitySettings, Tuned)| Explained {
        change,
        settings,
        boundaries: tuned.boundaries,
        beside: None,
        noise_m_per_s: 0.0,
        settled: tuned.settled,
        missed: 0.0,
        at_edge: tuned.edges.iter().any(Option::is_some),
        hits: tuned.hits,
    };
    let first = || scene.velocity.at(scene.sweep.cutoffs_hz[0]);
    let own = scene.velocity.settings().unwrap_or_else(first);
    let names = estimators(scene);
    let asked = [vec![Change::none(scene)], changes(scene, &names)].concat();
    let start = |name: EstimatorName, changed: &Scene| settings_of(Entry::Tuned(name), changed);
    let length = |Change { scene, estimators, .. }: &Change| -> Result<Length, Error> {
        let first = estimators.first().map_or(own, |name| start(*name, scene));
        let own = Walker { engine, scene, stop, done: &done }.length(&first)?;
        Ok(if estimators.is_empty() { own } else { own.max(Length::Long) })
    };
    let lengths = asked.iter().map(length).collect::<Result<Vec<_>, Error>>()?;
    let explained = longest_first(&lengths, |n| {
        let change = &asked[n];
        let changed = &change.scene;
        let start = |name: EstimatorName| start(name, changed);
        match change.estimators[..] {
            [] => Ok(found(change.clone(), of(changed, &own, budget)?)),
            [name] => Ok(found(change.clone(), of(changed, &start(name), budget)?)),
            ref names => {
                let screened: Vec<Result<(f64, u64, EstimatorName), Error>> = names
                    .par_iter()
                    .map(|&name| {
                        let (_, tuned) = of(changed, &start(name), screening(budget))?;
                        Ok((tuned.boundaries.area(), tuned.hits, name))
                    })
                    .collect();
                let mut screened = screened.into_iter().collect::<Result<Vec<_>, _>>()?;
                screened.sort_by(|a, b| b.0.total_cmp(&a.0));
                let mut hits: u64 = screened.iter().map(|(_, hits, _)| hits).sum();
                screened.truncate(FINALISTS);
                let searched: Vec<Result<_, Error>> = screened
                    .par_iter()
                    .map(|(_, _, name)| {
                        Ok((*name, of(changed, &start(*name), final_search(budget))?))
                    })
                    .collect();
                let searched = searched.into_iter().collect::<Result<Vec<_>, _>>()?;
                let area = |searched: &(EstimatorName, (VelocitySettings, Tuned))| {
                    searched.1.1.boundaries.area()
                };
                hits += searched.iter().map(|(_, (_, tuned))| tuned.hits).sum::<u64>();
                let best = searched.into_iter().max_by(|a, b| area(a).total_cmp(&area(b)));
                let (name, best) = best.ok_or_else(|| {
                    Error::Internal("no estimator in place of the scene's".into())
                })?;
                let (cost, cycles_per_s) = cost_of_estimator(scene, name);
                let text = format!("the best estimator, {}", name.text());
                let change = Change { text, cost, cycles_per_s, ..change.clone() };
                Ok(Explained { hits, ..found(change, best) })
            }
        }
    });
    let mut explained = explained.into_iter().collect::<Result<Vec<_>, Error>>()?;
    let mut base = explained.remove(0);
    let starts = starts(budget.repeats);
    let walks = |changed: &Scene, settings: &[VelocitySettings], starts: &[f64]| {
        Walker { engine, scene: changed, stop, done: &done }.walks(settings, starts)
    };
    pool(&walks, &mut base, &mut explained, &starts)?;
    let same = |own| [vec![Change::none(own)], changes(own, &names)].concat();
    let same = beside.map_or_else(Vec::new, same);
    let conclude = |one: &mut Explained| {
        let changed = &one.change.scene;
        let signal = signal::measure(changed, one.settings).map_err(Error::input)?;
        let walker = Walker { engine, scene: changed, stop, done: &done };
        let at_edge = match one.missed > 0.0 {
            true => walker.is_at_edge(&one.settings),
            false => one.at_edge,
        };
        let own = same.iter().find(|other| other.name == one.change.name);
        let walked = own.map(|own| walks(&own.scene, &[one.settings], &starts)).transpose()?;
        one.beside = walked.and_then(|mut walked| walked.pop());
        (one.noise_m_per_s, one.at_edge) = (signal.noise_in_motion_m_per_s, at_edge);
        Ok::<_, Error>(())
    };
    explained.par_iter_mut().chain([&mut base]).try_for_each(conclude)?;
    explained.sort_by(|a, b| b.boundaries.area().total_cmp(&a.boundaries.area()));
    let damping_n_s_per_m =
        damping_n_s_per_m.unwrap_or_else(|| damping_of(Some(&base.boundaries), scene));
    Ok(Explanation { base, changes: explained, damping_n_s_per_m })
}

/// A function that makes walks. It gets a scene, several tunings of one estimator, and the starts.
type Walks<'a> =
    dyn Fn(&Scene, &[VelocitySettings], &[f64]) -> Result<Vec<Boundaries>, Error> + Sync + 'a;

/// Tries the scene with the tunings of its changes, and the changes with the tuning of the scene.
fn pool(
    walks: &Walks<'_>,
    base: &mut Explained,
    explained: &mut [Explained],
    starts: &[f64],
) -> Result<(), Error> {
    let estimator = base.settings.name();
    let like = |one: &Explained| one.settings.name() == estimator;
    let others = explained.iter().filter(|one| like(one)).map(|one| one.settings).collect();
    base.try_at(walks, others, starts)?;
    explained
        .par_iter_mut()
        .filter(|one| like(one))
        .try_for_each(|one| one.try_at(walks, vec![base.settings], starts))
}

impl Explained {
    /// Whether the area is certainly below another area. The difference must be larger than what the searches have
    /// missed.
    fn is_below(&self, other: &Self) -> bool {
        let same = 1.0 / (1.0 + self.missed.max(other.missed));
        self.boundaries.repeats().is_below(same, &other.boundaries.repeats())
    }

    /// Walks the scene with the tunings `others`. Uses the best of these tunings and the own tuning.
    fn try_at(
        &mut self,
        walks: &Walks<'_>,
        others: Vec<VelocitySettings>,
        starts: &[f64],
    ) -> Result<(), Error> {
        let scene = &self.change.scene;
        let mut all = vec![self.settings];
        for other in others {
            if !all.contains(&other) && other.build(&scene.design()).is_ok() {
                all.push(other);
            }
        }
        if all.len() == 1 {
            return Ok(());
        }
        let areas: Vec<f64> = walks(scene, &all, &STARTS)?.iter().map(Boundaries::area).collect();
        let best = (1..all.len()).max_by(|a, b| areas[*a].total_cmp(&areas[*b]));
        let Some(best) = best.filter(|best| areas[*best] > areas[0]) else { return Ok(()) };
        self.boundaries = walks(scene, &all[best..=best], starts)?.pop().unwrap_or_default();
        (self.settings, self.settled) = (all[best], false);
        self.hits += self.boundaries.hits();
        self.missed = if areas[0] > 0.0 { areas[best] / areas[0] - 1.0 } else { f64::INFINITY };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    /// A scene with a short hit and a coarse grid, so that the test is fast.
    fn scene() -> Scene {
        let mut scene = NamedScene::load("paper-2um").unwrap().scene;
        (scene.wall_hit.settle_s, scene.wall_hit.window_s) = (1.0, 0.1);
        let walk = &mut scene.walk;
        (walk.stiffness_start_n_per_m, walk.stiffness_step_n_per_m) = (4000.0, 4000.0);
        (walk.damping_start_n_s_per_m, walk.damping_step_n_s_per_m) = (30.0, 30.0);
        (walk.stiffness_max_n_per_m, walk.damping_max_n_s_per_m) = (4e5, 1200.0);
        scene
    }

    fn explained(threads: usize) -> Explanation {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (budget, stop) = (Budget { tunings: 3, repeats: 4 }, AtomicBool::new(false));
        let engine = Engine::lanes();
        pool.install(|| explain(engine, (&scene(), None), None, budget, &stop, |_| ()).unwrap())
    }

    #[test]
    #[ignore = "two explanations take half a minute; .ci/long runs it"]
    fn threads_change_nothing_and_the_larger_area_stands_first() {
        let (one, many) = (explained(1), explained(3));
        assert_eq!(one.base.boundaries, many.base.boundaries);
        for (place, (a, b)) in one.changes.iter().zip(&many.changes).enumerate() {
            let name = |one: &Explained| one.change.name;
            assert_eq!(name(a), name(b));
            assert_eq!((&a.boundaries, a.settings), (&b.boundaries, b.settings), "{}", name(a));
            assert!(one.rank(place) <= place + 1);
            let before = place.checked_sub(1).map(|before| one.changes[before].area()[0]);
            assert!(before.is_none_or(|before| before >= a.area()[0]));
        }
        // Half the latency gives more area. An additional amplifier gives less area. Both areas differ from that of the
        // unchanged scene.
        let of = |name: &str| {
            let is_it = |one: &&Explained| one.change.name == name;
            one.changes.iter().find(is_it).unwrap()
        };
        let (soon, slow) = (of("latency-half"), of("amplifier-1khz"));
        assert!(one.is_better(soon) && !one.is_worse(soon) && one.is_worse(slow));
        assert!(soon.times(&one.base).unwrap()[1] > 1.5 && slow.times(&one.base).unwrap()[2] < 1.0);
    }

    #[test]
    fn a_scene_is_asked_about_position_only_estimators_but_its_own() {
        let names = estimators(&scene());
        assert!(names.contains(&EstimatorName::Kalman3) && names.len() > 8);
        assert!(!names.contains(&EstimatorName::Butterworth));
        assert!(names.iter().all(|name| name.sense().is_none()));
    }
}
