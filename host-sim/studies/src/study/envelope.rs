//! The walls that the firmware may render without unlocking.
//!
//! The boundary walk records the largest stable K at each B, as the paper does. Some walls below this K are not stable.
//! At large B, a soft wall may chatter although a stiffer wall is stable. The walk follows the largest stable K, so it
//! does not find the soft wall. So the envelope has an interval of K at each B. This interval is the longest one in
//! which every hit is stable, up to the smallest boundary of all repeats.
//!
//! To limit the number of hits, hits are only made on every [`STRIDE`]-th line of the walk's grid, in both directions.
//! Between two B, the firmware allows a K if the intervals of both B contain this K.

use std::fmt::Write as _;

use zwidth::{
    VelocitySettings,
    experiment::{Cell, Verdict},
};

use crate::{
    engine::Depth,
    error::Error,
    scene::NamedScene,
    simulation::prepared::{PreparedScene, WallHit},
    study::{
        How,
        sweep::{CutoffResult, SweepResult},
    },
};

/// Hits are made on lines of the walk's grid. This is the number of grid steps from line to line.
pub const STRIDE: i32 = 5;

/// The stable interval of K at one B. The interval begins at K = 0 if the softest wall of the grid is stable. If no hit
/// was stable, the highest K of the interval is 0.
pub use zwidth::safety::envelope::Point as Interval;

/// The stable intervals at one cutoff, which the firmware may render without unlocking.
#[derive(Clone, Debug, PartialEq)]
pub struct Envelope {
    pub velocity: VelocitySettings,
    /// The intervals, in ascending order of B.
    pub intervals: Vec<Interval>,
}

/// Rows of `envelope.csv` for the firmware. The header is [`HEADER`].
pub fn rows(scene: &NamedScene, envelopes: &[Envelope]) -> String {
    let estimator = scene.scene.velocity.name();
    let (device, actuator) = (&scene.name, scene.scene.actuator);
    let (latency, period) = (actuator.latency, actuator.period);
    let mut text = String::new();
    for Envelope { velocity, intervals } in envelopes {
        // The firmware only knows walls for estimators whose further parameters have their defaults.
        if !velocity.differs_by_tuning_only() {
            continue;
        }
        let cutoff_hz = velocity.cutoff_hz().unwrap_or_default();
        for Interval {
            damping_n_s_per_m: b,
            stiffness_low_n_per_m: low,
            stiffness_high_n_per_m: high,
        } in intervals
        {
            let _ = writeln!(
                text,
                "{device},{estimator},{cutoff_hz},{latency},{period},{b},{low},{high}"
            );
        }
    }
    text
}

/// The columns of `envelope.csv`.
pub const HEADER: &str = "device,estimator,cutoff_hz,latency_samples,period_samples,damping_n_s_per_m,\
     stiffness_low_n_per_m,stiffness_high_n_per_m\n";

/// Computes the envelopes of all cutoffs of a sweep. It uses all threads of the current pool.
///
/// # Errors
/// A setting is out of range, or `stop` was set.
pub fn envelopes(
    how: How<'_>,
    prepared: &PreparedScene,
    sweep: &SweepResult,
) -> Result<Vec<Envelope>, Error> {
    let columns = |result: &CutoffResult| {
        let shortest = result.boundaries.iter().map(|boundary| boundary.points.len()).min();
        let velocity = result.velocity;
        let lows = (0..shortest.unwrap_or(0)).step_by(STRIDE.unsigned_abs() as usize).map(|n| {
            // Every walk has one point per B, and begins at the same B.
            let points = result.boundaries.iter().filter_map(|boundary| boundary.points.get(n));
            points.map(|point| point.stiffness_n_per_m).fold(f64::INFINITY, f64::min)
        });
        let lows: Vec<f64> = lows.collect();
        (0..)
            .step_by(STRIDE.unsigned_abs() as usize)
            .zip(lows)
            .map(move |(n, low)| (velocity, n, low))
            .collect::<Vec<_>>()
    };
    let columns =
        sweep.cutoffs.iter().flat_map(columns).map(|(velocity, damping, boundary)| {
            (velocity, Column::new(prepared, damping, boundary))
        });
    let columns: Vec<(VelocitySettings, Column)> = columns.collect();
    let mut hits = vec![];
    for (velocity, column) in &columns {
        hits.extend(column.stiffnesses_n_per_m.iter().map(|&stiffness_n_per_m| WallHit {
            velocity: *velocity,
            stiffness_n_per_m,
            damping_n_s_per_m: column.damping_n_s_per_m,
            start_offset_counts: 0.0,
        }));
    }
    let mut stable = vec![];
    how.run(prepared, Depth::Verdict, &hits, |outcome| {
        stable.push(outcome?.verdict == Verdict::Stable);
        Ok(())
    })?;
    let mut stable = stable.into_iter();
    let mut envelopes: Vec<Envelope> = vec![];
    for (velocity, column) in columns {
        let interval = column.longest(stable.by_ref());
        match envelopes.last_mut() {
            Some(envelope) if envelope.velocity == velocity => envelope.intervals.push(interval),
            _ => envelopes.push(Envelope { velocity, intervals: vec![interval] }),
        }
    }
    Ok(envelopes)
}

