//! Scene files: one device, one controller, one study. The files are in TOML. The name of a key contains its unit.
//!
//! Unknown keys and values out of range are errors. Each physical element has a table; without the table the element is
//! not modelled. A scene with `[rotary]` is written in rad and N m ([`rotary`]). In memory all values are in m and N at
//! the handle.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use zwidth::{
    Design, HitSettings, Output, Settings, VelocitySettings, WallSettings,
    device::designs::is_design_name,
    experiment::{WalkSettings, quiet},
};

pub use crate::scene::velocity::VelocityTable;
use crate::{
    error::Error,
    input,
    numerics::integrator::Integrator,
    scene::element::{
        Amplifier, AmplifierError, Arm, Backlash, Chain, Cogging, EncoderError, EncoderNoise,
        Friction, Jitter, Mode, Nonlinear, Offset, Travel,
    },
};

mod accelerometer;
mod board;
mod check;
mod designs;
pub mod element;
mod elements;
mod felt;
mod fits;
mod passivity;
pub mod read_back;
pub mod record;
pub mod rotary;
pub mod schema;
mod tables;
mod uncertainty;
pub mod units;
pub mod velocity;

pub use accelerometer::Accelerometer;
pub use board::{BoardTable, MotorTable, OnBoard, ReturnTable, SafetyTable, Sign};
pub use check::ranges;
pub use elements::Quantisation;
pub use felt::FeltCurve;
pub use passivity::PassivityTable;
pub use tables::{
    Actuator, Criterion, Device, Encoder, HAND_SWAY, LATENCY_KNOWN_MAX, Protocol, PushBy, RmsOf,
    Rounding, Sampling, Sweep, TAP_S, Walk, Wall, WallHit,
};
pub use uncertainty::Uncertainty;
pub use units::Units;

/// The built-in scenes. Each has a name and a text.
pub const BUILT_IN: &[(&str, &str)] = &[
    ("paper-1um", include_str!("../../../../scenes/paper-1um.toml")),
    ("paper-2um", include_str!("../../../../scenes/paper-2um.toml")),
    ("nucleo-f446re", include_str!("../../../../scenes/nucleo-f446re.toml")),
    ("discovery-f407", include_str!("../../../../scenes/discovery-f407.toml")),
    ("epfl-paddle", include_str!("../../../../scenes/epfl-paddle.toml")),
    ("rice-paddle", include_str!("../../../../scenes/rice-paddle.toml")),
    ("hapkit", include_str!("../../../../scenes/hapkit.toml")),
    ("smartknob", include_str!("../../../../scenes/smartknob.toml")),
];

/// The built-in scenes of the paper's study.
pub const STUDY: [&str; 2] = ["paper-1um", "paper-2um"];

/// A scene with its name and text. It is read from a file, or built in.
#[derive(Clone, Debug)]
pub struct NamedScene {
    /// Built-in name, or the file's name without its extension.
    pub name: String,
    pub text: String,
    /// Files from which the scene was read. The list is empty for a built-in scene.
    pub files: Vec<PathBuf>,
    pub scene: Scene,
}

/// Device, controller and study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Keys whose values are neither measured nor published. Reports name these keys.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub estimated: Vec<String>,
    pub device: Device,
    pub encoder: Encoder,
    pub actuator: Actuator,
    pub control: Sampling,
    pub velocity: VelocityTable,
    pub wall: Wall,
    pub wall_hit: WallHit,
    pub walk: Walk,
    /// The study over cutoffs.
    pub sweep: Sweep,
    /// Optional element: quantisation of the command by a DAC or PWM timer.
    pub output: Option<Quantisation>,
    /// Optional element: the current loop's pole.
    pub amplifier: Option<Amplifier>,
    /// Optional element: a force that is not proportional to the command.
    pub amplifier_error: Option<AmplifierError>,
    /// Optional element: a second mass behind the transmission.
    pub mode: Option<Mode>,
    /// Optional element: a gap in the transmission.
    pub backlash: Option<Backlash>,
    /// Optional element: a person's arm on the handle.
    pub arm: Option<Arm>,
    /// Arms of several people, by name, for studies over people.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub arms: BTreeMap<String, Arm>,
    /// Velocity filters by name, for the board and for `SCENE:NAME`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub designs: BTreeMap<String, VelocityTable>,
    /// Optional element: a constant force on the device.
    pub offset: Option<Offset>,
    /// Optional element: dry friction.
    pub friction: Option<Friction>,
    /// Optional element: the motor's cogging.
    pub cogging: Option<Cogging>,
    /// Optional element: travel limits.
    pub travel: Option<Travel>,
    /// Optional element: the encoder's periodic error.
    pub encoder_error: Option<EncoderError>,
    /// Optional element: the encoder's noise.
    pub encoder_noise: Option<EncoderNoise>,
    /// Optional element: late readings.
    pub jitter: Option<Jitter>,
    /// Method to integrate a plant that is not linear. For a linear plant the method replaces the exact step.
    pub integrator: Option<Integrator>,
    /// Optional element: an accelerometer on the body that carries the encoder.
    pub accelerometer: Option<Accelerometer>,
    /// Optional element: the wall's passivity controller.
    pub passivity: Option<PassivityTable>,
    /// Uncertainty of the device's values.
    pub uncertainty: Option<Uncertainty>,
    /// The board, for its firmware.
    pub board: Option<BoardTable>,
    /// Limits of the board's supervisor.
    pub safety: Option<SafetyTable>,
    /// Limits of the motor.
    pub motor: Option<MotorTable>,
    /// The board's return move between two hits.
    #[serde(rename = "return")]
    pub back: Option<ReturnTable>,
    /// Units of the file from which the scene was read, and of the results. A scene that the program writes is always
    /// in m and N.
    #[serde(skip)]
    pub units: Units,
}

