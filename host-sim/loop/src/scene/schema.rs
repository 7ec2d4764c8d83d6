//! The JSON schema of scene files, for editors and for the book.
//!
//! Keys and descriptions come from the Rust types. Ranges come from the error messages that the scene reader gives for
//! too large values. A range that depends on another key stands only in the key's description.

use std::sync::LazyLock;

use schemars::{JsonSchema, generate::SchemaSettings};
use serde::Deserialize;
use serde_json::{Value, json};
use toml::Table;

use crate::notation::rounded;

use super::{
    BUILT_IN, Scene, Units,
    rotary::{LINEAR_TABLES, Rotary, at_handle},
};

/// Stands for the name of an arm or a design.
const NAME: &str = "NAME";
/// Names of the two ends of a range in a schema.
const LOW_HIGH: [&str; 2] = ["minimum", "maximum"];

/// Optional tables that have several forms. Each form stands here once. The ranges of their keys are read from error
/// messages.
const ELEMENTS: [&str; 3] = [
    "[output]\nkind = 'dac'\nbits = 12\n[travel]\nstop = 'spring'\nlow_m = -1\nhigh_m = 1\nstiffness_n_per_m = 1e3\n\
     damping_n_s_per_m = 1\n[integrator]\nmethod = 'dormand-prince'\nrelative_tolerance = 1e-6\n\
     absolute_tolerance_m = 1e-10",
    "[output]\nkind = 'pwm'\nsteps = 100\n[travel]\nstop = 'rigid'\nlow_m = -1\nhigh_m = 1\nrestitution = 0.5\n\
     [integrator]\nmethod = 'rk4'\nsteps_per_sample = 100",
    "[integrator]\nmethod = 'semi-implicit-euler'\nsteps_per_sample = 100",
];
/// Optional tables that have one form.
const PLAIN: &str = "[amplifier]\nbandwidth_hz = 100\n[mode]\nmass_kg = 1\nstiffness_n_per_m = 1\ndamping_n_s_per_m = 1\n\
    [arm]\nmass_kg = 1\nstiffness_n_per_m = 1\ndamping_n_s_per_m = 1\nrest_position_m = 0\ngrip_stiffness_n_per_m = 1\n\
    grip_damping_n_s_per_m = 1\n[friction]\ncoulomb_n = 0\nstatic_n = 1\nstribeck_speed_m_per_s = 1\n[offset]\nforce_n = 1\n\
    [backlash]\ngap_m = 1\n[amplifier_error]\ncubic = 0\n\
    [cogging]\namplitude_n = 1\npitch_m = 1\nphase_rad = 1\n[encoder_error]\ncycle_m = 0.1\nfirst_m = 0\nsecond_m = 0\n\
    phase_rad = 0\n[encoder_noise]\nrms_m = 0\nseed = 1\n[accelerometer]\nfull_scale_m_per_s2 = 10\n[uncertainty]\n\
    [passivity]\n[board]\nname = 'nucleo-f446re'\n[safety]\n[motor]\n[return]";

/// Scenes of different devices. A range that is the same in all these scenes does not depend on the device.
static BASES: LazyLock<Vec<Table>> = LazyLock::new(|| {
    let of = |text: &str| text.parse::<Table>().unwrap_or_default();
    let (_, paper) = BUILT_IN[0];
    let mut bases: Vec<Table> = BUILT_IN.iter().map(|(_, text)| of(text)).collect();
    for forms in ELEMENTS {
        let mut base = of(paper);
        base.extend(of(PLAIN));
        base.extend(of(forms));
        let arm = base.get("arm").cloned().unwrap_or_else(|| Table::new().into());
        base.insert("arms".into(), Table::from_iter([(NAME.into(), arm)]).into());
        let mut other = base.clone();
        for (path, value) in [
            ("control.rate_hz", 20_000.0),
            ("device.mass_kg", 0.3),
            ("device.start_position_m", -0.01),
            ("encoder.resolution_m", 3e-6),
            ("actuator.gain_n_per_v", 2.0),
            ("actuator.limit_v", 7.0),
            ("wall.position_m", 0.05),
            ("wall_hit.push_n", 0.5),
            ("walk.stiffness_max_n_per_m", 2e5),
            ("walk.damping_max_n_s_per_m", 500.0),
            ("accelerometer.full_scale_m_per_s2", 20.0),
            ("encoder_error.cycle_m", 0.05),
            ("travel.low_m", -2.0),
            ("travel.high_m", 2.0),
        ] {
            put(&mut other, path, value.into());
        }
        bases.extend([base, other]);
    }
    bases
});

