//! Finds what limits the walls most: the latency of the loop, its output rate, the mechanics between loop and handle,
//! or the velocity.
//!
//! The same device is walked in several loops: the scene's own loop, and loops with the latency and output stage of
//! each board. In a board's loop there are at most ten samples per output. Each loop also has a version with an
//! amplifier of [`AMPLIFIER_HZ`], and a version with amplifier and a handle on a transmission. The last version shows
//! the limits of a device with a belt. Each loop gives the areas by limit, push and cutoff, and the area with the true
//! velocity.
//!
//! **Steps.** Areas differ by five powers of ten. So one grid would be too coarse for some areas, and too slow for
//! others. The steps are divided by [`FINER`] until the boundary is at least [`RESOLVED`] steps of K high and of B
//! wide.

use rayon::prelude::*;

use super::{
    How,
    boundary::Boundaries,
    limits::{Limit, LimitResult, Question, Situation, limits},
    limits_asked::on_grid,
    loops::boards,
    sweep::{CutoffResult, SweepResult, ascending},
};
use crate::{
    error::Error,
    scene::{
        NamedScene, PushBy, RmsOf, Scene, Units, Walk,
        element::{Amplifier, Mode},
    },
};

/// Output periods that are used for the boards' loops, in samples.
pub const PERIODS: [u32; 4] = [10, 5, 2, 1];
/// Bandwidth of the amplifier that is added, in Hz.
pub const AMPLIFIER_HZ: f64 = 1000.0;
/// Three values of the added transmission: the handle's share of the device's mass, the frequency at which both masses
/// swing on the spring in Hz, and the damping ratio.
pub const MODE: [f64; 3] = [0.24, 150.0, 0.03];
/// A step size divided by the next smaller one.
pub const FINER: f64 = 2.0;
/// Smallest height of a resolved boundary in steps of K, and its smallest width in steps of B.
pub const RESOLVED: [f64; 2] = [32.0, 24.0];
/// Number of steps from 0 to the cap on the coarsest grid, first for K, then for B. The height of a boundary is some
/// 200 to 500 times its width.
const COARSEST: [f64; 2] = [200.0, 20.0];
/// Number of step sizes that are tried. With the smallest, a walk may have a million steps.
const SIZES: i32 = 13;

/// The device in one loop.
#[derive(Clone, Debug)]
pub struct Lever {
    /// Name of the loop. It is the name of the scene or of a board.
    pub of_loop: String,
    /// Added elements between the output and the handle.
    pub between: Between,
    pub scene: Scene,
}

/// What is added between a loop's output and the handle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Between {
    Nothing,
    Amplifier,
    /// An amplifier is added, and the handle is on a transmission.
    Transmission,
}

impl Between {
    pub const ALL: [Self; 3] = [Self::Nothing, Self::Amplifier, Self::Transmission];

    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "as-is",
            Self::Amplifier => "amplifier",
            Self::Transmission => "amplifier-and-mode",
        }
    }

    pub fn text(self) -> &'static str {
        match self {
            Self::Nothing => "as it is",
            Self::Amplifier => "an amplifier of 1 kHz",
            Self::Transmission => "that and a handle on a transmission of 150 Hz",
        }
    }
}

#[derive(Clone, Debug)]
pub struct LeverQuestion {
    pub levers: Vec<Lever>,
    /// Limits of a stable wall. A limit is for the RMS of the motion or for the sensation level.
    pub limits: Vec<Limit>,
    pub pushes: Vec<PushBy>,
    pub cutoffs_hz: Vec<f64>,
    pub repeats: u32,
}

impl LeverQuestion {
    /// The units of the scene, which is the first loop. The other loops have the same units.
    pub fn units(&self) -> Units {
        self.levers[0].scene.units
    }

    /// Number of combinations of loop, limit and push.
    pub fn tasks(&self) -> usize {
        self.levers.len() * self.limits.len() * self.pushes.len()
    }

    /// Number of walks that each step size needs, including those with the true velocity.
    pub fn walks(&self) -> usize {
        self.tasks() * (self.cutoffs_hz.len() + 1) * self.repeats as usize
    }
}

/// Boundaries of several walks, and the grid of these walks.
#[derive(Clone, Debug)]
pub struct Walked {
    pub boundaries: Boundaries,
    pub walk: Walk,
}

