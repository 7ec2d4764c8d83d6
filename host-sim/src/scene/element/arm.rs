//! Human arm: a mass on its own spring and damper, holding the handle through the grip's.
//!
//! With positions x (handle: the device, or the mass of [`super::Mode`] if there is one) and a (arm):
//! ```text
//! m a'' = -k (a - rest) - b a' - k_grip (a - x) - b_grip (a' - x')       and the grip's opposite force on the handle
//! ```
//! The arm starts at rest where the handle starts, with the grip relaxed. Its own spring draws it to `rest_position_m`:
//! a posture, chosen by the person. The person does not react: impedance is constant over a hit. Part of the exact
//! step.
//!
//! A standard model of an arm: a passive impedance of second order, behind the compliance of the grip.

use serde::{Deserialize, Serialize};

use super::Checker;
use crate::scene::ranges;

/// A person's arm on the handle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// Moving mass of hand and arm, kg.
    pub mass_kg: f64,
    /// Damping of the arm against the ground, N s/m.
    pub damping_n_s_per_m: f64,
    /// Stiffness of the arm against the ground, N/m.
    pub stiffness_n_per_m: f64,
    /// Position to which the arm's own spring draws it, m.
    pub rest_position_m: f64,
    /// Damping of the grip, N s/m.
    pub grip_damping_n_s_per_m: f64,
    /// Stiffness of the grip, N/m.
    pub grip_stiffness_n_per_m: f64,
}

impl Arm {
    /// # Errors
    /// Key, value, allowed range.
    pub fn check(&self) -> Result<(), String> {
        let keys = Checker("arm");
        keys.within("mass_kg", self.mass_kg, ranges::MASS_KG)?;
        keys.within("damping_n_s_per_m", self.damping_n_s_per_m, ranges::DAMPING_N_S_PER_M)?;
        keys.within("stiffness_n_per_m", self.stiffness_n_per_m, ranges::STIFFNESS_N_PER_M)?;
        keys.within("rest_position_m", self.rest_position_m, ranges::POSITION_M)?;
        let (stiffness, damping) = (self.grip_stiffness_n_per_m, self.grip_damping_n_s_per_m);
        keys.within("grip_damping_n_s_per_m", damping, ranges::DAMPING_N_S_PER_M)?;
        keys.within("grip_stiffness_n_per_m", stiffness, ranges::STIFFNESS_N_PER_M)
    }
}