/// The JSON schema (draft 7) of scene files, for linear and for rotary scenes.
pub fn schema() -> Value {
    let linear = of::<Scene>();
    let rotary = turned(linear.clone());
    let [mut linear, mut rotary] = [linear, rotary].map(|mut form| {
        ranged(&mut form, "", true);
        form
    });
    // Linear and rotary scenes have these tables, so the schema of each table is used twice.
    let velocity = linear["properties"]["velocity"].clone();
    let arm = linear["properties"]["arm"].clone();
    for form in [&mut linear, &mut rotary] {
        for (one, many, name) in [("velocity", "designs", "velocity"), ("arm", "arms", "arm")] {
            let there = json!({ "$ref": format!("#/definitions/{name}") });
            form["properties"][one] = there.clone();
            form["properties"][many]["additionalProperties"] = there;
        }
    }
    json!({
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Scene of zwidth: one device, one controller, one study",
        "oneOf": [linear, rotary],
        "definitions": { "velocity": velocity, "arm": arm },
    })
}

/// The schema of a scene with `[rotary]`. The names of keys for lengths, forces and masses end with the rotary unit.
fn turned(mut scene: Value) -> Value {
    rename(&mut scene, &|table, key| match (table, key) {
        ("encoder", "resolution_m") | ("actuator", "gain_n_per_v") | ("", "device") => None,
        _ if LINEAR_TABLES.contains(&table) || key.ends_with("phase_rad") => Some(key.into()),
        _ => Some(Units::rotary_key(key).unwrap_or_else(|| key.into())),
    });
    scene["properties"]["rotary"] = of::<Rotary>();
    if let Some(required) = scene["required"].as_array_mut() {
        required.push("rotary".into());
    }
    // With `drive = "voltage"`, `rotary.supply_v` replaces this key.
    if let Some(required) = scene["properties"]["actuator"]["required"].as_array_mut() {
        required.retain(|key| key != "limit_v");
    }
    scene
}

/// Renames or removes keys. `name` gets table and key, and returns the new key, or `None` to remove the key.
fn rename(scene: &mut Value, name: &dyn Fn(&str, &str) -> Option<String>) {
    rename_in(scene, "", name);
    for (table, schema) in scene["properties"].as_object_mut().into_iter().flatten() {
        rename_in(schema, table, name);
        for form in schema.get_mut("oneOf").and_then(Value::as_array_mut).into_iter().flatten() {
            rename_in(form, table, name);
        }
    }
}

fn rename_in(schema: &mut Value, table: &str, name: &dyn Fn(&str, &str) -> Option<String>) {
    if let Some(keys) = schema.get_mut("properties").and_then(Value::as_object_mut) {
        let old = std::mem::take(keys);
        keys.extend(old.into_iter().filter_map(|(key, value)| Some((name(table, &key)?, value))));
    }
    if let Some(required) = schema.get_mut("required").and_then(Value::as_array_mut) {
        let old = std::mem::take(required);
        let kept = old.iter().filter_map(|key| name(table, key.as_str()?));
        required.extend(kept.map(Value::String));
    }
}

/// The unit at the end of a key's name.
pub fn unit(key: &str) -> Option<String> {
    const WORDS: [(&str, &str); 16] = [
        ("n", "N"),
        ("m", "m"),
        ("s", "s"),
        ("kg", "kg"),
        ("rad", "rad"),
        ("v", "V"),
        ("a", "A"),
        ("hz", "Hz"),
        ("ohm", "ohm"),
        ("j", "J"),
        ("db", "dB"),
        ("m2", "m^2"),
        ("s2", "s^2"),
        ("n2", "N^2"),
        ("rad2", "rad^2"),
        ("sqrt", "root"),
    ];
    let word = |part: &str| WORDS.iter().find(|(name, _)| *name == part).map(|(_, unit)| *unit);
    let parts: Vec<&str> = key.split('_').collect();
    let start = parts
        .iter()
        .rposition(|part| *part != "per" && word(part).is_none())
        .map_or(0, |last| last + 1);
    let mut powers = parts[start..].split(|part| *part == "per").map(|words| {
        let words: Vec<_> = words.iter().filter_map(|part| word(part)).collect();
        words.join(" ").replace("root Hz", "sqrt(Hz)")
    });
    let mut unit = powers.next()?;
    for below in powers {
        let brackets = below.contains(' ');
        unit += &if brackets { format!("/({below})") } else { format!("/{below}") };
    }
    (!unit.is_empty()).then_some(unit)
}

