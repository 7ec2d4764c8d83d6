//! The sweep over cutoffs. The sweep gives boundaries with repeats, areas with their spread, and the ideal cutoff. The
//! range of the ideal cutoff consists of the cutoffs that the repeats cannot distinguish from the ideal cutoff.
//!
//! Near the boundary a hit is chaotic. If the start differs by a fraction of a count, the area of a walk changes by 0.2
//! to 2 %. So every walk is repeated from starts spread over one count. The result is the mean, with the smallest and
//! the largest value.

use std::sync::atomic::AtomicBool;

use zwidth::{VelocitySettings, experiment::Ended};

pub use crate::numerics::statistics::{AS_GOOD_AS_BEST, LEVEL};
use crate::{
    engine::Engine,
    error::Error,
    scene::{Criterion, VelocityTable},
    simulation::prepared::{Numeric, PreparedScene},
    study::{
        How,
        boundary::{Boundaries, Boundary},
        walk::{first_hit, settles_in_s},
        walk_lanes::{Start, all_walks, each},
    },
};

#[derive(Clone, Debug, PartialEq)]
pub struct CutoffResult {
    pub velocity: VelocitySettings,
    /// Nominal cutoff of the filter, in Hz.
    pub cutoff_hz: f64,
    /// Frequency at which the digital filter has -3 dB, in Hz.
    pub true_cutoff_hz: f64,
    /// Boundaries of the repeated walks. The first is from the scene's own start.
    pub boundaries: Boundaries,
    /// Settle time in s with which the first point would be stable. It is only computed if no walk has a stable first
    /// point. `None` if no settle time helps.
    pub settles_in_s: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct SweepResult {
    /// Results in ascending order of the cutoff.
    pub cutoffs: Vec<CutoffResult>,
    /// The ideal cutoff; `None` if no cutoff has a stable wall.
    pub ideal: Option<Ideal>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ideal {
    /// The ideal cutoff in Hz: the smallest one whose mean area is at least 98 % of the largest mean area.
    pub cutoff_hz: f64,
    /// Lowest and highest cutoff of the range in Hz. For the cutoffs in the range, the repeats do not show that the
    /// area is below 98 % of the largest area.
    pub range_hz: [f64; 2],
    /// The test that has given the range.
    pub basis: RangeBasis,
}

/// The test that gives the range of the ideal cutoff.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RangeBasis {
    /// In the range, Welch's t-test (one-sided at [`LEVEL`]) does not show that the mean area is below 98 % of the
    /// largest mean area. With more repeats the range becomes narrower, until all its cutoffs have at least 98 % of the
    /// largest area.
    Repeats,
    /// There are no repeats. In the range, the area itself is at least 98 % of the largest area.
    WithinTwoPercent,
}

impl RangeBasis {
    pub fn name(self) -> &'static str {
        match self {
            Self::Repeats => "welch_t_5_percent",
            Self::WithinTwoPercent => "within_two_percent",
        }
    }
}

/// Largest ratio of neighbouring cutoffs that are not too far apart.
const COARSE: f64 = 1.3;

/// A scene and the filters with which a sweep walks it.
#[derive(Clone, Debug)]
pub struct Plan<'a> {
    /// Name in error messages.
    pub name: &'a str,
    pub prepared: &'a PreparedScene,
    /// Velocity filters, in ascending order of their cutoff.
    pub filters: &'a [VelocitySettings],
}

/// Makes several sweeps together. It uses all threads of the current pool. Every filter of every plan has `repeats`
/// walks, one or more. Calls `done` after each walk, from any thread. The result does not depend on the number of
/// threads or on `engine`.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn sweep(
    engine: Engine,
    plans: &[Plan<'_>],
    numeric: Numeric,
    repeats: u32,
    stop: &AtomicBool,
    done: impl Fn(&Boundary) + Sync,
) -> Result<Vec<SweepResult>, Error> {
    let how = How { engine, numeric, stop };
    let begins: Vec<(&PreparedScene, Vec<Start>)> =
        plans.iter().map(|plan| (plan.prepared, each(plan.filters, &starts(repeats)))).collect();
    let made = plans.iter().zip(all_walks(how, &begins, done)?);
    made.map(|(plan, made)| {
        let mut made = made.into_iter().map(|made| made.map_err(|error| error.of(plan.name)));
        let criterion = plan.prepared.scene().wall_hit.criterion;
        let of_filter = |&velocity: &VelocitySettings| {
            let boundaries =
                made.by_ref().take(repeats as usize).collect::<Result<Boundaries, _>>()?;
            let unstable = boundaries.iter().all(|boundary| boundary.ended.is_none());
            // A study of quiet walls finds another first point itself, so it needs no settle time.
            let settles_in_s = match unstable && criterion != Criterion::Quiet {
                true => settles_in_s(plan.prepared, numeric, &first_hit(plan.prepared, velocity)),
                false => None,
            };
            let rate_hz = plan.prepared.design().rate_hz;
            Ok(CutoffResult { settles_in_s, ..CutoffResult::of(velocity, rate_hz, boundaries) })
        };
        plan.filters.iter().map(of_filter).collect::<Result<_, Error>>().map(SweepResult::of)
    })
    .collect()
}

