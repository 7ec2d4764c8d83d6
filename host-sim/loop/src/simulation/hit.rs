//! One wall hit: the wall, the arithmetic of the controller, and the results.

use std::ops::Deref;

use zwidth::{SettingsError, VelocitySettings, experiment::Verdict, units::Position};

use super::{port::PortReport, twin, window::Measures};
use crate::error::Error;

/// Arithmetic of the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Numeric {
    /// Fixed point: the core's arithmetic, as on the board.
    #[default]
    Fixed,
    /// The twin of the core in 64-bit floats.
    F64,
    /// The twin, with its velocity rounded to the LSB of fixed point.
    F64Rounded,
}

impl Numeric {
    /// Name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::F64 => "f64",
            Self::F64Rounded => "f64-rounded",
        }
    }

    /// How the twin rounds. `None` if the hit runs the fixed-point core and not the twin.
    pub(crate) fn twin(self) -> Option<twin::Rounding> {
        match self {
            Self::Fixed => None,
            Self::F64 => Some(twin::Rounding::Exact),
            Self::F64Rounded => Some(twin::Rounding::VelocityLsb),
        }
    }
}

/// A wall, and the position from which a hit on it starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallHit {
    pub velocity: VelocitySettings,
    pub stiffness_n_per_m: f64,
    pub damping_n_s_per_m: f64,
    /// Start position in counts, relative to the scene's start position.
    pub start_offset_counts: f64,
}

/// Results of a hit, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitReport {
    pub verdict: Verdict,
    pub measures: Measures,
    /// Mean of the counts over the window, as a position in m.
    pub mean_m: f64,
    /// Deepest position behind the surface during the whole hit, in m. It is 0 without contact.
    pub peak_penetration_m: f64,
    /// Saturated outputs as a fraction of all outputs of the hit.
    pub saturated_fraction: f64,
    /// Samples in contact as a fraction of the window's samples.
    pub contact_fraction: f64,
    /// Samples whose count changed by more than the core's velocity can represent, as a fraction of all samples.
    pub velocity_clipped_fraction: f64,
    /// Energy that the wall exchanged with the hand. It is the wall's force over the motion of the counts; the push is
    /// not included.
    pub port: PortReport,
}

/// Lets the measures of the window be read like fields of the report.
impl Deref for HitReport {
    type Target = Measures;

    fn deref(&self) -> &Measures {
        &self.measures
    }
}

impl HitReport {
    /// Selects the report that decides the verdict, from the [`reports`](super::prepared::PreparedScene::reports) at
    /// several pushes. It is the first report that is not stable. If all are stable, it is the report with the largest
    /// force RMS.
    pub fn deciding(reports: &[(f64, Self)]) -> Option<Self> {
        let mut each = reports.iter().map(|(_, report)| *report);
        each.clone().find(|report| !report.is_stable()).or_else(|| {
            each.by_ref().fold(None, |worst, report| {
                Some(louder(worst, report, |report| Some(report.force_rms_n)))
            })
        })
    }

    pub fn is_stable(&self) -> bool {
        self.verdict == Verdict::Stable
    }
}

/// The result with the larger force RMS. If both forces are equal, the result is `kept`.
pub(crate) fn louder<T>(kept: Option<T>, next: T, force_n: impl Fn(&T) -> Option<f64>) -> T {
    match kept {
        Some(kept) if force_n(&next) <= force_n(&kept) => kept,
        _ => next,
    }
}

/// Reason why a hit has no verdict.
#[derive(Clone, Debug, PartialEq)]
pub enum HitError {
    Settings(SettingsError),
    /// At this sample the handle left the range that the core accepts, +-2^30 counts.
    OutOfRange(u64),
}

impl From<SettingsError> for HitError {
    fn from(error: SettingsError) -> Self {
        Self::Settings(error)
    }
}

impl std::fmt::Display for HitError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Settings(error) => error.fmt(f),
            Self::OutOfRange(sample) => write!(
                f,
                "out of range: the handle left +-{} counts at sample {sample}",
                Position::LIMIT
            ),
        }
    }
}

impl std::error::Error for HitError {}

impl From<HitError> for Error {
    fn from(error: HitError) -> Self {
        Self::input(error)
    }
}