impl NamedScene {
    /// Reads the built-in scene of this name, or the scene file at this path. In the form `SCENE:NAME`, the scene's
    /// filter is replaced by its design NAME.
    ///
    /// # Errors
    /// [`Error::Input`]: there is no such scene or no such design, the file is not TOML, a key is unknown, or a value
    /// is out of range.
    pub fn load(name_or_path: &str) -> Result<Self, Error> {
        if let Some((scene, design)) = name_or_path.rsplit_once(':')
            && is_design_name(design)
            && !Path::new(name_or_path).exists()
        {
            return Self::load(scene)?.with_design(design);
        }
        if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse((*name).into(), (*text).into(), name);
        }
        let path = Path::new(name_or_path);
        let text = input::read_text(path, input::SCENE).map_err(|error| match error {
            Error::Input(text) if !path.exists() => {
                let names = BUILT_IN.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
                Error::Input(format!("{text} (built-in scenes: {names})"))
            }
            other => other,
        })?;
        let stem = path.file_stem().unwrap_or(path.as_os_str());
        let stem = stem.to_string_lossy().into_owned();
        let mut scene = Self::parsed(stem, text, name_or_path, path.parent())?;
        scene.files.insert(0, path.into());
        Ok(scene)
    }

    /// Reads `text`. `origin` is the scene's name in error messages.
    ///
    /// # Errors
    /// [`Error::Input`], see [`load`](Self::load).
    pub fn parse(name: String, text: String, origin: &str) -> Result<Self, Error> {
        Self::parsed(name, text, origin, None)
    }

    /// The keys of the scene's text. The path of a curve is made absolute, so that the curve is found from any folder.
    ///
    /// # Errors
    /// [`Error::Internal`]: the text is not TOML. This cannot happen for a scene that was read.
    pub fn table(&self) -> Result<toml::Table, Error> {
        let mut table: toml::Table = self
            .text
            .parse()
            .map_err(|error: toml::de::Error| Error::Internal(error.to_string()))?;
        let curve = self.scene.wall_hit.felt_curve.is_some().then(|| self.files.last()).flatten();
        if let (Some(curve), Some(toml::Value::Table(hit))) = (curve, table.get_mut("wall_hit")) {
            let whole = std::path::absolute(curve).unwrap_or_else(|_| curve.clone());
            hit.insert("felt_curve".into(), whole.to_string_lossy().into_owned().into());
        }
        Ok(table)
    }

    /// Makes a scene from these keys. Error messages name the key, because there is no line number.
    ///
    /// # Errors
    /// The errors of [`parse`](Self::parse).
    pub fn of_table(name: String, table: toml::Table, origin: &str) -> Result<Self, Error> {
        let internal = |error: toml::ser::Error| Error::Internal(error.to_string());
        let text = toml::to_string(&table).map_err(internal)?;
        if !table.contains_key("rotary") {
            let read: Result<Scene, _> = Scene::deserialize(table);
            read.map_err(|error| Error::Input(format!("{origin}: {}", told_of(&error))))?;
        }
        Self::parse(name, text, origin)
    }

    /// The same as [`parse`](Self::parse). `folder` is the folder of the files that the scene names.
    fn parsed(
        name: String,
        text: String,
        origin: &str,
        folder: Option<&Path>,
    ) -> Result<Self, Error> {
        let at_line = |error: toml::de::Error| {
            let start = error.span().map_or(0, |span| span.start);
            let line = text[..start.min(text.len())].matches('\n').count() + 1;
            let message = error.message().replace('\n', " ");
            Error::Input(format!("{origin}:{line}: {}: {message}", line_of(&text, line)))
        };
        let refused =
            |units: Units, error: &str| Error::Input(format!("{origin}: {}", units.text(error)));
        let table: toml::Table = toml::from_str(&text).map_err(at_line)?;
        check_estimated(&table).map_err(|error| refused(Units::Linear, &error))?;
        let mut scene: Scene = if table.contains_key("rotary") {
            let read = rotary::at_handle(table).map_err(|error| refused(Units::Linear, &error));
            let (table, units) = read?;
            let scene = Scene::deserialize(table);
            let scene = scene.map_err(|error| refused(units, &in_one_line(&error)))?;
            Scene { units, ..scene }
        } else {
            toml::from_str(&text).map_err(at_line)?
        };
        let checked = scene.check().and_then(|()| scene.check_start());
        checked.map_err(|error| refused(scene.units, &error))?;
        scene.wall_hit.judge(scene.wall_hit.criterion, scene.wall_hit.rms_of);
        let curve = scene.wall_hit.felt_curve.as_ref();
        let curve = curve.map(|path| folder.unwrap_or(Path::new("")).join(path));
        if let Some(path) = &curve {
            scene.wall_hit.felt = FeltCurve::load(path)
                .map_err(|error| Error::Input(format!("{origin}: wall_hit.felt_curve: {error}")))?;
        }
        Ok(Self { name, text, files: curve.into_iter().collect(), scene })
    }
}

