//! Coulomb and Stribeck friction between the device and the ground, with true sticking.
//!
//! ```text
//! sliding:  F = -sign(v) (coulomb + (static - coulomb) exp(-(v / stribeck_speed)^2))
//! sticking: v = 0 exactly, for as long as the other forces stay within +-static
//! ```
//! Viscous friction is the device's damping. The instants at which the device comes to rest or breaks away are located.
//! So the speed at rest is exactly 0; there is no band of speeds around 0.
//!
//! The curve is the standard Stribeck curve in its Gaussian form. Sticking is a separate state, as in Karnopp's
//! model, but without Karnopp's band of speeds.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;

/// Largest friction force that a scene may have, in N.
const FORCE_N: f64 = 1e5;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Friction {
    /// Friction of fast sliding.
    pub coulomb_n: f64,
    /// Largest friction at rest; at least `coulomb_n`.
    pub static_n: f64,
    /// Speed at which friction has fallen by 63 % of the way from static to Coulomb friction.
    pub stribeck_speed_m_per_s: f64,
}

impl Friction {
    /// Magnitude of the friction force while the device slides at this speed, in N.
    #[inline]
    pub fn sliding_n(&self, speed_m_per_s: f64) -> f64 {
        let beyond = self.static_n - self.coulomb_n;
        if beyond == 0.0 {
            return self.coulomb_n;
        }
        let ratio = speed_m_per_s / self.stribeck_speed_m_per_s;
        self.coulomb_n + beyond * libm::exp(-ratio * ratio)
    }

    /// The largest decrease of friction with speed, in N s/m. The slope is largest at 1/sqrt(2) of the Stribeck speed.
    pub fn steepest_n_s_per_m(&self) -> f64 {
        let steepest = core::f64::consts::SQRT_2 * libm::exp(-0.5);
        (self.static_n - self.coulomb_n) / self.stribeck_speed_m_per_s * steepest
    }

    pub fn check(&self) -> Result<(), String> {
        let keys = Checker("friction");
        keys.within("coulomb_n", self.coulomb_n, 0.0..=FORCE_N)?;
        keys.within("static_n", self.static_n, self.coulomb_n..=FORCE_N)?;
        keys.within("stribeck_speed_m_per_s", self.stribeck_speed_m_per_s, 1e-6..=10.0)
    }
}
