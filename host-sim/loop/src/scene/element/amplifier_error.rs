//! Amplifier whose force is not proportional to its command: an odd error of third order.
//!
//! ```text
//! F = command (1 + cubic (command / full)^2),   full: the force at full command
//! ```
//! The error acts before the pole of [`super::Amplifier`]. A negative `cubic` is a motor or amplifier that saturates.
//!
//! The model is the first odd term of a power series: the static non-linearity of a Hammerstein model (Ljung, *System
//! Identification*, 2nd ed., 1999, 5.1).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;

/// Error of the force, by command.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AmplifierError {
    /// Relative error of the force at full command. The relative error grows with the square of the command.
    pub cubic: f64,
}

impl AmplifierError {
    #[inline]
    pub fn force_n(&self, command_n: f64, full_scale_n: f64) -> f64 {
        let part = command_n / full_scale_n;
        command_n * (1.0 + self.cubic * part * part)
    }

    pub fn check(&self) -> Result<(), String> {
        // below -1/3 a larger command would give a smaller force
        Checker("amplifier_error").within("cubic", self.cubic, -0.3..=1.0)
    }
}
