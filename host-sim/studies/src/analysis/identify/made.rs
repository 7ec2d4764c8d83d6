//! The scene that an identification makes from its base scene.

use std::f64::consts::TAU;

use serde::{Serialize, Serializer};
use toml::Table;

use super::{Drive, Found, Identification, Options, rotary};
use crate::{
    error::Error,
    numerics::integrator::Integrator,
    scene::{
        NamedScene, Scene,
        element::{Amplifier, Cogging, EncoderError, Friction, Offset},
    },
};

/// The base scene with the identified device.
#[derive(Clone, Debug)]
pub struct Made {
    /// The scene. Its values are in linear units at the handle.
    pub scene: Scene,
    pub notes: Vec<String>,
    /// The tables of the scene file if the scene is rotary.
    rotary: Option<Table>,
}

impl Made {
    /// Makes the scene from a base scene.
    ///
    /// # Errors
    /// [`Error::Internal`] only.
    pub fn new(
        base: &NamedScene,
        found: &Identification,
        options: &Options,
    ) -> Result<Self, Error> {
        let scene = scene(&base.scene, found, options);
        if !base.scene.units.is_rotary() {
            return Ok(Self { scene, notes: vec![], rotary: None });
        }
        let (tables, notes) = rotary::tables(base, &scene)?;
        Ok(Self { scene, notes, rotary: Some(tables) })
    }

    /// Checks the scene. Returns it with the text of its file.
    /// # Errors
    /// A value of the scene is not allowed. The error names `base_name` and the identified device.
    pub fn named(&self, base_name: &str) -> Result<NamedScene, Error> {
        self.scene.check().map_err(|error| {
            Error::Input(format!("{base_name}: with the identified device {error}"))
        })?;
        let tables = toml::to_string(self)
            .map_err(|error| Error::Internal(format!("cannot write the scene: {error}")))?;
        NamedScene::parse("identified".into(), tables, base_name)
    }
}

impl Serialize for Made {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.rotary {
            Some(tables) => tables.serialize(serializer),
            None => self.scene.serialize(serializer),
        }
    }
}

/// The base scene with the identified values, in linear units at the handle.
fn scene(base: &Scene, found: &Identification, options: &Options) -> Scene {
    let mut scene = base.clone();
    scene.device.mass_kg = found.mass_kg.value;
    scene.device.damping_n_s_per_m = found.damping_n_s_per_m.value.max(0.0);
    scene.device.stiffness_n_per_m = 0.0;
    if let Some(spring) = &found.spring {
        scene.device.stiffness_n_per_m = spring.stiffness_n_per_m.value;
        scene.device.rest_position_m = spring.rest_position_m.value;
    }
    if found.drive == Drive::Voltage {
        scene.actuator.gain_n_per_v = found.gain_n_per_v.value;
    }
    // Only a fitted latency is put into the scene. A given latency belongs to the log: for example, it is 0 if the
    // voltage was measured at the motor. The latency of the control loop may be longer. With a latency that is too
    // short, the scene would allow walls that the device cannot render.
    if options.fit_latency {
        scene.actuator.latency = found.latency_s.value * scene.control.rate_hz;
    }
    if options.resolution_m > 0.0 {
        scene.encoder.resolution_m = options.resolution_m;
    }
    let was = base.uncertainty.as_ref();
    scene.uncertainty = Some(found.joint.uncertainty(was, &scene, found.drive));
    with_terms(scene, &found.terms)
}

/// Adds the terms as elements of the scene. If an element needs an integrator, the scene gets an integrator with as few
/// steps as possible.
fn with_terms(mut scene: Scene, terms: &Found) -> Scene {
    if let Some(friction) = terms.friction_n {
        let coulomb_n = friction.value;
        let curve = terms.stribeck.map(|one| [one.static_n.value, one.speed_m_per_s.value]);
        let [static_n, stribeck_speed_m_per_s] = curve.unwrap_or([coulomb_n, 1e-3]);
        scene.friction = Some(Friction { coulomb_n, static_n, stribeck_speed_m_per_s });
    }
    if let Some(cogging) = &terms.cogging {
        scene.cogging = Some(Cogging {
            amplitude_n: cogging.amplitude_n.value,
            pitch_m: cogging.pitch_m.value,
            phase_rad: cogging.phase_rad.value,
        });
    }
    if (terms.friction_n.is_some() || terms.cogging.is_some()) && scene.integrator.is_none() {
        let steps = (0..=12).map(|n| Integrator::Rk4 { steps_per_sample: 1 << n });
        let mut scenes = steps.map(|steps| Scene { integrator: Some(steps), ..scene.clone() });
        let found = scenes.find(|scene| scene.check().is_ok());
        scene.integrator = found
            .and_then(|scene| scene.integrator)
            .or(Some(Integrator::Rk4 { steps_per_sample: 1 }));
    }
    if let Some(lag) = terms.lag_s {
        scene.amplifier = Some(Amplifier { bandwidth_hz: 1.0 / (TAU * lag.value) });
    }
    if let Some(offset) = terms.offset_n {
        scene.offset = Some(Offset { force_n: offset.value });
    }
    if let Some(phase) = &terms.phase {
        scene.encoder_error = Some(EncoderError {
            cycle_m: phase.cycle_m.value,
            first_m: phase.first_m.value,
            second_m: phase.second_m.value.max(0.0),
            phase_rad: phase.phase_rad.value,
        });
    }
    scene
}
