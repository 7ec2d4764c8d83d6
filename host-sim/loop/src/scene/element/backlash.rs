//! Backlash: a gap in the transmission between the device and the second mass ([`super::Mode`]).
//!
//! Let x be the position of the device and y the position of the second mass. The transmission has the spring k and the
//! damper b. The tooth of the transmission is at the position p in the gap:
//! ```text
//! F = k s + b s',   s = y - x - p,   -gap/2 <= p <= gap/2      on the device, and the opposite force on the mass
//! a flank is touched (p = -gap/2 or gap/2) while F presses on it; between the flanks F = 0, so s' = -(k/b) s
//! ```
//! The transmission never pulls over the gap. With a gap of 0, only the mode is left. A hit starts in the middle of the
//! gap.
//!
//! The model is from Nordin, Galic, Gutman, Int. J. Adaptive Control and Signal Processing 11(1), 1997; survey: Nordin,
//! Gutman, Automatica 38(10), 2002.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;

/// A gap between the device and the second mass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backlash {
    /// Free travel between the two flanks, at the handle. A touched flank has the spring and damper of `[mode]`.
    pub gap_m: f64,
}

impl Backlash {
    pub fn check(&self) -> Result<(), String> {
        Checker("backlash").within("gap_m", self.gap_m, 0.0..=1.0)
    }
}
