//! Second vibration mode: a mass coupled to the device by a spring and a damper.
//!
//! The device's mass carries motor and encoder. The second mass is behind the transmission, and the hand holds this
//! mass. Let x be the position of the device, and y the position of the second mass:
//! ```text
//! m y'' = -k (y - x) - b (y' - x')        and the opposite force on the device
//! ```
//! Motor and encoder stay on the same body. The mode is part of the exact step.
//!
//! The model is the standard two-mass model of motor, cable transmission and body. A source on vibration modes in
//! haptic stability: Diaz, Gil, IEEE T-RO 26(1), 2010.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;
use crate::scene::ranges;

/// A second mass behind a spring and a damper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mode {
    /// Mass behind the transmission.
    pub mass_kg: f64,
    /// Stiffness of the transmission.
    pub stiffness_n_per_m: f64,
    /// Damping of the transmission.
    pub damping_n_s_per_m: f64,
}

impl Mode {
    pub fn check(&self) -> Result<(), String> {
        let keys = Checker("mode");
        keys.within("mass_kg", self.mass_kg, ranges::MASS_KG)?;
        keys.within("stiffness_n_per_m", self.stiffness_n_per_m, ranges::STIFFNESS_N_PER_M)?;
        keys.within("damping_n_s_per_m", self.damping_n_s_per_m, ranges::DAMPING_N_S_PER_M)
    }
}