/// Start of a repeat, in counts from the scene's start. It is `repeat / repeats`, so all starts lie within one count.
pub fn start_offset_counts(repeat: u32, repeats: u32) -> f64 {
    f64::from(repeat) / f64::from(repeats)
}

/// Starts of all repeats, in counts from the scene's start.
pub fn starts(repeats: u32) -> Vec<f64> {
    (0..repeats).map(|repeat| start_offset_counts(repeat, repeats)).collect()
}

/// The cutoffs in ascending order, without repetition.
pub fn ascending(cutoffs_hz: &[f64]) -> Vec<f64> {
    let mut sorted = cutoffs_hz.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    sorted
}

/// The scene's filters at these cutoffs. They are in ascending order and without repetition. If the filter has no
/// cutoff, the list has only this filter.
pub fn filters(velocity: &VelocityTable, cutoffs_hz: &[f64]) -> Vec<VelocitySettings> {
    match velocity.has_cutoff() {
        true => ascending(cutoffs_hz).into_iter().map(|hz| velocity.at(hz)).collect(),
        false => velocity.settings().into_iter().collect(),
    }
}

impl CutoffResult {
    /// The result of walks at one cutoff. The settle time is left out.
    pub(super) fn of(velocity: VelocitySettings, rate_hz: f64, boundaries: Boundaries) -> Self {
        let cutoff_hz = velocity.cutoff_hz().unwrap_or_default();
        let true_cutoff_hz = velocity.true_cutoff_hz(rate_hz).unwrap_or_default();
        Self { velocity, cutoff_hz, true_cutoff_hz, boundaries, settles_in_s: None }
    }
}

fn ideal(cutoffs: &[CutoffResult]) -> Option<Ideal> {
    let best = cutoffs.iter().max_by(|a, b| a.boundaries.area().total_cmp(&b.boundaries.area()))?;
    let enough = AS_GOOD_AS_BEST * best.boundaries.area();
    let ideal = cutoffs
        .iter()
        .find(|result| result.boundaries.area() >= enough)
        .filter(|_| enough > 0.0)?;
    let basis =
        if ideal.boundaries.len() > 1 { RangeBasis::Repeats } else { RangeBasis::WithinTwoPercent };
    let best = best.boundaries.repeats();
    let is_worse =
        |result: &CutoffResult| result.boundaries.repeats().is_below(AS_GOOD_AS_BEST, &best);
    let alike = cutoffs.iter().filter(|result| !is_worse(result));
    let range_hz = alike.fold([ideal.cutoff_hz; 2], |[low, high], result| {
        [low.min(result.cutoff_hz), high.max(result.cutoff_hz)]
    });
    Some(Ideal { cutoff_hz: ideal.cutoff_hz, range_hz, basis })
}

impl SweepResult {
    /// The result of a sweep over these cutoffs. They must be in ascending order.
    pub fn of(cutoffs: Vec<CutoffResult>) -> Self {
        let ideal = ideal(&cutoffs);
        Self { cutoffs, ideal }
    }

    /// Whether the ideal range reaches the first or the last cutoff. If so, the range may continue beyond this cutoff.
    pub fn ends_at_edge(&self) -> bool {
        let (Some(ideal), Some(first), Some(last)) =
            (self.ideal, self.cutoffs.first(), self.cutoffs.last())
        else {
            return false;
        };
        ideal.range_hz[0] == first.cutoff_hz || ideal.range_hz[1] == last.cutoff_hz
    }

