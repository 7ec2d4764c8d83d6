//! The table of a grid, with one row for each wall.

use std::fmt::Write as _;

use serde::Serialize;
use zwidth::experiment::Verdict;

use crate::{
    engine::Outcome,
    error::Error,
    output::in_units::Columns,
    scene::Units,
    simulation::prepared::{HitError, WallHit},
};

const HEADER: &str = "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m,verdict,rms_m\n";
const HEADER_WITH_IMPEDANCE: &str =
    "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m,verdict,rms_m,impedance_error\n";
const OUT_OF_RANGE: &str = "out_of_range";

/// How many walls have each result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    pub stable: u64,
    pub unstable: u64,
    /// Walls that the handle has not reached.
    pub no_contact: u64,
    /// Hits in which the handle has left the core's range.
    pub out_of_range: u64,
}

/// A grid to which walls are added one by one.
pub struct Grid {
    pub counts: Counts,
    columns: Columns,
    is_rotary: bool,
}

impl Grid {
    /// An empty grid in these units. `impedance` adds columns for the error of the impedance.
    pub fn new(units: Units, impedance: bool) -> Self {
        let header = if impedance { HEADER_WITH_IMPEDANCE } else { HEADER };
        let columns = Columns::new(units, header);
        Self { counts: Counts::default(), columns, is_rotary: units.is_rotary() }
    }

    pub fn header(&self) -> &str {
        &self.columns.header
    }

    /// Makes the row of a wall. Also returns whether the wall is stable.
    pub fn row(
        &mut self,
        wall: &WallHit,
        outcome: Result<Outcome, HitError>,
        impedance_error: Option<f64>,
    ) -> Result<String, Error> {
        let (name, rms_m) = match outcome {
            Ok(outcome) => (outcome.verdict.name(), outcome.rms_m),
            Err(HitError::OutOfRange(_)) => (OUT_OF_RANGE, None),
            Err(error) => return Err(error.into()),
        };
        match outcome.map(|outcome| outcome.verdict) {
            Ok(Verdict::Stable) => self.counts.stable += 1,
            Ok(Verdict::Unstable) => self.counts.unstable += 1,
            Ok(Verdict::NoContact) => self.counts.no_contact += 1,
            Err(_) => self.counts.out_of_range += 1,
        }
        let &WallHit { velocity, damping_n_s_per_m, stiffness_n_per_m, .. } = wall;
        let cutoff_hz = velocity.cutoff_hz().unwrap_or_default();
        let mut row = format!("{cutoff_hz},{damping_n_s_per_m},{stiffness_n_per_m},{name},");
        let _ = rms_m.map_or(Ok(()), |rms_m| write!(row, "{rms_m}"));
        let _ = impedance_error.map_or(Ok(()), |error| write!(row, ",{error}"));
        row.push('\n');
        Ok(if self.is_rotary { self.columns.row(&row) } else { row })
    }
}