/// Checks that the scene has every key that `estimated` lists.
fn check_estimated(scene: &toml::Table) -> Result<(), String> {
    let keys = scene.get("estimated").and_then(toml::Value::as_array);
    for key in keys.into_iter().flatten().filter_map(toml::Value::as_str) {
        // A scene that was converted from a rotary scene keeps the rotary keys in `estimated`.
        if key.starts_with("rotary.") && !scene.contains_key("rotary") {
            continue;
        }
        let mut parts = key.split('.');
        let first = parts.next().and_then(|first| scene.get(first));
        if parts.try_fold(first, |value, part| Some(value?.get(part))).flatten().is_none() {
            return Err(format!("estimated has `{key}`, allowed keys that the scene has"));
        }
    }
    Ok(())
}

/// Table and message of an error, as one text.
fn told_of(error: &toml::de::Error) -> String {
    let text = error.to_string();
    let place = text.lines().find_map(|line| line.trim().strip_prefix("in "));
    let place = place.map_or_else(String::new, |place| format!("{}: ", place.trim_matches('`')));
    format!("{place}{}", error.message().replace('\n', " "))
}

/// Writes an error in a converted rotary scene in one line: its table, then its message, with the rotary keys.
fn in_one_line(error: &toml::de::Error) -> String {
    let message = told_of(error);
    let parts = message.split('`').enumerate();
    let told = |(n, part): (usize, &str)| match Units::rotary_key(part) {
        Some(rotary) if n % 2 == 1 => rotary,
        _ => part.to_owned(),
    };
    parts.map(told).collect::<Vec<_>>().join("`")
}

/// The text of the line that has the error, shortened.
fn line_of(text: &str, line: usize) -> String {
    let line = text.lines().nth(line - 1).unwrap_or_default().trim();
    format!("`{}`", line.chars().take(60).collect::<String>())
}

impl Scene {
    /// The keys of `estimated`, spelled as in the scene's file.
    pub fn estimated_keys(&self) -> Vec<String> {
        let told = |key: &String| match key.starts_with("rotary.") {
            true => key.clone(),
            false => self.units.key(key).map_or_else(|| key.clone(), |(told, _)| told),
        };
        self.estimated.iter().map(told).collect()
    }

    /// A note for reports: the estimated keys, and how to measure them.
    pub fn estimated_note(&self) -> Option<String> {
        let keys = self.estimated_keys().join(", ");
        (!keys.is_empty()).then(|| {
            format!("estimated, neither measured nor published: {keys}; cargo sim identify finds mass, damping, stiffness, friction and lag of your own, data sheet and gauge the rest")
        })
    }

    pub fn chain(&self) -> Chain {
        let Self { device, mode, arm, amplifier, .. } = *self;
        let offset_n = self.offset.map_or(0.0, |offset| offset.force_n);
        Chain { device, mode, arm, amplifier, hand_n: self.push_n(PushBy::Hand), offset_n }
    }