/// Results of one loop with one limit and push.
#[derive(Clone, Debug)]
pub struct LeverResult {
    /// Index of the loop in `levers` of the question.
    pub lever: usize,
    pub limit: Limit,
    pub push: PushBy,
    /// Cutoffs in Hz in ascending order, each with its walks.
    pub cutoffs: Vec<(f64, Walked)>,
    /// Walks with the true velocity. There are none if an amplifier or a transmission is added.
    pub told: Walked,
    /// Areas of all cutoffs, and the ideal cutoff with its range.
    pub sweep: SweepResult,
}

impl LeverResult {
    /// Walks at the ideal cutoff; `None` if no cutoff has a stable wall.
    pub fn best(&self) -> Option<&Walked> {
        let ideal = self.sweep.ideal?.cutoff_hz;
        self.cutoffs.iter().find(|(cutoff_hz, _)| *cutoff_hz == ideal).map(|(_, walked)| walked)
    }

    /// Mean area at the ideal cutoff, in N^2 s/m^2.
    pub fn area(&self) -> f64 {
        self.best().map_or(0.0, |walked| walked.boundaries.area())
    }
}

/// The loops of a scene. The scene's own loop is the first. A board's loop that is equal to the scene's own loop is
/// left out.
///
/// # Errors
/// The scene is not allowed with a board's output.
pub fn levers(scene: &NamedScene) -> Result<Vec<Lever>, Error> {
    let mut loops = vec![(scene.name.clone(), scene.scene.clone())];
    for (place, (name, of_board)) in boards(&scene.scene)?.into_iter().enumerate() {
        // The second board's loop is almost the same as the first board's loop. So only the longest and the shortest
        // period of the second board are used.
        for period in PERIODS.into_iter().filter(|period| place == 0 || [1, 10].contains(period)) {
            let mut own = of_board.clone();
            own.actuator.period = period;
            if loops.iter().all(|(_, other)| *other != own) {
                loops.push((name.clone(), own));
            }
        }
    }
    let mut levers = vec![];
    for (of_loop, scene) in loops {
        for between in Between::ALL {
            let mut changed = scene.clone();
            if between != Between::Nothing && changed.amplifier.is_none() {
                changed.amplifier = Some(Amplifier { bandwidth_hz: AMPLIFIER_HZ });
            }
            if between == Between::Transmission && changed.mode.is_none() {
                changed.mode = Some(transmission(changed.device.mass_kg));
            }
            let is_there = levers.iter().any(|lever: &Lever| lever.scene == changed);
            // If the scene does not allow the added elements beside its own elements, this version is left out.
            if !is_there && changed.check().is_ok() {
                levers.push(Lever { of_loop: of_loop.clone(), between, scene: changed });
            }
        }
    }
    Ok(levers)
}

/// The mode of a device with this mass if its handle is on a transmission.
fn transmission(mass_kg: f64) -> Mode {
    let [share, frequency_hz, ratio] = MODE;
    let handle_kg = share * mass_kg;
    let reduced_kg = handle_kg * mass_kg / (handle_kg + mass_kg);
    let per_s = 2.0 * std::f64::consts::PI * frequency_hz;
    Mode {
        mass_kg: handle_kg,
        stiffness_n_per_m: reduced_kg * per_s * per_s,
        damping_n_s_per_m: 2.0 * ratio * reduced_kg * per_s,
    }
}

/// Whether the loop accepts this cutoff. A loop with a low sample rate accepts no cutoff near this rate. Other errors
/// of the settings are reported by the walk.
pub(super) fn takes(scene: &Scene, cutoff_hz: f64) -> bool {
    let settings = scene.velocity.at(cutoff_hz);
    match settings.build(&scene.design()) {
        Ok(_) => true,
        Err(error) => settings.name().keys().first() != Some(&error.parameter),
    }
}

/// The grid with this step size. The step sizes are numbered from the coarsest, 0.
fn grid(own: &Walk, size: i32) -> Walk {
    let finer = FINER.powi(size);
    let [high, wide] = COARSEST;
    let k = own.stiffness_max_n_per_m / high / finer;
    let b = own.damping_max_n_s_per_m / wide / finer;
    on_grid(own, [k, b], [k, b])
}

