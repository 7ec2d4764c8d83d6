//! Designs the observers. All poles are at one bandwidth. The known part of the acceleration comes from the force or
//! from an accelerometer.
//!
//! **Observer**: `u = F / m`, where F is the commanded force, saturated and held. If the mass is wrong, a part of F
//! acts as a disturbance. The observer follows a disturbance no faster than the bandwidth.
//!
//! **Fusion** of position and acceleration: u is the accelerometer's reading. Its zero offset is a constant
//! disturbance, without effect on the velocity. Above the crossover the acceleration has more weight than the position.

use super::{
    factor::Factor,
    observer::{Observer, POSITION_BITS},
};
use crate::{
    Design, Gain,
    range::{SettingsError, within},
    units::Velocity,
};

/// Lowest accepted bandwidth or crossover, as a fraction of the sample rate. At 10 kHz it is 10 Hz.
pub const OBSERVER_MIN: f64 = 1e-3;
/// Highest accepted bandwidth or crossover, as a fraction of the sample rate.
pub const OBSERVER_MAX: f64 = 0.2;
/// Accepted masses of the observer's model, in kg.
pub const MASS_KG: core::ops::RangeInclusive<f64> = 1e-3..=100.0;

/// Gains of an observer in floating point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverDesign {
    /// Gains l1, l2 and l3.
    pub gains: [f64; 3],
    /// Acceleration that the force at full scale causes, in counts per sample^2. It is 0 for fusion.
    pub per_full_scale: f64,
}

impl ObserverDesign {
    /// Designs an observer of a mass that the commanded force moves.
    ///
    /// # Errors
    /// `bandwidth_hz` is outside [`OBSERVER_MIN`] .. [`OBSERVER_MAX`] of the rate, or `mass_kg` is outside [`MASS_KG`].
    /// The mass is also refused if full scale then gives less than 2^-34 or more than 32767 counts per sample^2.
    pub fn of_mass(
        bandwidth_hz: f64,
        mass_kg: f64,
        design: &Design,
    ) -> Result<Self, SettingsError> {
        let gains = gains("bandwidth_hz", bandwidth_hz, design.rate_hz)?;
        let full_scale =
            design.full_scale_n / design.resolution_m / design.rate_hz / design.rate_hz;
        let lightest = full_scale / f64::from(Velocity::LIMIT);
        let heaviest = libm::scalbn(full_scale, 34);
        within("mass_kg", mass_kg, lightest.max(*MASS_KG.start())..=heaviest.min(*MASS_KG.end()))?;
        Ok(Self { gains, per_full_scale: full_scale / mass_kg })
    }

    /// Designs an observer that uses an accelerometer.
    ///
    /// # Errors
    /// `crossover_hz` is outside [`OBSERVER_MIN`] .. [`OBSERVER_MAX`] of the rate.
    pub fn of_accelerometer(crossover_hz: f64, rate_hz: f64) -> Result<Self, SettingsError> {
        Ok(Self { gains: gains("crossover_hz", crossover_hz, rate_hz)?, per_full_scale: 0.0 })
    }

    /// Converts the gains to mantissa and shift. The relative error is at most 2^-32.
    pub fn quantise(&self) -> Observer {
        let [position, velocity, disturbance] = self.gains.map(Factor::of);
        // The factor from LSB of the force to LSB of the acceleration. Full scale has 2^30 LSB, and 1 count per
        // sample^2 has 2^32 LSB.
        let per_force = libm::scalbn(self.per_full_scale, POSITION_BITS.cast_signed() - 30);
        Observer {
            position,
            velocity,
            disturbance,
            per_force: Gain::from_f64(per_force).unwrap_or_default(),
        }
    }
}

/// Returns l1, l2 and l3 for three poles at this frequency.
fn gains(
    parameter: &'static str,
    bandwidth_hz: f64,
    rate_hz: f64,
) -> Result<[f64; 3], SettingsError> {
    within(parameter, bandwidth_hz, OBSERVER_MIN * rate_hz..=OBSERVER_MAX * rate_hz)?;
    let less = -libm::expm1(-2.0 * core::f64::consts::PI * bandwidth_hz / rate_hz); // 1 - p
    let p = 1.0 - less;
    let square = less * less;
    Ok([less * (1.0 + p + p * p), 1.5 * square * (1.0 + p), square * less])
}
