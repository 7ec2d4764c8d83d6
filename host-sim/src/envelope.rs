//! The walls that the firmware may render without being unlocked.
//!
//! The boundary walk records the largest stable K at each B, as the paper does. Below it not every
//! wall is stable: at large B a soft wall chatters where a stiffer one holds (the walk comes down
//! from above and never sees it). A person who turns K up from zero passes through all of them, so
//! the envelope is stricter: from the first K on, hits at rising K until one is unstable or the
//! smallest boundary of all repeats is reached.
//!
//! Hits are made on every [`STRIDE`]-th line of the walk's grid in both directions, which bounds
//! their number; between two lines the firmware takes the lower one.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use zwidth::experiment::{Cell, Verdict};

use crate::{
    error::Error,
    rig::{HitError, Numeric, Rig, WallHit},
    sweep::{CutoffResult, SweepResult},
    walk::BoundaryPoint,
};

/// Steps of the walk's grid between two lines that are hit.
pub const STRIDE: i32 = 5;

/// The envelope at one cutoff.
#[derive(Clone, Debug, PartialEq)]
pub struct Envelope {
    /// Nominal cutoff, Hz.
    pub cutoff_hz: f64,
    /// The largest K below which every hit was stable, per B ascending; 0 if none was.
    pub points: Vec<BoundaryPoint>,
}

/// The envelopes of all cutoffs of a sweep, on all threads of the current pool.
///
/// # Errors
/// A setting is out of range, or `stop` was set.
pub fn envelopes(
    rig: &Rig,
    numeric: Numeric,
    sweep: &SweepResult,
    stop: &AtomicBool,
) -> Result<Vec<Envelope>, Error> {
    let columns = |result: &CutoffResult| {
        let shortest = result.boundaries.iter().map(|boundary| boundary.points.len()).min();
        let cutoff_hz = result.cutoff_hz;
        let lows = (0..shortest.unwrap_or(0)).step_by(STRIDE.unsigned_abs() as usize).map(|n| {
            // Every walk has one point per B, from the same first B on.
            let points = result.boundaries.iter().filter_map(|boundary| boundary.points.get(n));
            points.map(|point| point.stiffness_n_per_m).fold(f64::INFINITY, f64::min)
        });
        let lows: Vec<f64> = lows.collect();
        (0..)
            .step_by(STRIDE.unsigned_abs() as usize)
            .zip(lows)
            .map(move |(n, low)| (cutoff_hz, n, low))
            .collect::<Vec<_>>()
    };
    let jobs: Vec<(f64, i32, f64)> = sweep.cutoffs.iter().flat_map(columns).collect();
    let points: Vec<Result<(f64, BoundaryPoint), Error>> = jobs
        .into_par_iter()
        .map(|(cutoff_hz, damping, boundary)| {
            Ok((cutoff_hz, column(rig, numeric, cutoff_hz, damping, boundary, stop)?))
        })
        .collect();
    let mut envelopes: Vec<Envelope> = vec![];
    for point in points {
        let (cutoff_hz, point) = point?;
        match envelopes.last_mut() {
            Some(envelope) if envelope.cutoff_hz == cutoff_hz => envelope.points.push(point),
            _ => envelopes.push(Envelope { cutoff_hz, points: vec![point] }),
        }
    }
    Ok(envelopes)
}

/// Hits at rising K at one B, up to `boundary_n_per_m`.
fn column(
    rig: &Rig,
    numeric: Numeric,
    cutoff_hz: f64,
    damping: i32,
    boundary_n_per_m: f64,
    stop: &AtomicBool,
) -> Result<BoundaryPoint, Error> {
    let plan = rig.scene().walk_plan();
    let damping_n_s_per_m = plan.damping_n_s_per_m(Cell { stiffness: 0, damping });
    let mut stable_n_per_m = 0.0;
    for stiffness in (0..).step_by(STRIDE.unsigned_abs() as usize) {
        if stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        // the last hit is at the boundary itself
        let next = plan.stiffness_n_per_m(Cell { stiffness, damping }).min(boundary_n_per_m);
        let hit = WallHit {
            cutoff_hz,
            stiffness_n_per_m: next,
            damping_n_s_per_m,
            start_offset_counts: 0.0,
        };
        match rig.verdict(numeric, &hit) {
            Ok(Verdict::Stable) => {}
            Ok(_) | Err(HitError::OutOfRange(_)) => break,
            Err(error) => return Err(error.into()),
        }
        stable_n_per_m = next;
        if next >= boundary_n_per_m {
            break;
        }
    }
    Ok(BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m: stable_n_per_m })
}