/// Description of a key of scenes.
#[derive(Debug)]
pub struct Key {
    /// Names of the tables and of the key, joined with dots.
    pub path: String,
    /// Unit of the number. `None` for a number without a unit, and for other values.
    pub unit: Option<String>,
    pub meaning: String,
    /// Allowed range, or allowed names and what they mean. Empty if `meaning` gives the range.
    pub allowed: String,
    /// `needed`, `optional`, or the value that is used if the key is absent.
    pub absent: String,
}

/// All keys of linear scenes, and the keys of `[rotary]`. `[velocity]`, `[designs.NAME]` and `[arms.NAME]` are left
/// out. `[designs.NAME]` has the keys of `[velocity]`, `[arms.NAME]` the keys of `[arm]`.
pub fn keys() -> Vec<Key> {
    let mut schema = of::<Scene>();
    schema["properties"]["rotary"] = of::<Rotary>();
    ranged(&mut schema, "", false);
    let mut found = vec![];
    listed(&schema, "", "", &mut found);
    found
}

/// Adds the keys of a schema to `found`. `with` is a text that names the form of the table.
fn listed(schema: &Value, path: &str, with: &str, found: &mut Vec<Key>) {
    let text = |value: &Value| value.as_str().unwrap_or_default().replace('\n', " ");
    for (name, key) in schema["properties"].as_object().into_iter().flatten() {
        let path = joined(path, name);
        if ["velocity", "designs", "arms"].contains(&path.as_str()) || key.get("const").is_some() {
            continue;
        }
        if key["type"] == "object"
            || key.get("oneOf").is_some_and(|forms| forms[0].get("properties").is_some())
        {
            listed(key, &path, "", found);
            continue;
        }
        let names = key["oneOf"].as_array().into_iter().flatten();
        let names: Vec<String> = names
            .map(|name| format!("`{}`: {}", text(&name["const"]), text(&name["description"])))
            .collect();
        let allowed = match (key.get(LOW_HIGH[0]), key.get(LOW_HIGH[1])) {
            (Some(Value::Number(low)), Some(Value::Number(high))) => {
                let [low, high] = [low, high].map(|end| short(end.as_f64().unwrap_or_default()));
                format!("{low} to {high}")
            }
            _ => names.join(" "),
        };
        // `x-needed` marks a key that one form of a table needs, if all forms have one type.
        let is_needed =
            schema["required"].as_array().is_some_and(|all| all.iter().any(|k| k == name));
        let absent = match key.get("default") {
            Some(Value::String(default)) => default.clone(),
            Some(default @ (Value::Number(_) | Value::Bool(_))) => default.to_string(),
            _ if is_needed || key["x-needed"] == true => "needed".into(),
            _ => "optional".into(),
        };
        let meaning = format!("{with}{}", text(&key["description"]));
        found.push(Key { unit: unit(name), path, meaning, allowed, absent });
    }
    for form in schema["oneOf"].as_array().into_iter().flatten() {
        let tag = form["properties"].as_object().into_iter().flatten();
        let tag = tag.filter_map(|(key, value)| Some((key, value.get("const")?))).next();
        let with = tag.map_or(String::new(), |(key, name)| format!("With `{key} = {name}`: "));
        listed(form, path, &with, found);
    }
    if let Some(named) = schema.get("additionalProperties").filter(|named| named.is_object()) {
        listed(named, &joined(path, NAME), with, found);
    }
}

/// A number as text: plain or with an exponent, whichever is shorter.
fn short(number: f64) -> String {
    let plain = number.to_string();
    let power = format!("{number:e}");
    if power.len() + 1 < plain.len() { power } else { plain }
}

/// The schema of a type. The schema does not allow null, because TOML has no null.
fn of<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft07().with(|settings| settings.inline_subschemas = true);
    let mut schema = settings.into_generator().into_root_schema_for::<T>().to_value();
    without_null(&mut schema);
    if let Some(root) = schema.as_object_mut() {
        root.remove("$schema");
    }
    schema
}

