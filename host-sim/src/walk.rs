//! The boundary of the stable walls at one cutoff, followed by the core's walk.

use std::sync::atomic::{AtomicBool, Ordering};

use zwidth::experiment::{Ended, Verdict, Walk, WalkError};

use crate::{
    error::Error,
    rig::{HitError, Numeric, Rig, WallHit},
};

/// A wall on the boundary: the largest K that was stable at this B.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundaryPoint {
    /// B, N s/m.
    pub damping_n_s_per_m: f64,
    /// K, N/m.
    pub stiffness_n_per_m: f64,
}

/// A boundary.
#[derive(Clone, Debug, PartialEq)]
pub struct Boundary {
    /// Its points, B ascending.
    pub points: Vec<BoundaryPoint>,
    /// Area under it: the sum of K dB over its points, N^2 s/m^2.
    pub area: f64,
    /// Hits that it took.
    pub hits: u64,
    /// Why it ends where it ends; `None` if its first point is unstable.
    pub ended: Option<Ended>,
}

impl Boundary {
    /// Largest K, N/m; 0 for an empty boundary.
    pub fn stiffness_peak_n_per_m(&self) -> f64 {
        self.points.iter().map(|point| point.stiffness_n_per_m).fold(0.0, f64::max)
    }

    /// Largest B with a stable K, N s/m; 0 for an empty boundary.
    pub fn damping_max_n_s_per_m(&self) -> f64 {
        self.points.iter().map(|point| point.damping_n_s_per_m).fold(0.0, f64::max)
    }
}

/// Follows the boundary at `cutoff_hz`. A first point that is unstable gives an empty boundary; a
/// hit that leaves the core's range counts as unstable.
/// `stop` is looked at between two hits.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn walk(
    rig: &Rig,
    numeric: Numeric,
    cutoff_hz: f64,
    start_offset_counts: f64,
    stop: &AtomicBool,
) -> Result<Boundary, Error> {
    walk_with(rig, cutoff_hz, start_offset_counts, stop, |hit| rig.verdict(numeric, hit))
}

/// [`walk`] by other hits.
pub(crate) fn walk_with(
    rig: &Rig,
    cutoff_hz: f64,
    start_offset_counts: f64,
    stop: &AtomicBool,
    verdict: impl Fn(&WallHit) -> Result<Verdict, HitError>,
) -> Result<Boundary, Error> {
    let plan = rig.scene().walk_plan();
    let mut walk = Walk::new(plan);
    let mut boundary = Boundary { points: vec![], area: 0.0, hits: 0, ended: None };
    loop {
        if stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        let cell = walk.cell();
        let hit = WallHit {
            cutoff_hz,
            stiffness_n_per_m: plan.stiffness_n_per_m(cell),
            damping_n_s_per_m: plan.damping_n_s_per_m(cell),
            start_offset_counts,
        };
        boundary.hits += 1;
        let verdict = match verdict(&hit) {
            // an early verdict may end the hit before the handle leaves; both are unstable
            Err(HitError::OutOfRange(_)) => Verdict::Unstable,
            verdict => verdict?,
        };
        let step = match walk.report(verdict) {
            Ok(step) => step,
            Err(WalkError::FirstUnstable) => return Ok(boundary),
            Err(error @ WalkError::NoContact(_)) => {
                let (k, b) = (hit.stiffness_n_per_m, hit.damping_n_s_per_m);
                return Err(Error::Input(format!(
                    "no_contact at {cutoff_hz} Hz, K = {k} N/m, B = {b} N s/m: {error}; \
                     raise wall_hit.push_n or move wall.position_m closer"
                )));
            }
        };
        if let Some(cell) = step.boundary {
            let stiffness_n_per_m = plan.stiffness_n_per_m(cell);
            let damping_n_s_per_m = plan.damping_n_s_per_m(cell);
            boundary.area += stiffness_n_per_m * plan.damping_step_n_s_per_m;
            boundary.points.push(BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m });
        }
        if step.ended.is_some() {
            boundary.ended = step.ended;
            return Ok(boundary);
        }
    }
}
