//! The lines about experiments that people read. Each kind of line is a type.

use core::fmt;

use super::{
    Decimal,
    reply_channel::NOBODY,
    spoken::{Said, Spoken},
};
use crate::{
    experiment::{
        CalibrationEnd, Cell, Ended, RunningVariance, Verdict, WalkSettings, WalkTotals,
        quiet::QuietWindow,
    },
    port::Exchanged,
    telemetry::Record,
    units::Force,
};

/// Names of the commands that begin an experiment.
pub(super) const EXPERIMENTS: [&str; 4] = ["hit", "pulses", "walk", "calibrate"];

/// Whether a line of the board answers a command. The board sends all other lines without being asked. For example, `ok
/// walk` answers `walk`, but `ok walk over, ..` and `error: walk: ..` report how the walk ended.
pub fn is_answer(line: &str) -> bool {
    let reports = |said: &str, then: &str| {
        let mut rests = EXPERIMENTS.iter().filter_map(|name| said.strip_prefix(name));
        rests.any(|rest| rest.starts_with(then))
    };
    if let Some(done) = line.strip_prefix("ok ") {
        return !reports(done, " ");
    }
    let refused = line.strip_prefix("error: ");
    refused.is_some_and(|why| !reports(why, ": ") && !why.starts_with(NOBODY))
}

/// One hit and its verdict.
#[derive(Clone, Copy)]
pub struct JudgedHit {
    pub verdict: Verdict,
    /// Mean and variance of the position over the hit's window, in counts.
    pub counts: RunningVariance,
    /// Energy that wall and hand have exchanged.
    pub port: Exchanged,
    /// Force and wall over the window. Only the criterion `quiet` needs them.
    pub quiet: Option<QuietWindow>,
}

impl JudgedHit {
    pub fn force_rms_n(&self) -> f64 {
        self.quiet.map_or(0.0, |quiet| quiet.force_rms_n)
    }
}

/// A hit as a reply prints it. It has the verdict and the values that led to it.
pub struct SaidHit {
    pub hit: JudgedHit,
    pub resolution_m: f64,
    pub spoken: Spoken,
}

impl SaidHit {
    fn verdict(&self) -> &'static str {
        self.hit.verdict.text()
    }

    fn rms(&self) -> Said {
        self.spoken.number(self.hit.counts.rms_counts() * self.resolution_m, "m")
    }

    /// Writes the values that only the criterion `quiet` judges: force and wall.
    fn quiet(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(quiet) = &self.hit.quiet else { return Ok(()) };
        write!(f, ", force rms {}", self.spoken.number(quiet.force_rms_n, "N"))?;
        match quiet.penetration_ratio {
            Some(ratio) => write!(f, ", ratio {}", Decimal(ratio)),
            None => f.write_str(", ratio none"),
        }
    }
}

/// The line that reports the end of a hit. It has the hit's values, and the energy that wall and hand have exchanged.
/// The second field is the force at full scale, in N.
pub struct HitOver(pub SaidHit, pub f64);

impl fmt::Display for HitOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(said, full_scale_n) = self;
        let SaidHit { hit, resolution_m, spoken } = said;
        let mean = spoken.number(hit.counts.mean_counts() * resolution_m, "m");
        write!(f, "ok hit {}, rms {}, mean {mean}", said.verdict(), said.rms())?;
        let unit_j = full_scale_n / f64::from(1u32 << Force::FRACTION_BITS) * resolution_m;
        #[expect(clippy::cast_precision_loss, reason = "for people")]
        let [taken, given] =
            [hit.port.energy, hit.port.given].map(|energy| Decimal(energy as f64 * unit_j));
        write!(f, ", taken {taken} J, given {given} J")?;
        said.quiet(f)
    }
}

/// The line about one push of a hit with the criterion `quiet`. The fields are the number of the push, its force in N,
/// and the hit.
pub struct PushJudged(pub usize, pub f64, pub SaidHit);

