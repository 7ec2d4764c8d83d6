//! The optional elements of a scene, one file each: the table as it stands in the scene file, its
//! equation, its source, its tests. What is absent is not modelled and costs nothing.
//!
//! | element | table | advanced |
//! |---------|-------|----------|
//! | [`Amplifier`] | `[amplifier]` | exactly |
//! | [`Mode`] | `[mode]` | exactly |
//! | [`Arm`] | `[arm]` | exactly |
//!
//! The linear ones join the device in a [`Chain`], whose step over a sample is exact
//! ([`crate::plant::AugmentedStep`]).

use std::ops::RangeInclusive;

mod amplifier;
mod arm;
mod chain;
mod mode;

pub use amplifier::Amplifier;
pub use arm::Arm;
pub use chain::{Chain, STATES_MAX};
pub use mode::Mode;

/// Refuses values of one table.
#[derive(Clone, Copy, Debug)]
struct Checker(&'static str);

impl Checker {
    fn within(self, key: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), String> {
        crate::scene::within(&format!("{}.{key}", self.0), value, range)
    }
}
