//! Walks along the boundary of the stable walls at one cutoff, with the core's walk.

use std::sync::atomic::{AtomicBool, Ordering};

use zwidth::{VelocitySettings, experiment::Verdict};

use super::{
    boundary::{Boundary, Progress},
    walk_lanes::{Queue, Start, walks},
};
use crate::{
    engine::Engine,
    error::Error,
    scene::Protocol,
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};

/// Walks along the boundary with the filter `velocity`. An unstable first point gives an empty boundary. A hit that
/// leaves the core's range is unstable. `stop` is read between two hits.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn walk(
    engine: Engine,
    prepared: &PreparedScene,
    numeric: Numeric,
    velocity: VelocitySettings,
    start_offset_counts: f64,
    stop: &AtomicBool,
) -> Result<Boundary, Error> {
    let starts = [Start { velocity, start_offset_counts }];
    let mut found = Err(Error::Interrupted);
    walks(engine, numeric, &Queue::new(prepared, &starts), stop, |_, boundary| found = boundary);
    found
}

/// Walks as [`walk`] does. But the caller's function `verdict` makes each hit and judges it.
pub fn walk_with(
    prepared: &PreparedScene,
    velocity: VelocitySettings,
    start_offset_counts: f64,
    stop: &AtomicBool,
    verdict: impl Fn(&WallHit) -> Result<Verdict, HitError>,
) -> Result<Boundary, Error> {
    let mut progress = Progress::new(prepared, velocity, start_offset_counts);
    loop {
        if stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        let touches = |hit: &WallHit| prepared.touches(Numeric::Fixed, hit);
        if let Some(ended) = progress.report(verdict(&progress.hit()), touches) {
            return ended;
        }
    }
}

/// The first hit of the walk from the scene's own start.
pub fn first_hit(prepared: &PreparedScene, velocity: VelocitySettings) -> WallHit {
    Progress::new(prepared, velocity, 0.0).hit()
}

/// A longer settle time in s with which an unstable wall counts as stable. The handle then has more time to come to
/// rest. `None` if more time does not help.
pub fn settles_in_s(prepared: &PreparedScene, numeric: Numeric, hit: &WallHit) -> Option<f64> {
    let mut scene = prepared.scene().clone();
    if scene.wall_hit.protocol != Protocol::Paper {
        return None;
    }
    let [settle_s, window_s] = scene.wall_hit.times_s();
    SETTLE_LONGER.into_iter().find_map(|longer| {
        scene.wall_hit.settle_s = longer * (settle_s + window_s);
        let patient = PreparedScene::new(&scene).ok()?;
        let stable = patient.verdict(numeric, hit) == Ok(Verdict::Stable);
        stable.then_some(scene.wall_hit.settle_s)
    })
}

/// Extensions of the settle time that are tried, in multiples of settle time plus window. If no extension helps, the
/// wall is unstable.
const SETTLE_LONGER: [f64; 3] = [1.0, 3.0, 10.0];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    #[test]
    fn a_walk_that_looks_ahead_is_the_walk_hit_by_hit() {
        for (name, cutoff_hz, offset) in [("paper-1um", 200.0, 0.0), ("paper-2um", 1500.0, 0.75)] {
            let prepared = PreparedScene::new(&NamedScene::load(name).unwrap().scene).unwrap();
            let velocity = prepared.scene().velocity.at(cutoff_hz);
            let stop = AtomicBool::new(false);
            let [ahead, core] = [Engine::lanes(), Engine::Core].map(|engine| {
                walk(engine, &prepared, Numeric::Fixed, velocity, offset, &stop).unwrap()
            });
            let verdict = |hit: &WallHit| prepared.verdict(Numeric::Fixed, hit);
            let plain = walk_with(&prepared, velocity, offset, &stop, verdict).unwrap();
            assert_eq!(ahead, plain);
            assert_eq!(core, plain);
            assert!(plain.hits > 40 && plain.points.len() > 10, "{}", plain.hits);
        }
    }
}
