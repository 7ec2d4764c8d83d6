//! Cogging: a force that is periodic in the motor's position.
//!
//! ```text
//! F = amplitude sin(2 pi x / pitch + phase)
//! ```
//! The force is conservative, with the energy `amplitude pitch / (2 pi) cos(2 pi x / pitch + phase)`.
//!
//! The force is the first term of a Fourier series over the motor's angle. At the handle, pitch = 2 pi r / (N cogs),
//! with r and N as in docs/scenes.md.

use core::f64::consts::TAU;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;

/// First harmonic of a motor's cogging.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cogging {
    /// Amplitude of `amplitude sin(2 pi x / pitch + phase)`.
    pub amplitude_n: f64,
    /// Travel of the handle from one cog to the next.
    pub pitch_m: f64,
    /// Phase at position 0.
    pub phase_rad: f64,
}

impl Cogging {
    #[inline]
    pub fn force_n(&self, position_m: f64) -> f64 {
        self.amplitude_n * libm::sin(TAU * position_m / self.pitch_m + self.phase_rad)
    }

    pub fn energy_j(&self, position_m: f64) -> f64 {
        let cos = libm::cos(TAU * position_m / self.pitch_m + self.phase_rad);
        self.amplitude_n * self.pitch_m / TAU * cos
    }

    /// Steepest slope of the force, in N/m.
    pub fn stiffness_n_per_m(&self) -> f64 {
        self.amplitude_n * TAU / self.pitch_m
    }

    pub fn check(&self) -> Result<(), String> {
        let keys = Checker("cogging");
        keys.within("amplitude_n", self.amplitude_n, 0.0..=1e5)?;
        keys.within("pitch_m", self.pitch_m, 1e-6..=10.0)?;
        keys.within("phase_rad", self.phase_rad, -TAU..=TAU)
    }
}
