//! The tables that every scene has.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use zwidth::experiment::quiet;

use super::FeltCurve;

/// Mass, damper and spring: `m x'' + b x' + k (x - x0) = F`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Device {
    pub mass_kg: f64,
    pub damping_n_s_per_m: f64,
    pub stiffness_n_per_m: f64,
    pub rest_position_m: f64,
    /// Where the handle rests before a hit, m.
    pub start_position_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Encoder {
    /// Length of a count, m per count.
    pub resolution_m: f64,
    /// How a position becomes a count.
    pub rounding: Rounding,
}

/// How a position becomes a count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rounding {
    /// `floor(x / resolution)`, as an incremental encoder does.
    Floor,
    /// `floor(x / resolution + 1/2)`.
    Round,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Actuator {
    /// Force per volt of command, N/V.
    pub gain_n_per_v: f64,
    /// Largest magnitude of a command, V.
    pub limit_v: f64,
    /// Samples from output to output.
    pub period: u32,
    /// Samples from the encoder reading to the force on the handle; need not be whole.
    pub latency: f64,
    /// An estimator that is told the force is told it when it acts, to the nearest sample, and not when it
    /// is granted.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub latency_known: bool,
}

impl Actuator {
    /// The latency to the nearest whole sample.
    pub fn latency_samples(&self) -> u32 {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 to 1000 by the scene's check"
        )]
        let samples = self.latency.round() as u32;
        samples
    }
}

/// Longest latency that may be known, in samples.
pub const LATENCY_KNOWN_MAX: u32 = 64;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sampling {
    /// Encoder samples per second, Hz.
    pub rate_hz: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// Position of the surface, m.
    pub position_m: f64,
    /// The wall never pulls.
    pub push_only: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WallHit {
    /// Constant push of a hit, N.
    pub push_n: f64,
    #[serde(default, skip_serializing_if = "PushBy::is_motor")]
    pub push_by: PushBy,
    /// How the wall is tried.
    #[serde(default, skip_serializing_if = "Protocol::is_paper")]
    pub protocol: Protocol,
    /// Time before the window, s.
    pub settle_s: f64,
    /// Length of the window, s.
    pub window_s: f64,
    /// `stable` is an RMS below this, m.
    pub rms_limit_m: f64,
    /// What the RMS is taken of: counts without, and the motion with the criterion `quiet`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_of: Option<RmsOf>,
    /// What counts as stable.
    #[serde(default, skip_serializing_if = "Criterion::is_rms")]
    pub criterion: Criterion,
    /// File of the least motion that is felt, relative to the scene's; the built-in model without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub felt_curve: Option<PathBuf>,
    /// With the criterion `felt`, `stable` is a sensation level below this, dB.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub felt_limit_db: f64,
    /// With the criterion `quiet`, `stable` is an RMS of the force below this, N; 7 % of the push without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_rms_limit_n: Option<f64>,
    /// Content of the file `felt_curve`.
    #[serde(skip)]
    pub felt: FeltCurve,
}

impl WallHit {
    /// What the RMS is taken of.
    pub fn rms_of(&self) -> RmsOf {
        self.rms_of.unwrap_or(match self.criterion {
            Criterion::Quiet => RmsOf::Motion,
            Criterion::Rms | Criterion::Unsaturated | Criterion::Felt => RmsOf::Counts,
        })
    }

    /// Times before the window and of the window, s, as the protocol has them.
    pub fn times_s(&self) -> [f64; 2] {
        match self.protocol {
            Protocol::Paper | Protocol::Hand => [self.settle_s, self.window_s],
            Protocol::Press => [58.0, 2.0],
            Protocol::Taps => [TAP_S, 11.0 * TAP_S],
        }
    }

    /// Judged by that; what goes without saying is not said.
    pub fn judge(&mut self, criterion: Criterion, rms_of: Option<RmsOf>) {
        (self.criterion, self.rms_of) = (criterion, None);
        self.rms_of = rms_of.filter(|rms_of| *rms_of != self.rms_of());
    }

    /// With the criterion `quiet`, `stable` is an RMS of the force below this, N.
    pub fn force_rms_limit_n(&self) -> f64 {
        self.force_rms_limit_n.unwrap_or(quiet::FORCE_SHARE * self.push_n.abs())
    }

    /// The same with a push of another size, and the limits of this one.
    pub(crate) fn with_push(&self, share: f64) -> Self {
        let force_rms_limit_n = Some(self.force_rms_limit_n());
        Self { push_n: share * self.push_n, force_rms_limit_n, ..self.clone() }
    }
}

/// What the RMS of a window is taken of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RmsOf {
    /// The encoder's counts, as in the paper.
    #[default]
    Counts,
    /// The true positions at the samples.
    Motion,
}

