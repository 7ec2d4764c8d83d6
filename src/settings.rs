//! The settings that a person makes, in SI units, and their conversion to integers.
//!
//! There are three types. [`Settings`] has floats, for people. [`LoopParameters`] has integers, and is immutable. Only
//! the state of the [`Sampler`](crate::Sampler) changes with each sample. Only [`Settings::build`] refuses settings. If
//! it refuses, the old [`LoopParameters`] stay in force.

use core::num::NonZeroU32;

use crate::{
    Design, Gain, LoopParameters, VelocitySettings,
    actuator::Actuator,
    range::{SettingsError, limits, within},
    units::{Force, Velocity},
    velocity::Tuned,
    wall::Wall,
};

/// Settings that a person tunes, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Velocity estimator and its parameters.
    pub velocity: VelocitySettings,
    /// Virtual wall in SI units.
    pub wall: WallSettings,
}

/// The wall in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallSettings {
    /// Position of the wall's surface, in m. It is rounded to the nearest count. The encoder's count 0 is at 0 m.
    pub position_m: f64,
    /// Stiffness K of the wall, in N/m.
    pub stiffness_n_per_m: f64,
    /// Damping B of the wall, in N s/m. It acts only inside the wall.
    pub damping_n_s_per_m: f64,
    /// Whether the wall can only push, so that it never pulls.
    pub push_only: bool,
}

impl Settings {
    /// Checks the settings, and converts them to integer gains and coefficients.
    ///
    /// Host and target use the same `f64` operations and `libm` functions, so both get the same bits.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    pub fn build(&self, design: &Design) -> Result<LoopParameters, SettingsError> {
        design.check()?;
        let wall = &self.wall;
        within("stiffness_n_per_m", wall.stiffness_n_per_m, limits::STIFFNESS_N_PER_M)?;
        within("damping_n_s_per_m", wall.damping_n_s_per_m, limits::DAMPING_N_S_PER_M)?;
        let force_lsb_per_n = f64::from(Force::FULL_SCALE.bits()) / design.full_scale_n;
        // One LSB of the velocity, in m/s.
        let velocity_lsb =
            design.resolution_m * design.rate_hz / f64::from(1u32 << Velocity::FRACTION_BITS);
        Ok(LoopParameters {
            estimator: Tuned::first(self.velocity.build(design)?),
            wall: Wall {
                surface: design.position("position_m", wall.position_m)?,
                stiffness: gain(
                    "stiffness_n_per_m",
                    wall.stiffness_n_per_m,
                    design.resolution_m * force_lsb_per_n,
                )?,
                damping: gain(
                    "damping_n_s_per_m",
                    wall.damping_n_s_per_m,
                    velocity_lsb * force_lsb_per_n,
                )?,
                push_only: wall.push_only,
            },
            actuator: Actuator::new(design.output)?,
            period: NonZeroU32::new(design.period).unwrap_or(NonZeroU32::MIN), // checked above
        })
    }
}

/// Returns `value * lsb` as a gain.
///
/// # Errors
/// The product does not fit. The error has the range that fits.
fn gain(parameter: &'static str, value: f64, lsb: f64) -> Result<Gain, SettingsError> {
    let smallest = libm::scalbn(1.0, -32) / lsb;
    let largest = libm::scalbn(1.0, 53) / lsb;
    Gain::from_f64(value * lsb).ok_or(SettingsError { parameter, value, range: smallest..=largest })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::tests::DESIGN;

    fn surface(position_m: f64) -> i32 {
        let wall = WallSettings {
            position_m,
            stiffness_n_per_m: 1000.0,
            damping_n_s_per_m: 1.0,
            push_only: true,
        };
        let velocity = VelocitySettings::Butterworth { cutoff_hz: 500.0 };
        Settings { velocity, wall }.build(&DESIGN).unwrap().wall.surface().counts()
    }

    #[test]
    fn the_surface_is_the_nearest_count() {
        for (position_m, counts) in
            [(0.0, 0), (2.4e-6, 2), (2.6e-6, 3), (-0.4e-6, 0), (-0.6e-6, -1), (0.07, 70_000)]
        {
            assert_eq!(surface(position_m), counts, "{position_m}");
        }
    }
}
