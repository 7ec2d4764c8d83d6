//! The optional elements of a scene: one table each. One that is absent is not modelled and costs
//! nothing.

use serde::{Deserialize, Serialize};

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
