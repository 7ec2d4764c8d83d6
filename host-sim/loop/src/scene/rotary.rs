//! `[rotary]`: a rotary device. The table replaces `[device]`, `encoder.resolution_m` and `actuator.gain_n_per_v`.
//!
//! Let r be the radius at which the hand holds the handle, and N the motor turns per turn of the handle. At the handle
//! the values are:
//! ```text
//! m = (J_handle + N^2 J_motor) / r^2
//! b = (c + N^2 k_t^2 / R) / r^2
//! k = kappa / r^2,   x = r angle
//! count = 2 pi r / CPR   encoder on the handle
//! count = 2 pi r / (N CPR)   encoder on the motor
//! force per volt = N k_t k_amp / r   current amplifier
//! force per volt = N k_t / (R r)   voltage amplifier
//! ```
//! With a voltage amplifier the back-EMF, k_t N omega, reduces the force at speed. This loss of force acts as damping:
//! the term with k_t^2 / R in b. With a current amplifier the term is absent.
//!
//! Inductance is left out: L / R is about 0.1 ms in motors of this size. `[amplifier]` can model the inductance.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::Units;
use crate::range::within;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rotary {
    /// Distance from the axis to the point where the hand holds the handle.
    pub handle_radius_m: f64,
    /// Turns of the motor per turn of the handle.
    pub ratio: f64,
    /// Counts per turn of the encoder's axis, after quadrature.
    pub counts_per_turn: f64,
    /// Axis that carries the encoder.
    pub encoder_on: EncoderOn,
    /// Inertia of the handle about its axis.
    pub handle_inertia_kg_m2: f64,
    /// Inertia of the motor about its own axis.
    pub motor_inertia_kg_m2: f64,
    /// Damping of bearings and transmission, at the handle.
    pub damping_n_m_s_per_rad: f64,
    /// Spring at the handle.
    pub stiffness_n_m_per_rad: f64,
    /// Rest angle of the spring.
    pub rest_angle_rad: f64,
    /// Angle of the handle at rest before a hit.
    pub start_angle_rad: f64,
    /// Torque constant of the motor. The same number in V s/rad is the back-EMF constant.
    pub torque_constant_n_m_per_a: f64,
    /// Quantity that the command sets.
    pub drive: DriveKind,
    /// With `drive = "current"`: current per volt of command.
    #[schemars(extend("x-needed" = true))]
    pub amplifier_a_per_v: Option<f64>,
    /// With `drive = "voltage"`: resistance of winding and amplifier.
    #[schemars(extend("x-needed" = true))]
    pub resistance_ohm: Option<f64>,
    /// With `drive = "voltage"`: the largest voltage, in place of `actuator.limit_v`.
    #[schemars(extend("x-needed" = true))]
    pub supply_v: Option<f64>,
}

/// Axis of an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum EncoderOn {
    /// On the handle's axis.
    Handle,
    /// On the motor's axis.
    Motor,
}

/// Quantity that a command sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum DriveKind {
    /// A command sets the current.
    Current,
    /// A command sets the motor's voltage; the back-EMF is damping.
    Voltage,
}

/// Tables of a hand, a sensor at the handle or an estimator. Their values are in m and N in every scene.
pub(super) const LINEAR_TABLES: [&str; 6] =
    ["arm", "arms", "accelerometer", "passivity", "velocity", "designs"];

impl Rotary {
    pub fn units(&self) -> Units {
        Units::Rotary { radius_m: self.handle_radius_m }
    }

    fn check(&self) -> Result<(), String> {
        let of = |key: &str, value: f64, low: f64, high: f64| {
            within(&format!("rotary.{key}"), value, low..=high)
        };
        of("handle_radius_m", self.handle_radius_m, 1e-3, 10.0)?;
        of("ratio", self.ratio, 1e-3, 1e4)?;
        of("counts_per_turn", self.counts_per_turn, 1.0, 1e9)?;
        of("handle_inertia_kg_m2", self.handle_inertia_kg_m2, 0.0, 1e4)?;
        of("motor_inertia_kg_m2", self.motor_inertia_kg_m2, 0.0, 1e4)?;
        of("damping_n_m_s_per_rad", self.damping_n_m_s_per_rad, 0.0, 1e6)?;
        of("stiffness_n_m_per_rad", self.stiffness_n_m_per_rad, 0.0, 1e9)?;
        of("rest_angle_rad", self.rest_angle_rad, -1e4, 1e4)?;
        of("start_angle_rad", self.start_angle_rad, -1e4, 1e4)?;
        of("torque_constant_n_m_per_a", self.torque_constant_n_m_per_a, 1e-6, 1e3)?;
        let Self { amplifier_a_per_v, resistance_ohm, supply_v, .. } = *self;
        match (self.drive, amplifier_a_per_v, resistance_ohm, supply_v) {
            (DriveKind::Current, Some(gain), None, None) => of("amplifier_a_per_v", gain, 1e-6, 1e4),
            (DriveKind::Voltage, None, Some(resistance), Some(supply)) => {
                of("resistance_ohm", resistance, 1e-3, 1e5)?;
                of("supply_v", supply, 1e-3, 1e3)
            }
            (DriveKind::Current, ..) => {
                Err("rotary.drive is `current`, which takes amplifier_a_per_v and neither resistance_ohm nor supply_v"
                    .into())
            }
            (DriveKind::Voltage, ..) => {
                Err("rotary.drive is `voltage`, which takes resistance_ohm and supply_v and no amplifier_a_per_v".into())
            }
        }
    }

