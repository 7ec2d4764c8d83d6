//! One wall hit: what is hit, in which arithmetic, and what it showed.

use std::ops::Deref;

use zwidth::{SettingsError, VelocitySettings, experiment::Verdict, units::Position};

use super::{port::PortReport, twin, window::Measures};
use crate::error::Error;

/// Which arithmetic the controller uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Numeric {
    /// Fixed point: the core's arithmetic, as on the board.
    #[default]
    Fixed,
    /// Its twin in 64-bit floats.
    F64,
    /// The twin with its velocity rounded to the fixed-point LSB.
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

    /// How the twin rounds; `None` for the core.
    pub(crate) fn twin(self) -> Option<twin::Rounding> {
        match self {
            Self::Fixed => None,
            Self::F64 => Some(twin::Rounding::Exact),
            Self::F64Rounded => Some(twin::Rounding::VelocityLsb),
        }
    }
}

/// One wall, hit from one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallHit {
    pub velocity: VelocitySettings,
    pub stiffness_n_per_m: f64,
    pub damping_n_s_per_m: f64,
    /// Start, counts beyond the scene's start position.
    pub start_offset_counts: f64,
}

/// What a hit showed, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitReport {
    pub verdict: Verdict,
    pub measures: Measures,
    /// Mean of the measured position over the window, m.
    pub mean_m: f64,
    /// Deepest position behind the surface during the whole hit, m; 0 if it was never reached.
    pub peak_penetration_m: f64,
    /// Outputs that saturated, as a fraction of all outputs of the whole hit.
    pub saturated_fraction: f64,
    /// Samples in contact, as a fraction of the window.
    pub contact_fraction: f64,
    /// Samples with more counts since the last one than the core's velocity can say, as a fraction of the whole hit.
    pub velocity_clipped_fraction: f64,
    /// Energy exchanged by the wall's force over the counted motion; the push is left out.
    pub port: PortReport,
}

/// What its window showed is read as its own.
impl Deref for HitReport {
    type Target = Measures;

    fn deref(&self) -> &Measures {
        &self.measures
    }
}

impl HitReport {
    /// Of [`reports`](super::prepared::PreparedScene::reports) at several pushes the one that decides: the first that was
    /// not held, or the one whose force is the least quiet.
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

/// The result of the two pushes with the larger force RMS; `kept` if they are equal.
pub(crate) fn louder<T>(kept: Option<T>, next: T, force_n: impl Fn(&T) -> Option<f64>) -> T {
    match kept {
        Some(kept) if force_n(&next) <= force_n(&kept) => kept,
        _ => next,
    }
}

/// Why a hit has no verdict.
#[derive(Clone, Debug, PartialEq)]
pub enum HitError {
    /// A setting is out of range.
    Settings(SettingsError),
    /// The handle left the +-2^30 counts that the core accepts, at this sample.
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
