//! The walks that a search has made, for each tuning. Each tuning is walked from the first start. A tuning is walked
//! from the second start only if it can still win.
//!
//! Suppose that the first area of a tuning is below [`CAN_WIN`] times the best area. Then the tuning could only win
//! with a second area above 105 % of the best area. In the searches of paper-1um, second areas of these tunings reached
//! at most 95 % of the best area. So these tunings cannot win, and one walk is enough.

use zwidth::VelocitySettings;

use crate::{error::Error, numerics::statistics::Repeats, study::boundary::Boundary};

/// Positions at which the walks of a search start, in counts. The first start is the golden section. The second start
/// is half a count further. The repeats never use these starts.
pub(in crate::analysis) const STARTS: [f64; 2] = [0.118_033_988_749_895, 0.618_033_988_749_895];

/// Smallest first area of a tuning that is also walked from the second start, as a share of the best area.
pub const CAN_WIN: f64 = 0.95;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    /// Mean area of the boundaries that the walks found, in N^2 s/m^2.
    pub(super) area: f64,
    pub(super) walks: u32,
}

pub(super) struct Looked<T> {
    /// The tunings that were walked. A tuning has one boundary for each start of its walks. Each boundary has a
    /// judgement.
    made: Vec<(VelocitySettings, Vec<(T, Boundary)>)>,
    pub(super) hits: u64,
}

impl<T> Default for Looked<T> {
    fn default() -> Self {
        Self { made: vec![], hits: 0 }
    }
}

impl<T> Looked<T> {
    /// Walks the tunings in `settings`. `best` is the best area so far. `walk` makes the walks from one start. The
    /// tunings in `soon` may be requested next, so they are walked in parallel with the others.
    pub(super) fn look(
        &mut self,
        settings: &[VelocitySettings],
        soon: &[VelocitySettings],
        best: f64,
        area: impl Fn(&(T, Boundary)) -> f64,
        walk: impl Fn(&[VelocitySettings], f64) -> Result<Vec<(T, Boundary)>, Error>,
    ) -> Result<Vec<Look>, Error> {
        let all = [settings, soon].concat();
        for (n, start) in STARTS.into_iter().enumerate() {
            let mean = |one: &VelocitySettings| self.mean(one, &area);
            let bar = CAN_WIN * all.iter().map(mean).fold(best, f64::max);
            let is_due = |one: &&VelocitySettings| {
                self.of(one).len() <= n && (n == 0 || self.mean(one, &area) >= bar)
            };
            let due: Vec<VelocitySettings> = all.iter().filter(is_due).copied().collect();
            let made = if due.is_empty() { vec![] } else { walk(&due, start)? };
            for (one, walked) in due.into_iter().zip(made) {
                self.hits += walked.1.hits;
                match self.made.iter_mut().find(|(other, _)| *other == one) {
                    Some((_, known)) => known.push(walked),
                    None => self.made.push((one, vec![walked])),
                }
            }
        }
        let of = |one: &VelocitySettings| Look {
            area: self.mean(one, &area),
            walks: self.of(one).iter().map(|_| 1).sum(),
        };
        Ok(settings.iter().map(of).collect())
    }

    fn of(&self, settings: &VelocitySettings) -> &[(T, Boundary)] {
        self.made.iter().find(|(other, _)| other == settings).map_or(&[], |(_, made)| made)
    }