impl Walked {
    /// Number of further step sizes that are needed to resolve the boundary; `None` if it is resolved.
    fn finer(&self) -> Option<i32> {
        let high = self.boundaries.stiffness_peak_n_per_m() / self.walk.stiffness_step_n_per_m;
        let wide = self.boundaries.damping_max_n_s_per_m() / self.walk.damping_step_n_s_per_m;
        let [high_enough, wide_enough] = RESOLVED;
        let lacks = f64::max(high_enough / high, wide_enough / wide);
        if lacks <= 1.0 {
            return None;
        }
        // A boundary with few steps gives little information about its size.
        let sure = high >= 4.0 && wide >= 4.0;
        #[expect(clippy::cast_possible_truncation, reason = "at most RESOLVED over 4")]
        let more = if sure { (lacks.log2() / FINER.log2()).ceil() as i32 } else { 1 };
        Some(more.max(1))
    }
}

/// Walks every loop. The result does not depend on the number of threads or on `engine`. Calls `done` for each loop,
/// limit and push.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn walk_levers(
    how: How<'_>,
    question: &LeverQuestion,
    done: impl Fn() + Sync,
) -> Result<Vec<LeverResult>, Error> {
    let cutoffs_hz = ascending(&question.cutoffs_hz);
    let asked = question.limits.iter().flat_map(|&limit| {
        let of_limit = question.pushes.iter().map(move |&push| (limit, push));
        of_limit.flat_map(|(limit, push)| {
            (0..question.levers.len()).map(move |lever| (lever, limit, push))
        })
    });
    let asked: Vec<_> = asked.collect();
    let of = |&(lever, limit, push): &(usize, Limit, PushBy)| {
        let scene = &question.levers[lever].scene;
        let none = Walked { boundaries: Boundaries::default(), walk: grid(&scene.walk, 0) };
        let cutoffs_hz: Vec<f64> =
            cutoffs_hz.iter().copied().filter(|hz| takes(scene, *hz)).collect();
        if cutoffs_hz.is_empty() {
            return Err(Error::Input(format!(
                "an encoder rate of {} Hz takes none of the cutoffs",
                scene.control.rate_hz
            )));
        }
        let cutoffs = cutoffs_hz.iter().map(|&hz| (hz, none.clone())).collect();
        let sweep = SweepResult::of(vec![]);
        let mut found = LeverResult { lever, limit, push, cutoffs, told: none, sweep };
        let own = question.levers[lever].between == Between::Nothing;
        // Next step size of each cutoff. The last element belongs to the true velocity.
        let mut next = vec![Some(0); cutoffs_hz.len()];
        next.push(own.then_some(0));
        while let Some(size) = next.iter().flatten().min().copied() {
            let due = |place: usize| next[place] == Some(size);
            let cutoffs = cutoffs_hz.iter().enumerate().filter(|(place, _)| due(*place));
            let asked = Question {
                limits: vec![limit],
                rms_of: RmsOf::Motion,
                filters: cutoffs.map(|(_, hz)| scene.velocity.at(*hz)).collect(),
                repeats: question.repeats,
                walk: grid(&scene.walk, size),
                situations: vec![Situation { push, arm: None }],
                told: due(cutoffs_hz.len()),
            };
            for result in limits(how, scene, &asked, || ())? {
                found.take(&asked, result);
            }
            let walked = found.cutoffs.iter().map(|(_, walked)| walked).chain([&found.told]);
            for (place, walked) in next.iter_mut().zip(walked) {
                if *place == Some(size) {
                    *place = walked.finer().map(|more| size + more).filter(|size| *size < SIZES);
                }
            }
        }
        found.sweep = sweep_of(&found.cutoffs, scene);
        done();
        Ok(found)
    };
    asked.par_iter().with_max_len(1).map(of).collect()
}

fn sweep_of(cutoffs: &[(f64, Walked)], scene: &Scene) -> SweepResult {
    let cutoffs = cutoffs.iter().map(|(cutoff_hz, walked)| {
        let boundaries = walked.boundaries.clone();
        CutoffResult::of(scene.velocity.at(*cutoff_hz), scene.control.rate_hz, boundaries)
    });
    SweepResult::of(cutoffs.collect())
}

