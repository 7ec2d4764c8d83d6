//! The options of a replay. Command line and Python share this code.

use std::{path::Path, sync::atomic::AtomicBool};

use serde::Serialize;
use zwidth::{Settings, VelocitySettings, WallSettings, velocity::EstimatorName};

use super::Replayed;
use crate::{
    analysis::{recompute::Recomputed, telemetry::Capture},
    error::Error,
    input, interrupt,
    scene::Scene,
};

/// The estimator with this name, at the cutoff of the scene's filter. Its other parameters have their defaults. Without
/// a name, the result is the scene's filter. Error messages name the name's option with `option`.
///
/// # Errors
/// The name is unknown, or a capture does not have the necessary inputs.
pub fn velocity(
    own: VelocitySettings,
    estimator: Option<&str>,
    option: &str,
) -> Result<VelocitySettings, Error> {
    let mut velocity = own;
    if let Some(wanted) = estimator {
        let found = EstimatorName::ALL.iter().find(|name| name.text() == wanted);
        let estimator = found.ok_or_else(|| {
            let known: Vec<_> = EstimatorName::ALL.iter().map(|name| name.text()).collect();
            Error::Input(match EstimatorName::replacing(wanted) {
                Some(other) => format!("{option} is {wanted}, which is no more: use {other}"),
                None => format!("{option} is {wanted}, allowed {}", known.join(", ")),
            })
        })?;
        velocity = estimator.following(&velocity);
    }
    if let Some(sense) = velocity.name().missing(&[]) {
        let (estimator, sense) = (velocity.name().text(), sense.text());
        return Err(Error::Input(format!(
            "{option} is {estimator}, which needs {sense} beside the count; a capture has none"
        )));
    }
    Ok(velocity)
}

/// Runs the estimator over the capture in a file.
///
/// # Errors
/// The tuning is out of range, the file cannot be read, the file has no range of consecutive samples, or `stop` was
/// set.
pub fn replay(
    path: &Path,
    scene: &Scene,
    velocity: VelocitySettings,
    stop: &AtomicBool,
) -> Result<Replayed, Error> {
    let wall = WallSettings {
        position_m: scene.wall.position_m,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        push_only: true,
    };
    let control = Settings { velocity, wall }.build(&scene.design()).map_err(Error::input)?;
    let bytes = input::read(path, input::RECORD)?;
    let recomputed = Recomputed::until(&Capture::decode_until(&bytes, stop), stop);
    interrupt::unless(stop)?;
    Replayed::of(&recomputed, &control).map_err(|step| {
        let name = path.display();
        Error::Input(match step {
            0 => format!("{name}: no telemetry in it; docs/telemetry.md has the layout"),
            1 => format!("{name}: fewer than 100 samples in a row, too few to replay"),
            step => format!(
                "{name}: a sample in {step} only, allowed every one: record again with an image that tells all of them"
            ),
        })
    })
}

/// LSB of the velocity in the core, converted to m/s.
pub fn lsb_m_per_s(scene: &Scene) -> f64 {
    scene.encoder.resolution_m * scene.control.rate_hz / 65_536.0
}

/// The report of a replay; docs/telemetry.md has the keys.
#[derive(Clone, Debug, Serialize)]
pub struct Told {
    pub estimator: &'static str,
    /// Nominal cutoff of the estimator, in Hz.
    pub cutoff_hz: f64,
    pub samples: usize,
    /// Number of the first sample that was used.
    pub first_sample: u64,
    /// First sample from which on both velocities are equal, bit for bit, up to the end.
    pub same_from_sample: Option<u64>,
    /// RMS of the difference between the velocities of the estimator and of the board.
    pub difference_rms_m_per_s: f64,
    /// Delay of the estimator relative to the board's velocity; `None` if nothing moved.
    pub later_s: Option<f64>,
    /// RMS of how much the board's velocity changes from sample to sample.
    pub board_change_rms_m_per_s: f64,
    /// RMS of how much the estimator's velocity changes from sample to sample.
    pub change_rms_m_per_s: f64,
}

impl Told {
    /// Makes the report in the units of a scene.
    ///
    /// # Errors
    /// `stop` was set.
    pub fn new(
        scene: &Scene,
        velocity: VelocitySettings,
        cutoff_hz: f64,
        replayed: &Replayed,
        stop: &AtomicBool,
    ) -> Result<Self, Error> {
        let lsb = lsb_m_per_s(scene);
        let [board, here] = replayed.roughness().map(|lsbs| lsbs * lsb);
        let later = replayed.later(stop);
        interrupt::unless(stop)?;
        Ok(Self {
            estimator: velocity.name().text(),
            cutoff_hz,
            samples: replayed.len(),
            first_sample: replayed.first,
            same_from_sample: replayed.same_from(),
            difference_rms_m_per_s: replayed.difference() * lsb,
            later_s: later.map(|samples| samples / scene.control.rate_hz + 0.0), // avoids a minus before a zero
            board_change_rms_m_per_s: board,
            change_rms_m_per_s: here,
        })
    }
}
