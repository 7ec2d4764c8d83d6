//! The wall's passivity controller as an element of a scene.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use zwidth::{
    SettingsError,
    passivity::{Passivity, PassivitySettings},
    units::Force,
};

use super::Scene;

/// Passivity controller: in a contact the wall gives no more energy than a reserve. See [`zwidth::passivity`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PassivityTable {
    /// Largest acceleration of the handle. Absent: twice full scale (motor and hand) divided by the handle's mass.
    pub acceleration_m_per_s2: Option<f64>,
}

impl Scene {
    /// Largest acceleration of the handle, from the table or by default, in m/s^2.
    pub fn acceleration(&self) -> f64 {
        let usual = || 2.0 * self.full_scale_n() / self.device.mass_kg;
        self.passivity.and_then(|table| table.acceleration_m_per_s2).unwrap_or_else(usual)
    }

    /// The controller in counts. `None` if the scene has no `[passivity]`.
    ///
    /// # Errors
    /// The acceleration or the latency is out of range.
    pub fn passivity(&self) -> Result<Option<Passivity>, SettingsError> {
        if self.passivity.is_none() {
            return Ok(None);
        }
        let acceleration_m_per_s2 = self.acceleration();
        let latency = self.actuator.latency_samples();
        PassivitySettings { acceleration_m_per_s2, latency }.build(&self.design()).map(Some)
    }

    /// Largest energy that the wall with the controller gives in a contact, in J. `None` if the scene has no
    /// `[passivity]`, or a value is out of range.
    pub fn reserve_j(&self) -> Option<f64> {
        let plan = self.passivity().ok()??;
        let reserve = plan.reserve() as f64;
        let per_bit = self.full_scale_n() / f64::from(Force::FULL_SCALE.bits());
        Some(reserve * per_bit * self.encoder.resolution_m)
    }

    pub(super) fn check_passivity(&self) -> Result<(), String> {
        self.passivity().map(|_| ()).map_err(|error| match error.parameter {
            "latency" => format!(
                "actuator.latency with [passivity] is {}, allowed 0 to actuator.period, {}",
                self.actuator.latency, self.actuator.period
            ),
            _ => format!("passivity.{error}"),
        })
    }
}