    /// A note for the reader if a cap cuts off a part of areas in the ideal range.
    fn cut_range(&self) -> Option<String> {
        let [low, high] = self.ideal?.range_hz;
        let within = |result: &&CutoffResult| (low..=high).contains(&result.cutoff_hz);
        let is_cut = |boundary: &Boundary| {
            let cuts = [Ended::DampingMax, Ended::StiffnessMax, Ended::BothMax];
            boundary.ended.is_some_and(|ended| cuts.contains(&ended))
        };
        let is_cut = |result: &&CutoffResult| result.boundaries.iter().any(is_cut);
        let inside = self.cutoffs.iter().filter(within).count();
        let cut = self.cutoffs.iter().filter(within).filter(is_cut).count();
        (cut > 0).then(|| {
            format!(
                "a cap of [walk] cuts {cut} of the {inside} areas of the ideal range; raise the caps to see \
                 which cutoff is best"
            )
        })
    }

    /// A note for the reader if the next cutoffs outside the ideal range are far from it.
    fn coarse_range(&self) -> Option<String> {
        let [low, high] = self.ideal?.range_hz;
        let cutoffs = self.cutoffs.iter().map(|result| result.cutoff_hz);
        let below = cutoffs.clone().rfind(|&hz| hz < low).filter(|hz| low / hz > COARSE);
        let above = cutoffs.clone().find(|&hz| hz > high).filter(|hz| hz / high > COARSE);
        let ends = match (below, above) {
            (None, None) => return None,
            (Some(below), None) => format!("begin anywhere above {below} Hz"),
            (None, Some(above)) => format!("end anywhere below {above} Hz"),
            (Some(below), Some(above)) => {
                format!("begin anywhere above {below} Hz and end anywhere below {above} Hz")
            }
        };
        Some(format!("the cutoffs that were tried are far apart: the ideal range may {ends}"))
    }

    /// Notes that explain the result to a reader. Each note is one sentence.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec![];
        for result in &self.cutoffs {
            let cutoff_hz = result.cutoff_hz;
            let walks = result.boundaries.len();
            let count = |ended| result.boundaries.iter().filter(|b| b.ended == ended).count();
            for (ended, what) in [
                (None, "the first point is unstable"),
                (Some(Ended::DampingMax), "B reached walk.damping_max_n_s_per_m"),
                (Some(Ended::StiffnessMax), "K reached walk.stiffness_max_n_per_m"),
                (Some(Ended::BothMax), "K and B reached their caps in [walk]"),
            ] {
                let found = count(ended);
                let effect =
                    if ended.is_none() { "its area counts as 0" } else { "the area is cut there" };
                if found > 0 {
                    notes.push(format!(
                        "{cutoff_hz} Hz: {what} in {found} of {walks} walks; {effect}"
                    ));
                }
            }
            if let Some(settle_s) = result.settles_in_s {
                notes.push(format!(
                    "{cutoff_hz} Hz: the first point still settles in the window; raise wall_hit.settle_s, \
                     {settle_s} s is enough there"
                ));
            }
        }
        notes.extend(self.cut_range());
        notes.extend(self.coarse_range());
        if self.cutoffs.len() == 1 {
            notes.push("only one cutoff was tried; there is nothing to compare it with".into());
        } else if self.ends_at_edge() {
            notes.push(
                "the ideal range touches an end of the cutoffs that were tried; it may go on beyond"
                    .into(),
            );
        }
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{engine::Backend, scene::NamedScene};

    fn cutoff(cutoff_hz: f64, areas: &[f64]) -> CutoffResult {
        let boundary = |&area: &f64| Boundary { points: vec![], area, hits: 1, ended: None };
        let boundaries = areas.iter().map(boundary).collect();
        CutoffResult::of(VelocitySettings::ButterworthPrewarped { cutoff_hz }, 1e4, boundaries)
    }

    /// Areas with this mean. They are spread evenly over +-1 %.
    fn spread(mean: f64, repeats: u32) -> Vec<f64> {
        let place = |n: u32| f64::from(2 * n + 1) / f64::from(repeats) - 1.0;
        (0..repeats).map(|n| mean * (1.0 + 0.01 * place(n))).collect()
    }

    #[test]
    fn the_ideal_cutoff_is_the_smallest_within_two_percent_of_the_best() {
        let results = [
            cutoff(500.0, &[90.0]),
            cutoff(1000.0, &[98.0]),
            cutoff(2000.0, &[100.0]),
            cutoff(3000.0, &[99.0]),
            cutoff(4000.0, &[97.0]),
        ];
        let ideal = ideal(&results).unwrap();
        assert_eq!((ideal.cutoff_hz, ideal.range_hz), (1000.0, [1000.0, 3000.0]));
        assert_eq!(ideal.basis, RangeBasis::WithinTwoPercent);
        assert_eq!(super::ideal(&[cutoff(1000.0, &[0.0, 0.0])]), None);
    }