/// Walls at one B, with rising K. The last wall is at the boundary.
struct Column {
    damping_n_s_per_m: f64,
    stiffnesses_n_per_m: Vec<f64>,
}

impl Column {
    fn new(prepared: &PreparedScene, damping: i32, boundary_n_per_m: f64) -> Self {
        let plan = prepared.scene().walk_plan();
        let damping_n_s_per_m = plan.damping_n_s_per_m(Cell { stiffness: 0, damping });
        let mut stiffnesses_n_per_m = vec![];
        for stiffness in (0..).step_by(STRIDE.unsigned_abs() as usize) {
            let next = plan.stiffness_n_per_m(Cell { stiffness, damping }).min(boundary_n_per_m);
            stiffnesses_n_per_m.push(next);
            if next >= boundary_n_per_m {
                break;
            }
        }
        Self { damping_n_s_per_m, stiffnesses_n_per_m }
    }

    /// The longest run of stable hits. `verdicts` has one verdict per hit.
    fn longest(&self, verdicts: impl Iterator<Item = bool>) -> Interval {
        let damping_n_s_per_m = self.damping_n_s_per_m;
        let mut longest =
            Interval { damping_n_s_per_m, stiffness_low_n_per_m: 0.0, stiffness_high_n_per_m: 0.0 };
        // Lowest K of the run of stable hits so far. The first run begins at K = 0, below the first line of the grid.
        let mut run_n_per_m = Some(0.0);
        for (&next, stable) in self.stiffnesses_n_per_m.iter().zip(verdicts) {
            if !stable {
                run_n_per_m = None;
                continue;
            }
            let stiffness_low_n_per_m = *run_n_per_m.get_or_insert(next);
            let longer = next - stiffness_low_n_per_m
                > longest.stiffness_high_n_per_m - longest.stiffness_low_n_per_m;
            if longer || longest.stiffness_high_n_per_m == 0.0 {
                longest =
                    Interval { stiffness_low_n_per_m, stiffness_high_n_per_m: next, ..longest };
            }
        }
        longest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::prepared::Numeric;

    #[test]
    fn a_soft_wall_that_chatters_below_a_stiff_one_that_holds_is_outside() {
        // At 4000 Hz, 2 um and B = 390 N s/m, K = 52,000 N/m is stable, but 2000 to 40,000 N/m are not.
        let scene = NamedScene::load("paper-2um").unwrap();
        let prepared = PreparedScene::new(&scene.scene).unwrap();
        let column = Column::new(&prepared, 38, 52_000.0);
        let hit = |stiffness_n_per_m: &f64| WallHit {
            velocity: scene.scene.velocity.at(4000.0),
            stiffness_n_per_m: *stiffness_n_per_m,
            damping_n_s_per_m: column.damping_n_s_per_m,
            start_offset_counts: 0.0,
        };
        let verdict = |hit| prepared.verdict(Numeric::Fixed, &hit) == Ok(Verdict::Stable);
        let interval = column.longest(column.stiffnesses_n_per_m.iter().map(hit).map(verdict));
        assert_eq!(interval.damping_n_s_per_m, 390.0);
        assert!(interval.stiffness_low_n_per_m > 40_000.0, "{interval:?}");
        assert_eq!(interval.stiffness_high_n_per_m, 52_000.0);
    }
}
