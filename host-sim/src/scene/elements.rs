//! The optional elements of a scene: one table each. One that is absent is not modelled and costs
//! nothing.

use serde::{Deserialize, Serialize};

use super::Scene;

/// Quantisation of the command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Quantisation {
    /// A DAC with offset binary codes.
    Dac {
        /// Resolution.
        bits: u32,
    },
    /// Sign-magnitude PWM.
    Pwm {
        /// Timer ticks per PWM period.
        steps: u32,
    },
}

impl Scene {
    /// Tables of this scene that no linear analysis can take.
    pub fn nonlinear_elements(&self) -> Vec<&'static str> {
        [("output", self.output.is_some())]
            .into_iter()
            .filter_map(|(name, present)| present.then_some(name))
            .collect()
    }
}
