//! Human arm: a mass with its own spring and damper. The spring and damper of the grip connect the arm to the handle.
//!
//! Let x be the position of the handle (the device, or the mass of [`super::Mode`] if there is one), and a the position
//! of the arm:
//! ```text
//! m a'' = -k (a - rest) - b a' - k_grip (a - x) - b_grip (a' - x')     and the opposite force of the grip on the
//! handle
//! ```
//! The arm starts at rest at the handle's start position, with the grip relaxed. The arm's own spring pulls the arm to
//! `rest_position_m`, the posture of the person. The person does not react, so the impedance is constant during a hit.
//! The arm is part of the exact step.
//!
//! The model is standard: a passive impedance of second order behind an elastic grip.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{range::within, scene::ranges};

/// A person's arm on the handle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// Moving mass of hand and arm.
    pub mass_kg: f64,
    /// Damping of the arm against the ground.
    pub damping_n_s_per_m: f64,
    /// Stiffness of the arm against the ground.
    pub stiffness_n_per_m: f64,
    /// Rest position of the arm's own spring.
    pub rest_position_m: f64,
    /// Damping of the grip.
    pub grip_damping_n_s_per_m: f64,
    /// Stiffness of the grip.
    pub grip_stiffness_n_per_m: f64,
}

impl Arm {
    pub fn check(&self, table: &str) -> Result<(), String> {
        let (damping, stiffness) = (ranges::DAMPING_N_S_PER_M, ranges::STIFFNESS_N_PER_M);
        for (key, value, range) in [
            ("mass_kg", self.mass_kg, ranges::MASS_KG),
            ("damping_n_s_per_m", self.damping_n_s_per_m, damping.clone()),
            ("stiffness_n_per_m", self.stiffness_n_per_m, stiffness.clone()),
            ("rest_position_m", self.rest_position_m, ranges::POSITION_M),
            ("grip_damping_n_s_per_m", self.grip_damping_n_s_per_m, damping),
            ("grip_stiffness_n_per_m", self.grip_stiffness_n_per_m, stiffness),
        ] {
            within(&format!("{table}.{key}"), value, range)?;
        }
        Ok(())
    }

    /// Arms that a scene without an arm can use: a heavy arm with a soft grip, and a light arm with a firm grip. The
    /// values have the size of published values, but we have not measured them. `Scene::named_arm` sets the rest
    /// position to the handle's start position.
    pub const BUILT_IN: &[(&str, Self)] =
        &[("heavy", Self::model(1.1, 900.0, 15.0)), ("light", Self::model(0.5, 3000.0, 25.0))];

    const fn model(mass_kg: f64, grip_stiffness_n_per_m: f64, grip_damping_n_s_per_m: f64) -> Self {
        let (damping_n_s_per_m, stiffness_n_per_m, rest_position_m) = (5.0, 20.0, 0.0);
        Self {
            mass_kg,
            damping_n_s_per_m,
            stiffness_n_per_m,
            rest_position_m,
            grip_damping_n_s_per_m,
            grip_stiffness_n_per_m,
        }
    }
}
