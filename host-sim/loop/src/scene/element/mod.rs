//! The optional elements of a scene. Each file describes one element: its table in the scene file, its equation, its
//! source and its tests. An element that is absent is not modelled and needs no time.
//!
//! | element | table | advanced |
//! |---------|-------|----------|
//! | [`Amplifier`] | `[amplifier]` | exactly |
//! | [`AmplifierError`] | `[amplifier_error]` | exactly |
//! | [`Mode`] | `[mode]` | exactly |
//! | [`Arm`] | `[arm]` | exactly |
//! | [`Offset`] | `[offset]` | exactly |
//! | [`Friction`] | `[friction]` | by the scene's `[integrator]` |
//! | [`Backlash`] | `[backlash]` | by the scene's `[integrator]` |
//! | [`Cogging`] | `[cogging]` | by the scene's `[integrator]` |
//! | [`Travel`] | `[travel]` | by the scene's `[integrator]` |
//! | [`EncoderError`] | `[encoder_error]` | not part of the motion |
//! | [`EncoderNoise`] | `[encoder_noise]` | not part of the motion |
//! | [`Jitter`] | `[jitter]` | exactly, or by the scene's `[integrator]` |
//!
//! Linear elements join the device in a [`Chain`], whose step over a sample is exact ([`crate::plant::ExactStep`]).
//! With a non-linear element the whole plant is integrated ([`crate::plant::IntegratedStep`]).

use std::ops::RangeInclusive;

mod amplifier;
mod amplifier_error;
mod arm;
mod backlash;
mod chain;
mod cogging;
mod encoder_error;
mod encoder_noise;
mod friction;
mod jitter;
mod mode;
mod offset;
mod travel;

pub use amplifier::Amplifier;
pub use amplifier_error::AmplifierError;
pub use arm::Arm;
pub use backlash::Backlash;
pub(crate) use chain::of_states;
pub use chain::{Chain, NOTHING, STATES_MAX};
pub use cogging::Cogging;
pub use encoder_error::EncoderError;
pub use encoder_noise::EncoderNoise;
pub use friction::Friction;
pub use jitter::{Glimpse, Jitter};
pub use mode::Mode;
pub use offset::Offset;
pub use travel::{End, REST_SPEED_M_PER_S, Travel};

use crate::range::within;

/// The elements of a plant that are not linear.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Nonlinear {
    pub friction: Option<Friction>,
    pub cogging: Option<Cogging>,
    pub travel: Option<Travel>,
    /// A gap of 0 is stored as `None`.
    pub backlash: Option<Backlash>,
}

impl Nonlinear {
    /// Stiffness and damping that these elements add to the device at their steepest slope, in N/m and N s/m.
    pub fn steepest(&self) -> (f64, f64) {
        let mut sum = (0.0, 0.0);
        if let Some(friction) = self.friction {
            sum.1 += friction.steepest_n_s_per_m();
        }
        if let Some(cogging) = self.cogging {
            sum.0 += cogging.stiffness_n_per_m();
        }
        if let Some(Travel::Spring { stiffness_n_per_m, damping_n_s_per_m, .. }) = self.travel {
            sum = (sum.0 + stiffness_n_per_m, sum.1 + damping_n_s_per_m);
        }
        sum
    }
}

/// Checks the values of one table of the scene. An error is one line with key, value and allowed range.
#[derive(Clone, Copy, Debug)]
struct Checker(&'static str);

impl Checker {
    fn within(self, key: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), String> {
        within(&format!("{}.{key}", self.0), value, range)
    }
}