fn without_null(schema: &mut Value) {
    match schema {
        Value::Array(parts) => parts.iter_mut().for_each(without_null),
        Value::Object(keys) => {
            keys.remove("format");
            if keys.get("default") == Some(&Value::Null) {
                keys.remove("default");
            }
            if let Some(Value::Array(types)) = keys.get_mut("type") {
                types.retain(|kind| kind != "null");
                if let [only] = types.as_slice() {
                    let only = only.clone();
                    keys.insert("type".into(), only);
                }
            }
            if let Some(Value::Array(forms)) = keys.get_mut("anyOf") {
                forms.retain(|form| form["type"] != "null");
                if let [Value::Object(only)] = forms.as_slice() {
                    let only = only.clone();
                    keys.remove("anyOf");
                    for (key, value) in only {
                        keys.entry(key).or_insert(value);
                    }
                }
            }
            keys.values_mut().for_each(without_null);
        }
        _ => {}
    }
}

/// Adds ranges that are the same in every scene. With `units`, each description gets the unit of its key.
fn ranged(schema: &mut Value, path: &str, units: bool) {
    let Some(keys) = schema.as_object_mut() else { return };
    let unit = path.rsplit('.').next().and_then(unit).filter(|_| units);
    if let (Some(unit), Some(Value::String(text))) = (unit, keys.get_mut("description")) {
        *text = format!("{text} [{unit}]");
    }
    let has_ranges =
        path != "velocity" && !path.starts_with("velocity.") && !path.starts_with("designs");
    let is = |kind: &&str| keys.get("type").is_some_and(|is| is == kind);
    if has_ranges && ["number", "integer"].iter().any(is) {
        LOW_HIGH.iter().for_each(|end| drop(keys.remove(*end)));
        let ends = range(path).into_iter().flatten();
        LOW_HIGH.iter().zip(ends).for_each(|(end, to)| drop(keys.insert((*end).into(), to)));
        return;
    }
    for (key, value) in
        keys.get_mut("properties").and_then(Value::as_object_mut).into_iter().flatten()
    {
        ranged(value, &joined(path, key), units);
    }
    for form in keys.get_mut("oneOf").and_then(Value::as_array_mut).into_iter().flatten() {
        ranged(form, path, units);
    }
    if let Some(named) = keys.get_mut("additionalProperties") {
        ranged(named, &joined(path, NAME), units);
    }
}

fn joined(path: &str, key: &str) -> String {
    if path.is_empty() { key.into() } else { format!("{path}.{key}") }
}

/// The range of a key, if it is the same in every scene with this key.
fn range(path: &str) -> Option<[Value; 2]> {
    let found: Vec<[f64; 2]> = BASES.iter().filter_map(|base| range_in(base, path)).collect();
    let (first, others) = found.split_first()?;
    others.iter().all(|other| other == first).then(|| first.map(|end| json!(end)))
}

/// The range as the error message for a too large value names it.
fn range_in(base: &Table, path: &str) -> Option<[f64; 2]> {
    [toml::Value::Float(f64::INFINITY), toml::Value::Integer(u32::MAX.into())].into_iter().find_map(
        |strange| {
            let mut scene = base.clone();
            put(&mut scene, path, strange);
            let refusal = refusal(scene)?;
            let (_, range) =
                refusal.strip_prefix(path)?.strip_prefix(" is ")?.split_once(", allowed ")?;
            let (low, high) = range.split_once(" to ")?;
            Some([rounded(low.parse().ok()?, 7), rounded(high.parse().ok()?, 7)])
        },
    )
}

fn put(scene: &mut Table, path: &str, value: toml::Value) {
    let mut keys: Vec<&str> = path.split('.').collect();
    let last = keys.pop().unwrap_or_default();
    let table = keys.iter().try_fold(scene, |table, key| table.get_mut(*key)?.as_table_mut());
    if let Some(table) = table {
        table.insert(last.into(), value);
    }
}

/// The error that a scene causes, or `None` if the scene is valid.
fn refusal(scene: Table) -> Option<String> {
    let (table, units) = match at_handle(scene) {
        Ok(read) => read,
        Err(error) => return Some(error),
    };
    Scene::deserialize(table).ok()?.check().err().map(|error| units.text(&error))
}