impl RmsOf {
    pub fn name(self) -> &'static str {
        match self {
            Self::Counts => "counts",
            Self::Motion => "motion",
        }
    }
}

/// From one tap to the next, s.
pub const TAP_S: f64 = 0.5;
/// A hand's push is off by at most this share.
pub const HAND_SWAY: f64 = 0.3;

/// How a wall is tried, beside its criterion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// The paper's: a constant push from the start position, and a window.
    #[default]
    Paper,
    /// The last two seconds of a minute of it.
    Press,
    /// Taps, two a second: the last half of each contact is a window.
    Taps,
    /// The push of a hand that is not steady.
    Hand,
}

impl Protocol {
    pub const ALL: [Self; 4] = [Self::Paper, Self::Press, Self::Taps, Self::Hand];

    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Press => "press",
            Self::Taps => "taps",
            Self::Hand => "hand",
        }
    }

    /// Its name where it is not the paper's.
    pub fn named(self) -> Option<&'static str> {
        (self != Self::Paper).then(|| self.name())
    }

    /// The push changes during a hit.
    pub fn varies(self) -> bool {
        matches!(self, Self::Taps | Self::Hand)
    }

    fn is_paper(&self) -> bool {
        *self == Self::Paper
    }
}

/// When a wall that was touched counts as stable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Criterion {
    /// The RMS is below its limit.
    #[default]
    Rms,
    /// That, and no output of the window is at the actuator's limit.
    Unsaturated,
    /// The motion's sensation level is below its limit.
    Felt,
    /// At each of [four pushes](quiet::PUSHES) handle and force rest, and the wall stands.
    Quiet,
}

impl Criterion {
    pub const ALL: [Self; 4] = [Self::Rms, Self::Unsaturated, Self::Felt, Self::Quiet];

    pub fn name(self) -> &'static str {
        match self {
            Self::Rms => "rms",
            Self::Unsaturated => "unsaturated",
            Self::Felt => "felt",
            Self::Quiet => "quiet",
        }
    }

    fn is_rms(&self) -> bool {
        *self == Self::Rms
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's form")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Who pushes the handle into the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PushBy {
    /// The motor: push and wall share its range.
    #[default]
    Motor,
    /// A hand: a constant force on the last body of the row, which is the handle, or the arm if there is one.
    Hand,
}

impl PushBy {
    pub const ALL: [Self; 2] = [Self::Motor, Self::Hand];

    pub fn name(self) -> &'static str {
        match self {
            Self::Motor => "motor",
            Self::Hand => "hand",
        }
    }

    fn is_motor(&self) -> bool {
        *self == Self::Motor
    }
}

/// The boundary walk's grid and caps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    pub stiffness_start_n_per_m: f64,
    /// Step of K, N/m.
    pub stiffness_step_n_per_m: f64,
    pub stiffness_max_n_per_m: f64,
    /// First B, N s/m.
    pub damping_start_n_s_per_m: f64,
    /// Step of B, N s/m.
    pub damping_step_n_s_per_m: f64,
    /// Largest B, N s/m.
    pub damping_max_n_s_per_m: f64,
}

/// The study over cutoffs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sweep {
    pub cutoffs_hz: Vec<f64>,
}
