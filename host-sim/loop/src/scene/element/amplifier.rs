//! Amplifier pole: the current loop follows its command as a first-order low-pass.
//!
//! ```text
//! F' = 2 pi f (command - F),   F(0) = 0
//! ```
//! The amplifier is part of the exact step at any bandwidth.
//!
//! The model is standard: a current loop with a PI controller that cancels the winding's pole has one pole, at its
//! bandwidth. A source on its role in haptic stability: Diolaiti, Niemeyer, Barbagli, Salisbury, IEEE T-RO 22(2), 2006.

use core::f64::consts::TAU;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;

/// A current loop of first order.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Amplifier {
    /// -3 dB frequency of the current loop.
    pub bandwidth_hz: f64,
}

impl Amplifier {
    pub fn pole_per_s(&self) -> f64 {
        TAU * self.bandwidth_hz
    }

    pub fn check(&self) -> Result<(), String> {
        Checker("amplifier").within("bandwidth_hz", self.bandwidth_hz, 1.0..=1e7)
    }
}