impl LeverResult {
    /// Replaces results by those of walks with smaller steps.
    fn take(&mut self, asked: &Question, LimitResult { result, told, .. }: LimitResult) {
        let walk = asked.walk;
        for CutoffResult { cutoff_hz, boundaries, .. } in result.cutoffs {
            if let Some((_, place)) = self.cutoffs.iter_mut().find(|(hz, _)| *hz == cutoff_hz) {
                *place = Walked { boundaries, walk };
            }
        }
        if asked.told {
            self.told = Walked { boundaries: told, walk };
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::{engine::Engine, simulation::prepared::Numeric};

    fn scene(name: &str) -> NamedScene {
        NamedScene::load(name).unwrap()
    }

    #[test]
    fn each_loop_stands_once_with_what_is_between() {
        let of = |name: &str| levers(&scene(name)).unwrap();
        assert_eq!(of("paper-1um").len(), (1 + 4 + 2) * 3);
        assert_eq!(of("nucleo-f446re").len(), (4 + 2) * 3);
        for lever in of("paper-1um") {
            lever.scene.check().unwrap();
            let has = (lever.scene.amplifier.is_some(), lever.scene.mode.is_some());
            assert_eq!(
                has,
                (lever.between != Between::Nothing, lever.between == Between::Transmission)
            );
        }
        let mut own = scene("paper-1um");
        own.scene.amplifier = Some(Amplifier { bandwidth_hz: 400.0 });
        let kept = levers(&own).unwrap();
        assert!(kept.iter().all(|lever| lever.scene.amplifier == own.scene.amplifier));
        assert!(kept.iter().all(|lever| lever.between != Between::Amplifier));
    }

    /// Two masses on a spring swing at the root of the stiffness divided by their reduced mass.
    #[test]
    fn the_transmission_swings_at_its_frequency() {
        let mode = transmission(0.416);
        let [k, m, h] = [mode.stiffness_n_per_m, 0.416, mode.mass_kg];
        let per_s = (k / m + k / h).sqrt();
        assert!((per_s / (2.0 * std::f64::consts::PI) - 150.0).abs() < 1e-9);
        let decay_per_s = mode.damping_n_s_per_m * (1.0 / m + 1.0 / h) / 2.0;
        assert!((decay_per_s / per_s - 0.03).abs() < 1e-12);
        assert!((h - 0.1).abs() < 2e-4);
    }

    #[test]
    fn boundaries_of_any_size_are_resolved_and_no_finer_than_they_need() {
        let mut scene = scene("paper-1um");
        (scene.scene.wall_hit.settle_s, scene.scene.wall_hit.window_s) = (1.5, 0.2);
        let all = levers(&scene).unwrap();
        let of = |n: usize| all[n].clone();
        let question = LeverQuestion {
            levers: vec![of(0), of(3)],
            limits: vec![Limit::Rms(1.5e-5), Limit::Rms(1e-6)],
            pushes: vec![PushBy::Motor],
            cutoffs_hz: vec![1000.0, 300.0],
            repeats: 1,
        };
        let stop = AtomicBool::new(false);
        let walk = |engine| {
            let how = How { engine, numeric: Numeric::Fixed, stop: &stop };
            walk_levers(how, &question, || ()).unwrap()
        };
        let found = walk(Engine::lanes());
        assert_eq!(found.len(), 4);
        for result in &found {
            let told = [&result.told];
            for walked in result.cutoffs.iter().map(|(_, walked)| walked).chain(told) {
                let high =
                    walked.boundaries.stiffness_peak_n_per_m() / walked.walk.stiffness_step_n_per_m;
                let wide =
                    walked.boundaries.damping_max_n_s_per_m() / walked.walk.damping_step_n_s_per_m;
                assert!(high >= RESOLVED[0] && wide >= RESOLVED[1], "{high} x {wide}");
                let coarser = f64::min(high / RESOLVED[0], wide / RESOLVED[1]);
                assert!(coarser < 2.5 * FINER, "{high} x {wide}");
            }
        }
        let hz: Vec<f64> = found[0].cutoffs.iter().map(|(hz, _)| *hz).collect();
        assert_eq!(hz, [300.0, 1000.0]);
        // A shorter latency gives more area. A smaller limit gives less area.
        let area = |n: usize| found[n].area();
        assert!(area(1) > 10.0 * area(0) && area(2) < area(0) && area(3) < area(1));
        // Both engines give the same bits.
        let core = walk(Engine::Core);
        for (one, other) in found.iter().zip(&core) {
            assert_eq!(one.area(), other.area());
        }
    }
}
