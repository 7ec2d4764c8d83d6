//! Scene files: one device, one controller, one study, in TOML with units in the names.
//!
//! Unknown keys are refused, and so is every value outside its range. Each physical element is a
//! table; an element that is absent is not modelled and costs nothing. A rotary device is described
//! at its handle through the capstan radius r: mass = J / r^2, damping = c / r^2,
//! resolution = r * angle per count, gain = k_t k_amp / r.

use std::{fs, path::Path};

use serde::{Deserialize, Serialize};
use zwidth::{Design, HitSettings, Output, Settings, WallSettings, experiment::WalkSettings};

pub use crate::scene::estimator::EstimatorChoice;
use crate::{
    error::Error,
    numerics::integrator::Integrator,
    scene::element::{
        Amplifier, Arm, Cogging, EncoderError, EncoderNoise, Friction, Jitter, Mode, Travel,
    },
};

mod accelerometer;
mod check;
pub mod element;
mod elements;
pub mod estimator;

pub use accelerometer::Accelerometer;
pub(crate) use check::within;
pub use check::{ranges, refused};
pub use elements::Quantisation;

/// The built-in scenes: name and text.
pub const BUILT_IN: [(&str, &str); 4] = [
    ("paper-1um", include_str!("../../../scenes/paper-1um.toml")),
    ("paper-2um", include_str!("../../../scenes/paper-2um.toml")),
    ("nucleo-f446re", include_str!("../../../scenes/nucleo-f446re.toml")),
    ("discovery-f407", include_str!("../../../scenes/discovery-f407.toml")),
];

/// The built-in scenes of the paper's study.
pub const STUDY: [&str; 2] = ["paper-1um", "paper-2um"];

/// A scene as read, with its name and text.
#[derive(Clone, Debug)]
pub struct NamedScene {
    /// Built-in name, or the file's name without its ending.
    pub name: String,
    /// The text it was read from.
    pub text: String,
    /// Its content.
    pub scene: Scene,
}

/// Device, controller and study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// The mechanical device.
    pub device: Device,
    /// Position sensor.
    pub encoder: Encoder,
    /// Amplifier and motor.
    pub actuator: Actuator,
    /// Sampling.
    pub control: Sampling,
    /// Velocity estimator.
    pub velocity: EstimatorChoice,
    /// The virtual wall.
    pub wall: Wall,
    /// The wall-hit experiment.
    pub wall_hit: WallHit,
    /// The boundary walk.
    pub walk: Walk,
    /// The study over cutoffs.
    pub sweep: Sweep,
    /// Optional element: quantisation of the command by a DAC or PWM timer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<Quantisation>,
    /// Optional element: the current loop's pole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub amplifier: Option<Amplifier>,
    /// Optional element: a second mass behind the transmission.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<Mode>,
    /// Optional element: a person's arm on the handle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arm: Option<Arm>,
    /// Optional element: dry friction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<Friction>,
    /// Optional element: the motor's cogging.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cogging: Option<Cogging>,
    /// Optional element: travel limits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub travel: Option<Travel>,
    /// Optional element: the encoder's periodic error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoder_error: Option<EncoderError>,
    /// Optional element: the encoder's noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoder_noise: Option<EncoderNoise>,
    /// Optional element: late readings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jitter: Option<Jitter>,
    /// How a plant is integrated that is not linear; on a linear one it takes the place of the exact step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub integrator: Option<Integrator>,
    /// Optional element: an accelerometer on the handle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accelerometer: Option<Accelerometer>,
}

/// Mass, damper and spring: `m x'' + b x' + k (x - x0) = F`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Device {
    /// m, kg.
    pub mass_kg: f64,
    /// b, N s/m.
    pub damping_n_s_per_m: f64,
    /// k, N/m.
    pub stiffness_n_per_m: f64,
    /// x0, m.
    pub rest_position_m: f64,
    /// Where the handle rests before a hit, m.
    pub start_position_m: f64,
}

/// Position sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Encoder {
    /// m per count.
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

/// Amplifier and motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Actuator {
    /// Force per volt of command, N/V.
    pub gain_n_per_v: f64,
    /// Largest command, V.
    pub limit_v: f64,
    /// Samples per output.
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

/// Sampling.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sampling {
    /// Encoder samples per second, Hz.
    pub rate_hz: f64,
}

/// The virtual wall.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// Surface, m.
    pub position_m: f64,
    /// The wall never pulls.
    pub push_only: bool,
}

