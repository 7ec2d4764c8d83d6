//! An accelerometer, for the estimator that fuses it with the position.

use std::ops::RangeInclusive;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use zwidth::units::Acceleration;

use super::Scene;
use crate::range::within;

/// Corner of the accelerometer's low-pass in Hz.
const BANDWIDTH_HZ: RangeInclusive<f64> = 1e-3..=1e6;

/// An accelerometer on the body that carries motor and encoder. It stays on this body if `[mode]` adds a second mass. A
/// reading is the mean acceleration of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Accelerometer {
    /// Largest magnitude of a reading.
    pub full_scale_m_per_s2: f64,
    /// Smallest step between two readings. 0: no quantisation.
    #[serde(default)]
    pub resolution_m_per_s2: f64,
    /// Density of the reading's noise.
    #[serde(default)]
    pub noise_m_per_s2_per_sqrt_hz: f64,
    /// Reading at rest.
    #[serde(default)]
    pub bias_m_per_s2: f64,
    /// Corner of a first-order low-pass. Absent: no low-pass.
    pub bandwidth_hz: Option<f64>,
}

impl Scene {
    pub(super) fn check_accelerometer(&self) -> Result<(), String> {
        let Some(sensor) = &self.accelerometer else { return Ok(()) };
        let rate_hz = self.control.rate_hz;
        let largest =
            f64::from(Acceleration::LIMIT) * self.encoder.resolution_m * rate_hz * rate_hz;
        let full_scale = sensor.full_scale_m_per_s2;
        within("accelerometer.full_scale_m_per_s2", full_scale, 1e-3..=largest)?;
        for (key, value) in [
            ("accelerometer.resolution_m_per_s2", sensor.resolution_m_per_s2),
            ("accelerometer.noise_m_per_s2_per_sqrt_hz", sensor.noise_m_per_s2_per_sqrt_hz),
        ] {
            within(key, value, 0.0..=full_scale)?;
        }
        let bias = sensor.bias_m_per_s2;
        within("accelerometer.bias_m_per_s2", bias, -full_scale..=full_scale)?;
        match sensor.bandwidth_hz {
            Some(hz) => within("accelerometer.bandwidth_hz", hz, BANDWIDTH_HZ),
            None => Ok(()),
        }
    }
}
