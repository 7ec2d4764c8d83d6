//! The lines of the experiments, one each, on both channels for people.

use core::fmt;

use super::Decimal;
use crate::{
    experiment::{CalibrationEnd, Cell, Ended, RunningVariance, Verdict, WalkSettings, WalkTotals},
    telemetry::Record,
};

/// The line that ends a hit: verdict, window, metres per count.
pub struct HitOver(pub Verdict, pub RunningVariance, pub f64);

impl fmt::Display for HitOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(verdict, window, resolution_m) = self;
        let rms = Decimal(window.rms_counts() * resolution_m);
        let mean = Decimal(window.mean_counts() * resolution_m);
        write!(f, "ok hit {}, rms {rms} m, mean {mean} m", verdict.text())
    }
}

/// K and B of a cell.
struct Wall<'a>(&'a WalkSettings, Cell);

impl fmt::Display for Wall<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(plan, cell) = *self;
        let (k, b) = (plan.stiffness_n_per_m(cell), plan.damping_n_s_per_m(cell));
        write!(f, "k {} N/m, b {} N s/m", Decimal(k), Decimal(b))
    }
}

/// One verdict of a walk: number of the hit, plan, cell, verdict, RMS in m.
pub struct CellJudged<'a>(pub u32, pub &'a WalkSettings, pub Cell, pub Verdict, pub f64);

impl fmt::Display for CellJudged<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(hits, plan, cell, verdict, rms_m) = self;
        let (wall, rms) = (Wall(plan, *cell), Decimal(*rms_m));
        write!(f, "walk hit {hits}: {wall}, {}, rms {rms} m", verdict.text())
    }
}

/// One point of the boundary: number, plan, cell.
pub struct BoundaryPoint<'a>(pub u32, pub &'a WalkSettings, pub Cell);

impl fmt::Display for BoundaryPoint<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(number, plan, cell) = self;
        write!(f, "walk boundary {number}: {}", Wall(plan, *cell))
    }
}

/// The line that ends a walk.
pub struct WalkOver(pub WalkTotals, pub Result<Ended, &'static str>);

impl fmt::Display for WalkOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(totals, ended) = self;
        f.write_str(if ended.is_ok() { "ok walk over" } else { "error: walk" })?;
        if let Err(why) = ended {
            write!(f, ": {why}")?;
        }
        write!(
            f,
            ", area {} N^2 s/m^2, peak k {} N/m, largest b {} N s/m, hits {}, points {}",
            Decimal(totals.area),
            Decimal(totals.stiffness_peak_n_per_m),
            Decimal(totals.damping_max_n_s_per_m),
            totals.hits,
            totals.points,
        )?;
        match ended {
            Ok(ended) => write!(f, ", ended by {}", ended.name()),
            Err(_) => f.write_str(", ended by an error"),
        }
    }
}

/// The force of an output: part of full scale, code, and newtons as far as they are known.
struct Output(Record, f64);

impl fmt::Display for Output {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let part = f64::from(self.0.force.bits()) / f64::from(1u32 << 30);
        let (percent, newtons) = (Decimal(part * 100.0), Decimal(part * self.1));
        let code = self.0.command.code();
        write!(f, "{percent} % of full scale, code {code}, {newtons} N")?;
        write!(f, " with full scale {} N", Decimal(self.1))
    }
}

/// The force of a calibration is complete: the output, full scale as it is set.
pub struct CalibrationHolds(pub Record, pub f64);

impl fmt::Display for CalibrationHolds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "calibrate holds {}", Output(self.0, self.1))
    }
}

/// A calibration is over: why, the last output, full scale as it is set.
pub struct CalibrationOver(pub CalibrationEnd, pub Record, pub f64);

impl fmt::Display for CalibrationOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ok calibrate over: {}, at {}", self.0.text(), Output(self.1, self.2))
    }
}