    /// Mean of the known areas of a tuning, or 0 if no area is known yet.
    fn mean(&self, settings: &VelocitySettings, area: impl Fn(&(T, Boundary)) -> f64) -> f64 {
        Repeats::of(self.of(settings).iter().map(&area)).mean
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use zwidth::velocity::EstimatorName;

    use super::*;
    use crate::{
        analysis::compare::{
            Entry,
            axis::Axes,
            search::{Budget, Search, Walker},
            settings_of,
        },
        engine::Engine,
        scene::{NamedScene, Scene},
        study::boundary::Boundaries,
    };

    /// A search that walks every tuning alone from both starts. Returns the best tuning and its area.
    fn exhaustive(scene: &Scene, start: &VelocitySettings, budget: Budget) -> Search {
        let stop = AtomicBool::new(false);
        let walker = Walker { engine: Engine::lanes(), scene, stop: &stop, done: &|_| () };
        let axes = Axes::new(start, &scene.design(), scene.device.mass_kg).unwrap();
        let look = |settings: &[VelocitySettings], _: &[_], _| {
            let of = |one: &VelocitySettings| {
                let boundaries = walker.walks(&[*one], &STARTS)?.pop().unwrap();
                assert_eq!(boundaries.len(), 2);
                Ok(Look { area: boundaries.area(), walks: 2 })
            };
            settings.iter().map(of).collect()
        };
        Search::over(&axes, budget.tunings, look).unwrap()
    }

    /// Checks that the search finds the result of the exhaustive search. Returns the numbers of hits of both searches.
    fn hold(scene: &Scene, name: EstimatorName, budget: Budget) -> [u64; 2] {
        let stop = AtomicBool::new(false);
        let walker = Walker { engine: Engine::lanes(), scene, stop: &stop, done: &|_| () };
        let start = settings_of(Entry::Tuned(name), scene);
        let (best, tuned) = walker.best(&start, true, budget).unwrap();
        let all = exhaustive(scene, &start, budget);
        assert_eq!(best, all.best().unwrap().settings, "{}", name.text());
        assert_eq!((tuned.settled, tuned.tried.len()), (all.settled, all.tried.len()));
        let mut hits = tuned.boundaries.hits();
        for (found, other) in tuned.tried.iter().zip(&all.tried) {
            assert_eq!(found.settings, other.settings);
            let boundaries = walker.walks(&[found.settings], &STARTS).unwrap().pop().unwrap();
            hits += boundaries.hits();
            // The area of a losing tuning comes from its first start alone. This area is below the best area by more
            // than the two starts differ.
            match found.walks {
                1 => {
                    assert!(
                        found.area == boundaries[0].area && other.area < all.best().unwrap().area
                    )
                }
                _ => assert_eq!(found.area, other.area),
            }
        }
        let again: Boundaries = walker
            .walks(&[best], &crate::study::sweep::starts(budget.repeats))
            .unwrap()
            .pop()
            .unwrap();
        assert_eq!(tuned.boundaries, again);
        [tuned.hits, hits]
    }

    #[test]
    fn losers_are_walked_once_and_the_rest_is_that_of_the_exhaustive_search() {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        (scene.wall_hit.settle_s, scene.wall_hit.window_s) = (0.5, 0.1);
        let walk = &mut scene.walk;
        (walk.stiffness_start_n_per_m, walk.stiffness_step_n_per_m) = (4000.0, 4000.0);
        (walk.damping_start_n_s_per_m, walk.damping_step_n_s_per_m) = (30.0, 30.0);
        (walk.stiffness_max_n_per_m, walk.damping_max_n_s_per_m) = (4e5, 1200.0);
        let budget = Budget { tunings: 8, repeats: 2 };
        // The cases are: a cutoff in lanes, a whole-number window in lanes, two parameters, and an estimator that does
        // not run in lanes.
        for name in [
            EstimatorName::Butterworth,
            EstimatorName::LeastSquares2,
            EstimatorName::LevantExplicit,
            EstimatorName::TimeStamps,
        ] {
            let [few, many] = hold(&scene, name, Budget { ..budget });
            assert!(few < many, "{}: {few} hits of {many}", name.text());
        }
    }

    #[test]
    #[ignore = "every search of four scenes, twice: minutes; .ci/long explain runs it"]
    fn every_search_finds_what_the_exhaustive_one_finds() {
        for scene in ["paper-1um", "paper-2um", "nucleo-f446re", "discovery-f407"] {
            let named = NamedScene::load(scene).unwrap().scene;
            let mut sums = [0, 0];
            for entry in Entry::usual(&named) {
                let Entry::Tuned(name) = entry else { continue };
                if settings_of(entry, &named).tuning().is_none() {
                    continue;
                }
                let hits = hold(&named, name, Budget { tunings: 8, repeats: 4 });
                println!("{scene} {}: {} hits of {}", name.text(), hits[0], hits[1]);
                sums = [sums[0] + hits[0], sums[1] + hits[1]];
            }
            println!("{scene}: {} hits of {}", sums[0], sums[1]);
            assert!(sums[0] < sums[1]);
        }
    }

    #[test]
    fn what_is_asked_for_soon_is_walked_once() {
        let (asked, settings) = (std::sync::atomic::AtomicUsize::new(0), |hz: f64| {
            VelocitySettings::Butterworth { cutoff_hz: hz }
        });
        let walked = |area: f64| Boundary { points: vec![], area, hits: 10, ended: None };
        let walk = |all: &[VelocitySettings], _| {
            asked.fetch_add(all.len(), Ordering::Relaxed);
            Ok(all.iter().map(|one| ((), walked(one.tuning().map_or(0.0, |(_, hz)| hz)))).collect())
        };
        let mut looked = Looked::default();
        let mut look = |one: &[f64], soon: &[f64], best| {
            let [one, soon] = [one, soon].map(|all| all.iter().map(|hz| settings(*hz)).collect());
            let (one, soon): (Vec<_>, Vec<_>) = (one, soon);
            looked.look(&one, &soon, best, |((), walked)| walked.area, walk).unwrap()
        };
        // The best area is 100. A tuning with the area 90 cannot win, a tuning with the area 97 can.
        let found = look(&[100.0, 90.0], &[97.0], 0.0);
        assert_eq!(found.iter().map(|look| look.walks).collect::<Vec<_>>(), [2, 1]);
        assert_eq!(asked.load(Ordering::Relaxed), 5);
        let found = look(&[97.0], &[], 100.0);
        assert_eq!((found[0].area, found[0].walks), (97.0, 2));
        assert_eq!((asked.load(Ordering::Relaxed), looked.hits), (5, 50));
    }
}