impl fmt::Display for PushJudged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(place, push_n, said) = self;
        let push = said.spoken.number(*push_n, "N");
        write!(f, "hit push {}: {push}, {}, rms {}", place + 1, said.verdict(), said.rms())?;
        said.quiet(f)
    }
}

/// Prints the K and B of a cell of the walk's grid.
struct Wall<'a>(&'a WalkSettings, Cell, Spoken);

impl fmt::Display for Wall<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(plan, cell, spoken) = *self;
        let k = spoken.number(plan.stiffness_n_per_m(cell), "N/m");
        let b = spoken.number(plan.damping_n_s_per_m(cell), "N s/m");
        write!(f, "k {k}, b {b}")
    }
}

/// The line about one verdict of a walk. The fields are the number of the hit, the walk's grid, the grid's cell with
/// this hit's K and B, and the hit.
pub struct CellJudged<'a>(pub u32, pub &'a WalkSettings, pub Cell, pub SaidHit);

impl fmt::Display for CellJudged<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(hits, plan, cell, said) = self;
        let wall = Wall(plan, *cell, said.spoken);
        write!(f, "walk hit {hits}: {wall}, {}, rms {}", said.verdict(), said.rms())?;
        said.quiet(f)
    }
}

/// The line about one point of the boundary that a walk finds. The fields are the number of the point, the walk's grid,
/// the point's cell in it, and the units.
pub struct BoundaryPoint<'a>(pub u32, pub &'a WalkSettings, pub Cell, pub Spoken);

impl fmt::Display for BoundaryPoint<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(number, plan, cell, spoken) = self;
        write!(f, "walk boundary {number}: {}", Wall(plan, *cell, *spoken))
    }
}

/// The line that reports the end of a walk. The fields are the walk's totals, the reason for its end, and the units.
pub struct WalkOver(pub WalkTotals, pub Result<Ended, &'static str>, pub Spoken);

impl fmt::Display for WalkOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(totals, ended, spoken) = self;
        f.write_str(if ended.is_ok() { "ok walk over" } else { "error: walk" })?;
        if let Err(why) = ended {
            write!(f, ": {why}")?;
        }
        write!(
            f,
            ", area {}, peak k {}, largest b {}, hits {}, points {}",
            spoken.number(totals.area, "N^2 s/m^2"),
            spoken.number(totals.stiffness_peak_n_per_m, "N/m"),
            spoken.number(totals.damping_max_n_s_per_m, "N s/m"),
            totals.hits,
            totals.points,
        )?;
        match ended {
            Ok(ended) => write!(f, ", ended by {}", ended.name()),
            Err(_) => Ok(()), // the line begins with the reason
        }
    }
}

/// Prints the force of an output as a part of full scale and as a code. The second field is the force at full scale. If
/// it is known, the force is also printed in N.
struct Output(Record, f64, Spoken);

impl fmt::Display for Output {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let part = f64::from(self.0.force.bits()) / f64::from(1u32 << 30);
        let (percent, force) = (Decimal(part * 100.0), self.2.number(part * self.1, "N"));
        let code = self.0.command.code();
        write!(f, "{percent} % of full scale, code {code}, {force}")?;
        write!(f, " with full scale {}", self.2.number(self.1, "N"))
    }
}

/// The line that reports that a calibration now holds its whole force. The fields are the output, full scale as the
/// settings have it, and the units.
pub struct CalibrationHolds(pub Record, pub f64, pub Spoken);

impl fmt::Display for CalibrationHolds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "calibrate holds {}", Output(self.0, self.1, self.2))
    }
}

/// The line that reports the end of a calibration. The fields are the reason, the last output, full scale as the
/// settings have it, and the units.
pub struct CalibrationOver(pub CalibrationEnd, pub Record, pub f64, pub Spoken);

impl fmt::Display for CalibrationOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ok calibrate over: {}, at {}", self.0.text(), Output(self.1, self.2, self.3))
    }
}
