//! Makes the scene file of an identified rotary device. The scene keeps its rotary keys. Some of them get new values.

use toml::{Table, Value};

use crate::{
    error::Error,
    scene::{NamedScene, Scene, Units},
};

/// Tables of the scene file that an identification adds, or replaces as a whole.
const ELEMENTS: [&str; 7] =
    ["friction", "cogging", "integrator", "amplifier", "offset", "encoder_error", "uncertainty"];
/// Number of digits with which numbers are written. It is enough for every result.
const DIGITS: usize = 12;

/// The tables of the file of `base`. Device, gain, latency and elements are those of `scene`. `scene` has linear values
/// at the handle. The texts are notes for the reader.
///
/// # Errors
/// [`Error::Internal`] only, because `base` was read before.
pub(super) fn tables(base: &NamedScene, scene: &Scene) -> Result<(Table, Vec<String>), Error> {
    let internal = |error: String| Error::Internal(format!("cannot write the scene: {error}"));
    let units = base.scene.units;
    let mut tables = base.table()?;
    let mut notes = vec![];
    let Some(Value::Table(rotary)) = tables.get_mut("rotary") else {
        return Err(internal("it has no [rotary]".into()));
    };
    turn(rotary, units, &base.scene, scene, &mut notes);
    let mut known = vec!["rotary.handle_inertia_kg_m2", "rotary.damping_n_m_s_per_rad"];
    if scene.device.stiffness_n_per_m > 0.0 {
        known.extend(["rotary.stiffness_n_m_per_rad", "rotary.rest_angle_rad"]);
    }
    if scene.actuator.latency != base.scene.actuator.latency
        && let Some(Value::Table(actuator)) = tables.get_mut("actuator")
    {
        actuator.insert("latency".into(), number(scene.actuator.latency));
    }
    let at_handle =
        |scene: &Scene| Table::try_from(scene).map_err(|error| internal(error.to_string()));
    let (before, after) = (at_handle(&base.scene)?, at_handle(scene)?);
    let mut estimated = vec![];
    for name in ELEMENTS {
        if let Some(Value::Table(element)) = after.get(name)
            && before.get(name) != after.get(name)
        {
            tables.insert(name.into(), told(units, element));
            estimated.push(format!("{name}."));
        }
    }
    if let Some(Value::Array(keys)) = tables.get_mut("estimated") {
        keys.retain(|key| {
            let key = key.as_str().unwrap_or_default();
            !known.contains(&key) && !estimated.iter().any(|table| key.starts_with(table))
        });
        if keys.is_empty() {
            tables.remove("estimated");
        }
    }
    Ok((tables, notes))
}

/// Sets the keys of `[rotary]` that belong to mass, damping, spring, count and gain.
fn turn(rotary: &mut Table, units: Units, base: &Scene, scene: &Scene, notes: &mut Vec<String>) {
    let read = |rotary: &Table, key: &str| match rotary.get(key) {
        Some(Value::Float(value)) => *value,
        #[expect(clippy::cast_precision_loss, reason = "as serde reads a whole number")]
        Some(Value::Integer(value)) => *value as f64,
        _ => 0.0,
    };
    let about_axis = |key: &str, at_handle: f64| {
        units.key(key).map_or(at_handle, |(_, factor)| at_handle * factor)
    };
    let ratio = read(rotary, "ratio");
    let gain = scene.actuator.gain_n_per_v / base.actuator.gain_n_per_v;
    let mut torque_constant = read(rotary, "torque_constant_n_m_per_a");
    if (gain - 1.0).abs() > 1e-9 {
        torque_constant *= gain;
        rotary.insert("torque_constant_n_m_per_a".into(), number(torque_constant));
    }
    let resistance = read(rotary, "resistance_ohm");
    let back_emf =
        if resistance > 0.0 { (ratio * torque_constant).powi(2) / resistance } else { 0.0 };

    let inertia = about_axis("mass_kg", scene.device.mass_kg);
    let of_motor = ratio * ratio * read(rotary, "motor_inertia_kg_m2");
    let of_handle = inertia - of_motor;
    if of_handle < 0.0 {
        rotary.insert("motor_inertia_kg_m2".into(), number(0.0));
        notes.push(format!(
            "rotary.motor_inertia_kg_m2 alone makes {of_motor:.3e} kg m^2 at the handle, more than was found: all of it \
             is written as the handle's"
        ));
    }
    rotary.insert(
        "handle_inertia_kg_m2".into(),
        number(if of_handle < 0.0 { inertia } else { of_handle }),
    );
    let damping = about_axis("damping_n_s_per_m", scene.device.damping_n_s_per_m);
    if damping < back_emf {
        notes.push(format!(
            "the motor's back-EMF makes {back_emf:.3e} N m s/rad, more than was found: rotary.torque_constant_n_m_per_a \
             is too large, or resistance_ohm too small"
        ));
    }
    rotary.insert("damping_n_m_s_per_rad".into(), number((damping - back_emf).max(0.0)));
    let stiffness = about_axis("stiffness_n_per_m", scene.device.stiffness_n_per_m);
    rotary.insert("stiffness_n_m_per_rad".into(), number(stiffness));
    let rest = about_axis("rest_position_m", scene.device.rest_position_m);
    rotary.insert("rest_angle_rad".into(), number(rest));
    let finer = base.encoder.resolution_m / scene.encoder.resolution_m;
    if (finer - 1.0).abs() > 1e-9 {
        let counts = read(rotary, "counts_per_turn") * finer;
        rotary.insert("counts_per_turn".into(), number(counts));
    }
}

/// The table of an element, converted to rad and N m.
fn told(units: Units, element: &Table) -> Value {
    let told = element.iter().map(|(key, value)| match (units.key(key), value.as_float()) {
        (Some((renamed, factor)), Some(value)) => {
            (renamed, Value::Float(Units::told(value, factor)))
        }
        _ => (key.clone(), renamed(value)),
    });
    Value::Table(told.collect())
}

/// Renames keys inside lists, for example in correlations.
fn renamed(value: &Value) -> Value {
    match value {
        Value::Array(all) => Value::Array(all.iter().map(renamed).collect()),
        Value::String(key) => Value::String(Units::rotary_key(key).unwrap_or_else(|| key.clone())),
        other => other.clone(),
    }
}

fn number(value: f64) -> Value {
    Value::Float(format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value))
}
