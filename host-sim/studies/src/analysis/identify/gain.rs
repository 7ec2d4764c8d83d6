//! Where the force per volt comes from: a given value, motor and amplifier, a weight, or a record with an added mass.
//!
//! One record gives mass, damping and stiffness only relative to the gain, because the equation of motion can be
//! divided by the gain. So the gain needs another source, or a second record with a known added mass.

use crate::{range::refused, scene::ranges};

/// Standard gravity by definition, m/s^2.
const GRAVITY_M_PER_S2: f64 = 9.806_65;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Gain {
    /// The user gives the value in N/V.
    Given(f64),
    /// There is no gain, because the log has the force itself.
    Force,
    /// The gain follows from motor and amplifier (paper, section 2.2.2): `k_t k_amp / r_c`.
    Motor {
        torque_constant_n_m_per_a: f64,
        /// Amplifier gain k_amp, in A/V.
        amplifier_a_per_v: f64,
        /// Radius r_c of the capstan drum, in m.
        drum_radius_m: f64,
    },
    /// The gain follows from the voltage with which the motor holds a hanging weight.
    Weight {
        mass_kg: f64,
        /// Voltage with which the motor holds the weight still, in V. Its sign does not matter.
        voltage_v: f64,
    },
    /// The gain is fitted. For this the second record has an added mass.
    AddedMass {
        /// Mass that was added, in kg.
        mass_kg: f64,
    },
}

impl Gain {
    /// Force per volt in N/V; `None` if it must be fitted. For a log with the current it is the force per ampere in
    /// N/A. For a log with the force it is 1.
    ///
    /// # Errors
    /// The gain is out of range. The message has one line.
    pub fn known_n_per_v(&self) -> Result<Option<f64>, String> {
        let (value, what) = match *self {
            Self::Given(value) => (value, "--gain"),
            Self::Force => return Ok(Some(1.0)),
            Self::Motor { torque_constant_n_m_per_a, amplifier_a_per_v, drum_radius_m } => (
                torque_constant_n_m_per_a * amplifier_a_per_v / drum_radius_m,
                "the gain of --torque-constant, --amplifier-gain and --drum-radius",
            ),
            Self::Weight { mass_kg, voltage_v } => (
                mass_kg * GRAVITY_M_PER_S2 / voltage_v.abs(),
                "the gain of --calibration-mass and --calibration-voltage",
            ),
            Self::AddedMass { mass_kg } => {
                return if ranges::MASS_KG.contains(&mass_kg) {
                    Ok(None)
                } else {
                    Err(refused("--added-mass", mass_kg, &ranges::MASS_KG))
                };
            }
        };
        if ranges::GAIN_N_PER_V.contains(&value) {
            Ok(Some(value))
        } else {
            Err(refused(what, value, &ranges::GAIN_N_PER_V))
        }
    }

    /// Name of the source, for reports.
    pub fn source(&self) -> &'static str {
        match self {
            Self::Given(_) => "given",
            Self::Force => "force",
            Self::Motor { .. } => "motor",
            Self::Weight { .. } => "weight",
            Self::AddedMass { .. } => "added_mass",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_are_those_of_their_sources() {
        let motor = Gain::Motor {
            torque_constant_n_m_per_a: 0.0196,
            amplifier_a_per_v: 0.3,
            drum_radius_m: 0.01,
        };
        assert!((motor.known_n_per_v().unwrap().unwrap() - 0.588).abs() < 1e-12);
        let weight = Gain::Weight { mass_kg: 0.2, voltage_v: -3.0 };
        assert!((weight.known_n_per_v().unwrap().unwrap() - 0.653_776_666).abs() < 1e-8);
        assert_eq!(Gain::AddedMass { mass_kg: 0.1 }.known_n_per_v(), Ok(None));
    }

    #[test]
    fn impossible_gains_are_refused_by_name() {
        for (gain, wanted) in [
            (Gain::Given(-0.5), "--gain is -0.5"),
            (Gain::Given(f64::NAN), "--gain is NaN"),
            (Gain::Weight { mass_kg: 0.2, voltage_v: 0.0 }, "--calibration-voltage is inf"),
            (Gain::AddedMass { mass_kg: -0.1 }, "--added-mass is -0.1"),
        ] {
            let error = gain.known_n_per_v().unwrap_err();
            assert!(error.contains(wanted), "{error}");
        }
    }
}
