//! The tables that every scene has.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use zwidth::experiment::quiet;

use super::FeltCurve;

/// Mass, damper and spring: `m x'' + b x' + k (x - x0) = F`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Device {
    /// Mass `m` at the handle.
    pub mass_kg: f64,
    /// Viscous damping `b`.
    pub damping_n_s_per_m: f64,
    /// Stiffness `k` of the device's spring.
    pub stiffness_n_per_m: f64,
    /// Rest position `x0` of the spring.
    pub rest_position_m: f64,
    /// Rest position of the handle before a hit; before the wall.
    pub start_position_m: f64,
}

/// The encoder at the handle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Encoder {
    /// Length of one count.
    pub resolution_m: f64,
    /// Conversion of a position to a count.
    pub rounding: Rounding,
}

/// Conversion of a position to a count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Rounding {
    /// `floor(x / resolution)`, as an incremental encoder does.
    Floor,
    /// `floor(x / resolution + 1/2)`.
    Round,
}

/// Amplifier and motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Actuator {
    /// Force per volt of command. Full scale is `gain_n_per_v * limit_v`, 1e-3 to 1e5 N.
    pub gain_n_per_v: f64,
    /// Largest magnitude of a command.
    pub limit_v: f64,
    /// Number of samples from one output to the next. The boards have 1, 2, 5 and 10.
    pub period: u32,
    /// Number of samples from the encoder reading to the force on the handle. It may be a fraction.
    pub latency: f64,
    /// When an observer with force input gets a force. `true`: when the force acts, to the nearest sample; latency up
    /// to 64 samples. `false`: when safety grants the force, as on the boards. Absent: `false`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub latency_known: bool,
}

impl Actuator {
    /// The latency, rounded to whole samples.
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

/// Longest latency with `latency_known`, in samples.
pub const LATENCY_KNOWN_MAX: u32 = 64;

/// The sampled controller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sampling {
    /// Encoder samples per second.
    pub rate_hz: f64,
}

/// The virtual wall: spring and damper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// Position of the wall's surface, within 2^30 counts. The wall is at larger positions.
    pub position_m: f64,
    /// Whether the wall only pushes the handle, and never pulls it.
    pub push_only: bool,
}

/// The experiment: a push into the wall, and the criterion for a stable wall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WallHit {
    /// Constant push into the wall. It is at most full scale if the motor pushes; with `quiet` at most full scale / 1.03.
    pub push_n: f64,
    /// Who pushes the handle into the wall. Absent: `motor`.
    #[serde(default, skip_serializing_if = "PushBy::is_motor")]
    pub push_by: PushBy,
    /// How the wall is tried. Absent: `paper`. `taps`: the start is before the wall. `hand`: 1.3 times the push is
    /// within full scale, the window is at least 0.5 s, and there are at least 100 outputs a second.
    #[serde(default, skip_serializing_if = "Protocol::is_paper")]
    pub protocol: Protocol,
    /// Time before the window; 1 to 2^24 samples.
    pub settle_s: f64,
    /// Time of the window, which is judged; 1 to 2^24 samples, with `felt` 0.5 s to 2^17 samples.
    pub window_s: f64,
    /// With `rms`, a wall is stable if the RMS is below this limit; 0.001 to 65535 counts.
    pub rms_limit_m: f64,
    /// Signal whose RMS is judged. Absent: `motion` with the criterion `quiet`, else `counts`.
    pub rms_of: Option<RmsOf>,
    /// When a wall counts as stable. Absent: `rms`.
    #[serde(default, skip_serializing_if = "Criterion::is_rms")]
    pub criterion: Criterion,
    /// File of the least motion that is felt; the path is relative to the scene's folder. Two columns: frequency in Hz
    /// and amplitude in m; up to 10,000 rows and 1 MiB. Absent: a model.
    pub felt_curve: Option<PathBuf>,
    /// With `felt`, a wall is stable if its sensation level is below this limit. Absent: 0.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub felt_limit_db: f64,
    /// With `quiet`, a wall is stable if the RMS of the force is below this limit. Absent: 7 % of the push.
    pub force_rms_limit_n: Option<f64>,
    /// Content of the file `felt_curve`.
    #[serde(skip)]
    pub felt: FeltCurve,
}