    #[test]
    fn a_range_that_rests_on_cut_areas_or_far_cutoffs_says_so() {
        let of = |cutoffs: &[(f64, f64, Option<Ended>)]| {
            let results = cutoffs.iter().map(|&(hz, area, ended)| {
                let mut result = cutoff(hz, &[area]);
                result.boundaries =
                    [Boundary { ended, ..result.boundaries[0].clone() }].into_iter().collect();
                result
            });
            let cutoffs: Vec<CutoffResult> = results.collect();
            let ideal = ideal(&cutoffs);
            SweepResult { cutoffs, ideal }.notes().join("; ")
        };
        let closed = Some(Ended::Closed);
        let plain = [(900.0, 50.0, closed), (1000.0, 100.0, closed), (1300.0, 60.0, closed)];
        assert_eq!(of(&plain), "");
        let notes = of(&[plain[0], (1000.0, 100.0, Some(Ended::DampingMax)), plain[2]]);
        assert!(notes.contains("cuts 1 of the 1 areas of the ideal range"), "{notes}");
        // A cut area outside the range has no effect on the range.
        let notes = of(&[(900.0, 50.0, Some(Ended::DampingMax)), plain[1], plain[2]]);
        assert!(!notes.contains("of the ideal range"), "{notes}");
        let notes = of(&[(500.0, 50.0, closed), plain[1], (2000.0, 60.0, closed)]);
        assert!(notes.contains("above 500 Hz and end anywhere below 2000 Hz"), "{notes}");
    }

    #[test]
    fn four_repeats_start_at_quarters_of_a_count() {
        let starts = [0, 1, 2, 3].map(|repeat| start_offset_counts(repeat, 4));
        assert_eq!(starts, [0.0, 0.25, 0.5, 0.75]);
    }

    #[test]
    fn repeats_make_the_range_narrower_and_never_drop_what_is_as_good() {
        let width = |repeats: u32| {
            let means =
                [(800.0, 90.0), (1000.0, 97.2), (1200.0, 98.5), (1500.0, 100.0), (2000.0, 97.8)];
            let results = means.map(|(hz, mean)| cutoff(hz, &spread(mean, repeats)));
            let ideal = ideal(&results).unwrap();
            assert_eq!(ideal.cutoff_hz, 1200.0);
            assert!(ideal.range_hz[0] <= 1200.0 && ideal.range_hz[1] >= 1500.0);
            assert!(ideal.range_hz[0] > 800.0, "10 % less is seen with two walks already");
            ideal.range_hz[1] - ideal.range_hz[0]
        };
        let widths = [2, 3, 4, 8, 16, 64, 256].map(width);
        assert!(widths.is_sorted_by(|a, b| a >= b), "{widths:?}");
        assert_eq!((widths[0], widths[6]), (1000.0, 300.0));
    }

    /// A sweep's files come from this result, so the result must not depend on engine, backend or threads.
    #[test]
    fn a_sweep_is_the_same_on_every_backend_and_any_number_of_threads() {
        let available = Backend::ALL.into_iter().filter(|backend| backend.is_available());
        let engines: Vec<Engine> =
            std::iter::once(Engine::Core).chain(available.map(Engine::Lanes)).collect();
        let mut scenes =
            ["paper-1um", "paper-2um"].map(|name| NamedScene::load(name).unwrap().scene);
        for scene in &mut scenes {
            scene.wall_hit.settle_s = 1.0;
            scene.wall_hit.window_s = 0.5;
            scene.walk.stiffness_step_n_per_m = 8000.0;
            scene.walk.damping_step_n_s_per_m = 80.0;
        }
        let filters = filters(&scenes[0].velocity, &[200.0, 1500.0, 4000.0]);
        let prepared = scenes.map(|scene| PreparedScene::new(&scene).unwrap());
        let plans: Vec<Plan<'_>> = prepared
            .iter()
            .map(|prepared| Plan { name: "s", prepared, filters: &filters })
            .collect();
        let stop = std::sync::atomic::AtomicBool::new(false);
        for numeric in [Numeric::Fixed, Numeric::F64] {
            let mut all = vec![];
            for &engine in &engines {
                for threads in [1, 2, 5] {
                    let pool =
                        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    let swept = pool.install(|| sweep(engine, &plans, numeric, 3, &stop, |_| {}));
                    all.push(format!("{:?}", swept.unwrap()));
                }
            }
            let points = all[0].matches("BoundaryPoint").count();
            assert!(points > 20, "{points}");
            assert!(all.iter().all(|swept| *swept == all[0]));
        }
    }
}
