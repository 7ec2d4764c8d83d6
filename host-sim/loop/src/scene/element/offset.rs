//! A constant force on the device. Causes: gravity on a handle that is not balanced, or an amplifier with an offset.
//!
//! ```text
//! F = force
//! ```
//! If the device has a spring, the force moves the rest position by `force / stiffness`. The force is part of the exact
//! step.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Offset {
    /// Constant force on the device: gravity, or the offset of an amplifier.
    pub force_n: f64,
}

impl Offset {
    pub fn check(&self) -> Result<(), String> {
        Checker("offset").within("force_n", self.force_n, -1e5..=1e5)
    }
}