impl WallHit {
    /// Signal of the RMS, or its default.
    pub fn rms_of(&self) -> RmsOf {
        self.rms_of.unwrap_or(match self.criterion {
            Criterion::Quiet => RmsOf::Motion,
            Criterion::Rms | Criterion::Unsaturated | Criterion::Felt => RmsOf::Counts,
        })
    }

    /// Settling time before the window, and length of the window, in s, for this protocol.
    pub fn times_s(&self) -> [f64; 2] {
        match self.protocol {
            Protocol::Paper | Protocol::Hand => [self.settle_s, self.window_s],
            Protocol::Press => [58.0, 2.0],
            Protocol::Taps => [TAP_S, 11.0 * TAP_S],
        }
    }

    /// Sets the criterion, and the signal whose RMS is judged. If the signal is the default, `None` is stored.
    pub fn judge(&mut self, criterion: Criterion, rms_of: Option<RmsOf>) {
        (self.criterion, self.rms_of) = (criterion, None);
        self.rms_of = rms_of.filter(|rms_of| *rms_of != self.rms_of());
    }

    /// With the criterion `quiet`, a hit is `stable` only if the RMS of the force is below this limit, in N.
    pub fn force_rms_limit_n(&self) -> f64 {
        self.force_rms_limit_n.unwrap_or(quiet::FORCE_SHARE * self.push_n.abs())
    }

    /// The same hit with the push multiplied by `share`. The limits stay the same as for the original push.
    pub(crate) fn with_push(&self, share: f64) -> Self {
        let force_rms_limit_n = Some(self.force_rms_limit_n());
        Self { push_n: share * self.push_n, force_rms_limit_n, ..self.clone() }
    }
}

/// Signal of a window's RMS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
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

/// Time between two taps in s.
pub const TAP_S: f64 = 0.5;
/// Largest change of a hand's push, as a fraction of the push.
pub const HAND_SWAY: f64 = 0.3;

/// How a wall is tried, beside its criterion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// A constant push from the start position, and a window.
    #[default]
    Paper,
    /// The last two seconds of a constant push of a minute.
    Press,
    /// Two taps a second. The last half of each contact is a window.
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

    /// Name of the protocol, or `None` for `paper`.
    pub fn named(self) -> Option<&'static str> {
        (self != Self::Paper).then(|| self.name())
    }

    /// Whether the push changes during a hit.
    pub fn varies(self) -> bool {
        matches!(self, Self::Taps | Self::Hand)
    }

    fn is_paper(&self) -> bool {
        *self == Self::Paper
    }
}

/// When a wall that the handle has touched counts as stable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Criterion {
    /// The RMS is below its limit.
    #[default]
    Rms,
    /// The RMS is below its limit, and no output in the window is at the actuator's limit.
    Unsaturated,
    /// The motion's sensation level is below its limit.
    Felt,
    /// At each of four pushes, handle and force are at rest, and the wall has the commanded K.
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

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Who pushes the handle into the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PushBy {
    /// The motor pushes, and the wall uses the same motor. Push and wall share the motor's range.
    #[default]
    Motor,
    /// A hand pushes with a constant force on the last body of the chain: the handle, or the arm if there is one.
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

/// Grid and upper limits of the boundary walk.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    /// First K, at most the largest K.
    pub stiffness_start_n_per_m: f64,
    /// Step of K, at least 1e-6 of the largest K.
    pub stiffness_step_n_per_m: f64,
    /// Largest K.
    pub stiffness_max_n_per_m: f64,
    /// First B, at most the largest B.
    pub damping_start_n_s_per_m: f64,
    /// Step of B, at least 1e-6 of the largest B.
    pub damping_step_n_s_per_m: f64,
    /// Largest B.
    pub damping_max_n_s_per_m: f64,
}

/// The study over cutoffs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sweep {
    /// Nominal cutoffs, up to 0.499 of the sampling rate (0.38 with `prewarp`).
    pub cutoffs_hz: Vec<f64>,
}