    /// Force per volt of command in N, and damping that the back-EMF causes in N m s/rad, both at the handle.
    fn drive(&self) -> [f64; 2] {
        let torque = self.ratio * self.torque_constant_n_m_per_a;
        match self.drive {
            DriveKind::Current => [torque * self.amplifier_a_per_v.unwrap_or_default(), 0.0],
            DriveKind::Voltage => {
                let resistance = self.resistance_ohm.unwrap_or(1.0);
                [torque / resistance, torque * torque / resistance]
            }
        }
    }

    /// The tables of a linear scene that replace `[rotary]`, with values at the handle.
    fn tables(&self) -> [(&'static str, Vec<(&'static str, f64)>); 3] {
        let units = self.units();
        let at =
            |key: &str, value: f64| units.to_handle(key, value).map_or(value, |(_, value)| value);
        let [torque_per_volt, back_emf] = self.drive();
        let inertia =
            self.handle_inertia_kg_m2 + self.ratio * self.ratio * self.motor_inertia_kg_m2;
        let turns = match self.encoder_on {
            EncoderOn::Handle => 1.0,
            EncoderOn::Motor => self.ratio,
        };
        let count = 2.0 * std::f64::consts::PI / (turns * self.counts_per_turn);
        let device = vec![
            ("mass_kg", at("inertia_kg_m2", inertia)),
            ("damping_n_s_per_m", at("n_m_s_per_rad", self.damping_n_m_s_per_rad + back_emf)),
            ("stiffness_n_per_m", at("n_m_per_rad", self.stiffness_n_m_per_rad)),
            ("rest_position_m", at("rad", self.rest_angle_rad)),
            ("start_position_m", at("rad", self.start_angle_rad)),
        ];
        let mut actuator = vec![("gain_n_per_v", at("n_m_per_v", torque_per_volt))];
        actuator.extend(self.supply_v.map(|supply| ("limit_v", supply)));
        [
            ("device", device),
            ("encoder", vec![("resolution_m", at("rad", count))]),
            ("actuator", actuator),
        ]
    }
}

/// The tables with values at the handle, and the scene's units.
///
/// # Errors
/// `[rotary]` is wrong, or the scene also has a key that `[rotary]` replaces.
pub fn at_handle(mut scene: Table) -> Result<(Table, Units), String> {
    let Some(rotary) = scene.remove("rotary") else { return Ok((scene, Units::Linear)) };
    let rotary: Rotary = rotary.try_into().map_err(|error: toml::de::Error| {
        format!("rotary: {}", error.message().replace('\n', " "))
    })?;
    rotary.check()?;
    if scene.contains_key("device") {
        return Err("device: with [rotary] there is no [device]".into());
    }
    let units = rotary.units();
    for (name, value) in &mut scene {
        if !LINEAR_TABLES.contains(&name.as_str()) {
            convert(units, name, value)?;
        }
    }
    for key in scene.get_mut("estimated").and_then(Value::as_array_mut).into_iter().flatten() {
        let is_same = |key: &str| {
            key.split('.')
                .next()
                .is_some_and(|table| table == "rotary" || LINEAR_TABLES.contains(&table))
        };
        if let Value::String(key) = key
            && !is_same(key)
            && let Some((at_handle, _)) = units.to_handle(key, 0.0)
        {
            *key = at_handle;
        }
    }
    for (name, keys) in rotary.tables() {
        let empty = || Value::Table(Table::new());
        let Some(table) = scene.entry(name).or_insert_with(empty).as_table_mut() else {
            return Err(format!("{name} is no table"));
        };
        for (key, value) in keys {
            if table.insert(key.into(), Value::Float(value)).is_some() {
                return Err(format!("{name}.{key}: with [rotary] it follows from that table"));
            }
        }
    }
    Ok((scene, units))
}

/// Converts the angles and torques of a table and of its inner tables.
fn convert(units: Units, path: &str, value: &mut Value) -> Result<(), String> {
    let Some(table) = value.as_table_mut() else { return Ok(()) };
    for (key, mut value) in std::mem::take(table) {
        let path = format!("{path}.{key}");
        if value.is_table() {
            convert(units, &path, &mut value)?;
            table.insert(key, value);
            continue;
        }
        let number = value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64));
        match number.and_then(|number| units.to_handle(&key, number)) {
            Some((renamed, number)) => {
                table.insert(renamed, Value::Float(number));
            }
            None => match Units::rotary_key(&key).filter(|_| number.is_some()) {
                Some(rotary) if !["gain_n_per_v", "resolution_m"].contains(&key.as_str()) => {
                    return Err(format!("{path}: with [rotary] it is {rotary}"));
                }
                _ => {
                    table.insert(key, value);
                }
            },
        }
    }
    Ok(())
}