/// The wall-hit experiment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WallHit {
    /// Constant push, N.
    pub push_n: f64,
    /// Time before the window, s.
    pub settle_s: f64,
    /// Window, s.
    pub window_s: f64,
    /// `stable` is an RMS below this, m.
    pub rms_limit_m: f64,
}

/// The boundary walk's grid and caps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    /// First K, N/m.
    pub stiffness_start_n_per_m: f64,
    /// Step of K, N/m.
    pub stiffness_step_n_per_m: f64,
    /// Largest K, N/m.
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
    /// Cutoffs, Hz.
    pub cutoffs_hz: Vec<f64>,
}

impl NamedScene {
    /// The built-in scene of that name, or the scene file at that path.
    ///
    /// # Errors
    /// [`Error::Input`]: no such scene, not TOML, an unknown key, a value out of range.
    pub fn load(name_or_path: &str) -> Result<Self, Error> {
        if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse((*name).into(), (*text).into(), name);
        }
        let path = Path::new(name_or_path);
        let text = fs::read_to_string(path).map_err(|error| {
            let names = BUILT_IN.map(|(name, _)| name).join(", ");
            Error::Input(format!("{name_or_path}: {error} (built-in scenes: {names})"))
        })?;
        let stem = path.file_stem().unwrap_or(path.as_os_str());
        Self::parse(stem.to_string_lossy().into_owned(), text, name_or_path)
    }

    /// Reads `text`; `origin` is what errors call it.
    ///
    /// # Errors
    /// [`Error::Input`], see [`load`](Self::load).
    pub fn parse(name: String, text: String, origin: &str) -> Result<Self, Error> {
        let scene: Scene = toml::from_str(&text).map_err(|error| {
            let start = error.span().map_or(0, |span| span.start);
            let line = text[..start.min(text.len())].matches('\n').count() + 1;
            let message = error.message().replace('\n', " ");
            Error::Input(format!("{origin}:{line}: {}: {message}", line_of(&text, line)))
        })?;
        scene.check().map_err(|error| Error::Input(format!("{origin}: {error}")))?;
        Ok(Self { name, text, scene })
    }
}

/// The line that an error is about, shortened.
fn line_of(text: &str, line: usize) -> String {
    let line = text.lines().nth(line - 1).unwrap_or_default().trim();
    format!("`{}`", line.chars().take(60).collect::<String>())
}

impl Scene {
    /// Force at full command, N.
    pub fn full_scale_n(&self) -> f64 {
        self.actuator.gain_n_per_v * self.actuator.limit_v
    }

    /// The core's fixed design.
    pub fn design(&self) -> Design {
        Design {
            rate_hz: self.control.rate_hz,
            resolution_m: self.encoder.resolution_m,
            full_scale_n: self.full_scale_n(),
            period: self.actuator.period,
            output: match self.output {
                None => Output::Continuous,
                Some(Quantisation::Dac { bits }) => Output::Dac { bits },
                Some(Quantisation::Pwm { steps }) => Output::Pwm { steps },
            },
        }
    }

    /// The core's settings for one wall.
    pub fn settings(
        &self,
        cutoff_hz: f64,
        stiffness_n_per_m: f64,
        damping_n_s_per_m: f64,
    ) -> Settings {
        Settings {
            velocity: self.velocity.settings(cutoff_hz),
            wall: WallSettings {
                position_m: self.wall.position_m,
                stiffness_n_per_m,
                damping_n_s_per_m,
                push_only: self.wall.push_only,
            },
        }
    }

    /// The core's wall-hit experiment.
    pub fn hit_settings(&self) -> HitSettings {
        let hit = &self.wall_hit;
        HitSettings {
            push_n: hit.push_n,
            settle_s: hit.settle_s,
            window_s: hit.window_s,
            rms_limit_m: hit.rms_limit_m,
        }
    }

    /// The core's boundary walk.
    pub fn walk_plan(&self) -> WalkSettings {
        let walk = &self.walk;
        WalkSettings {
            stiffness_start_n_per_m: walk.stiffness_start_n_per_m,
            stiffness_step_n_per_m: walk.stiffness_step_n_per_m,
            stiffness_max_n_per_m: walk.stiffness_max_n_per_m,
            damping_start_n_s_per_m: walk.damping_start_n_s_per_m,
            damping_step_n_s_per_m: walk.damping_step_n_s_per_m,
            damping_max_n_s_per_m: walk.damping_max_n_s_per_m,
        }
    }

    /// Frequency at which the filter of that nominal cutoff is at -3 dB, Hz.
    pub fn true_cutoff_hz(&self, cutoff_hz: f64) -> f64 {
        self.velocity.true_cutoff_hz(cutoff_hz, self.control.rate_hz)
    }
}