    /// The push of a hit in N, if `by` pushes. Otherwise 0.
    pub fn push_n(&self, by: PushBy) -> f64 {
        if self.wall_hit.push_by == by { self.wall_hit.push_n } else { 0.0 }
    }

    pub fn nonlinear(&self) -> Nonlinear {
        let Self { friction, cogging, travel, .. } = *self;
        let backlash = self.backlash.filter(|backlash| backlash.gap_m > 0.0);
        Nonlinear { friction, cogging, travel, backlash }
    }

    /// Force at full command in N.
    pub fn full_scale_n(&self) -> f64 {
        self.actuator.gain_n_per_v * self.actuator.limit_v
    }

    /// The core's settings that are fixed for the device.
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
        velocity: VelocitySettings,
        stiffness_n_per_m: f64,
        damping_n_s_per_m: f64,
    ) -> Settings {
        Settings {
            velocity,
            wall: WallSettings {
                position_m: self.wall.position_m,
                stiffness_n_per_m,
                damping_n_s_per_m,
                push_only: self.wall.push_only,
            },
        }
    }

    /// -3 dB frequency of the scene's filter at this nominal cutoff, in Hz.
    pub fn true_cutoff_hz(&self, cutoff_hz: f64) -> f64 {
        let filter = self.velocity.at(cutoff_hz);
        filter.true_cutoff_hz(self.control.rate_hz).unwrap_or(cutoff_hz)
    }

    /// Names of the arms in `[arms]` and of the built-in arms.
    pub fn arm_names(&self) -> Vec<String> {
        let built_in = Arm::BUILT_IN.iter().map(|(name, _)| (*name).to_owned());
        let mut names: Vec<String> = self.arms.keys().cloned().chain(built_in).collect();
        names.sort();
        names.dedup();
        names
    }

    /// An arm of `[arms]`, or a built-in arm.
    pub fn named_arm(&self, name: &str) -> Result<Arm, String> {
        let built_in = || Arm::BUILT_IN.iter().find(|(known, _)| *known == name);
        let own = self.arms.get(name).copied();
        own.or_else(|| {
            built_in().map(|(_, arm)| Arm { rest_position_m: self.device.start_position_m, ..*arm })
        })
        .ok_or_else(|| format!("there is no arm `{name}`, allowed {}", self.arm_names().join(", ")))
    }

    /// A hit can be `stable` only if its RMS is below this limit, in m. Every criterion has this condition.
    pub fn rms_limit_m(&self) -> f64 {
        match self.wall_hit.criterion {
            Criterion::Quiet => quiet::rms_limit_m(self.encoder.resolution_m),
            _ => self.wall_hit.rms_limit_m,
        }
    }

    /// The settings of the core's wall-hit experiment. The push is the motor's push.
    pub fn hit_settings(&self) -> HitSettings {
        let hit = &self.wall_hit;
        let [settle_s, window_s] = hit.times_s();
        HitSettings {
            push_n: self.push_n(PushBy::Motor),
            settle_s,
            window_s,
            rms_limit_m: hit.rms_limit_m,
        }
    }

    /// The settings of the boundary walk in the core.
    pub fn walk_plan(&self) -> WalkSettings {
        let walk = &self.walk;
        let [k_cap, b_cap] = self.caps();
        WalkSettings {
            stiffness_start_n_per_m: walk.stiffness_start_n_per_m,
            stiffness_step_n_per_m: walk.stiffness_step_n_per_m,
            stiffness_max_n_per_m: walk.stiffness_max_n_per_m.min(k_cap),
            damping_start_n_s_per_m: walk.damping_start_n_s_per_m,
            damping_step_n_s_per_m: walk.damping_step_n_s_per_m,
            damping_max_n_s_per_m: walk.damping_max_n_s_per_m.min(b_cap),
        }
    }

    /// Upper bounds of K and B for the criterion `quiet`. Other criteria have no bounds. At the bound of K, a depth of
    /// one count gives a force as large as the push. At the bound of B, a speed of one count per sample gives full
    /// force. A bound is never below the start of the walk.
    fn caps(&self) -> [f64; 2] {
        if self.wall_hit.criterion != Criterion::Quiet {
            return [f64::INFINITY; 2];
        }
        let (count_m, walk) = (self.encoder.resolution_m, &self.walk);
        let k = self.wall_hit.push_n.abs() / count_m;
        let b = self.full_scale_n() / (count_m * self.control.rate_hz);
        [k.max(walk.stiffness_start_n_per_m), b.max(walk.damping_start_n_s_per_m)]
    }
}
