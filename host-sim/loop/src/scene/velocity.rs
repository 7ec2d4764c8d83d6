//! The velocity filter of a scene: `[velocity]` and `[designs.NAME]` for the core's table of estimators.
//!
//! Names and keys are the same as in the core's table, with one exception: an estimator's frequency, usually its
//! cutoff, always has the key `cutoff_hz`. If the scene has no cutoff, the cutoff comes from the command line or from
//! `[sweep]`.

use std::{borrow::Cow, fmt};

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{self, DeserializeOwned, MapAccess, Visitor},
    ser::SerializeStruct,
};
use serde_json::json;
use toml::Value;
use zwidth::{
    SettingsError, VelocitySettings,
    velocity::{EstimatorName, PARAMETERS, Parameter, Sense},
};

/// Value of the key that selects one estimator of a family.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Member {
    Flag(bool),
    Number(u32),
}

/// Families are estimators that share one name in scenes. A key and its value select an estimator of the family.
const FAMILIES: [(EstimatorName, &str, &str, Member); 8] = [
    (EstimatorName::Butterworth, "butterworth", "prewarp", Member::Flag(false)),
    (EstimatorName::ButterworthPrewarped, "butterworth", "prewarp", Member::Flag(true)),
    (EstimatorName::FirstOrder, "first-order", "prewarp", Member::Flag(false)),
    (EstimatorName::FirstOrderPrewarped, "first-order", "prewarp", Member::Flag(true)),
    (EstimatorName::Taylor2, "taylor", "order", Member::Number(2)),
    (EstimatorName::Taylor3, "taylor", "order", Member::Number(3)),
    (EstimatorName::LeastSquares1, "least-squares", "degree", Member::Number(1)),
    (EstimatorName::LeastSquares2, "least-squares", "degree", Member::Number(2)),
];
/// Keys that a scene may leave out. Their defaults are in the core's table.
const OPTIONAL: [&str; 3] = ["noise_counts", "lambda_ratio", "lead"];
/// The key with the estimator's name.
const TAG: &str = "estimator";
/// The key of an estimator's frequency.
pub const CUTOFF: &str = "cutoff_hz";

/// The name that an estimator has in scenes, and the key and value that select it.
fn spelling(name: EstimatorName) -> (&'static str, Option<(&'static str, Member)>) {
    match FAMILIES.iter().find(|(member, ..)| *member == name) {
        Some((_, family, key, member)) => (family, Some((key, *member))),
        None => (name.text(), None),
    }
}

/// The estimators that have this name in scenes.
fn members(family: &str) -> impl Iterator<Item = EstimatorName> {
    EstimatorName::ALL.iter().copied().filter(move |name| spelling(*name).0 == family)
}

/// The keys for an estimator's parameters. Each key has its parameter and the parameter's index.
fn keys(name: EstimatorName) -> impl Iterator<Item = (&'static str, Parameter, usize)> {
    let parameters = name.parameters().into_iter().flatten().enumerate();
    let keyed = name.keys().iter().zip(parameters);
    keyed.map(|(key, (place, parameter))| match parameter.is_frequency() {
        true => (CUTOFF, parameter, place),
        false => (*key, parameter, place),
    })
}

/// The key that sets a parameter of the core in `[velocity]`. `None` if no estimator has this parameter.
pub fn key_of(parameter: &str) -> Option<&str> {
    if FAMILIES.iter().any(|(_, _, key, _)| *key == parameter) {
        return Some(parameter);
    }
    let own = |name: &EstimatorName| name.keys().iter().zip(keys(*name));
    let mut all = EstimatorName::ALL.iter().flat_map(own);
    all.find(|(core, _)| **core == parameter).map(|(_, (key, ..))| key)
}

/// The velocity filter of a scene, with or without a cutoff.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityTable {
    estimator: EstimatorName,
    /// Values of the parameters, by parameter index. `None` if the parameter is not used, or if it is a cutoff that the
    /// scene does not give.
    numbers: [Option<f64>; PARAMETERS],
    /// Value of the selecting key, if no estimator of the family has this value. [`check`](Self::check) reports it.
    stranger: Option<u32>,
}

impl From<VelocitySettings> for VelocityTable {
    fn from(settings: VelocitySettings) -> Self {
        let (estimator, numbers) = EstimatorName::of(&settings);
        let mut table = Self { estimator, numbers: [None; PARAMETERS], stranger: None };
        for (.., place) in keys(estimator) {
            table.numbers[place] = Some(numbers[place]);
        }
        table
    }
}

impl VelocityTable {
    /// The core's settings. `None` if the estimator needs a cutoff and the scene has none.
    pub fn settings(&self) -> Option<VelocitySettings> {
        let whole = !self.has_cutoff() || self.cutoff_hz().is_some();
        whole.then(|| self.estimator.settings(self.numbers.map(Option::unwrap_or_default)))
    }

    /// The core's settings with this cutoff. The cutoff has no effect on an estimator without a cutoff.
    pub fn at(&self, cutoff_hz: f64) -> VelocitySettings {
        let table = if self.has_cutoff() { self.with_cutoff(Some(cutoff_hz)) } else { *self };
        self.estimator.settings(table.numbers.map(Option::unwrap_or_default))
    }

    /// The cutoff, in Hz. `None` if the estimator has no cutoff, or the scene gives none.
    pub fn cutoff_hz(&self) -> Option<f64> {
        self.cutoff_place().and_then(|place| self.numbers[place])
    }

    /// The same filter with another cutoff, or without one. An estimator without a cutoff does not change.
    #[must_use]
    pub fn with_cutoff(mut self, cutoff_hz: Option<f64>) -> Self {
        if let Some(place) = self.cutoff_place() {
            self.numbers[place] = cutoff_hz;
        }
        self
    }

    pub fn has_cutoff(&self) -> bool {
        self.cutoff_place().is_some()
    }

    fn cutoff_place(&self) -> Option<usize> {
        keys(self.estimator).find(|(key, ..)| *key == CUTOFF).map(|(.., place)| place)
    }

    /// Checks that the keys select an estimator. The core checks the parameters.
    ///
    /// # Errors
    /// The error names the key and its range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let (family, key) = spelling(self.estimator);
        let (Some(value), Some((parameter, _))) = (self.stranger, key) else { return Ok(()) };
        let known = members(family).filter_map(|name| match spelling(name).1 {
            Some((_, Member::Number(number))) => Some(f64::from(number)),
            _ => None,
        });
        let (low, high) =
            known.fold((f64::MAX, f64::MIN), |(low, high), n| (low.min(n), high.max(n)));
        Err(SettingsError { parameter, value: value.into(), range: low..=high })
    }

    /// The input that the estimator needs in addition to the position.
    pub fn sense(&self) -> Option<Sense> {
        self.estimator.sense()
    }

    pub fn estimator(&self) -> EstimatorName {
        self.estimator
    }

    /// Name of the estimator in reports and in the envelope.
    pub fn name(&self) -> &'static str {
        self.estimator.text()
    }

    /// Reads the keys of a scene; `family` is the estimator's name.
    fn read(family: &str, given: Vec<(String, Value)>) -> Result<Self, String> {
        let first = members(family).next().ok_or_else(|| no_family(family))?;
        let selects = spelling(first).1;
        let mut numbers = [None; PARAMETERS];
        let mut wanted = None;
        for (key, value) in given {
            let parameter = keys(first).find(|(known, ..)| *known == key);
            if let Some((_, parameter, place)) = parameter {
                numbers[place] = Some(match parameter.is_whole() {
                    true => f64::from(typed::<u32>(value)?),
                    false => typed(value)?,
                });
                continue;
            }
            wanted = Some(match selects.filter(|(known, _)| *known == key) {
                Some((_, Member::Flag(_))) => Member::Flag(typed(value)?),
                Some((_, Member::Number(_))) => Member::Number(typed(value)?),
                None if key == CUTOFF => {
                    return Err(format!("{CUTOFF} is {value}, the estimator {family} has none"));
                }
                None => {
                    let known = selects.iter().map(|(key, _)| *key);
                    let known: Vec<_> = known.chain(keys(first).map(|(key, ..)| key)).collect();
                    return Err(unknown("field", &key, &known));
                }
            });
        }
        let missing = |key| Err(format!("missing field `{key}`"));
        let wanted = match selects {
            Some((_, Member::Flag(_))) => wanted.or(Some(Member::Flag(false))),
            Some((key, Member::Number(_))) if wanted.is_none() => return missing(key),
            _ => wanted,
        };
        for (key, parameter, place) in keys(first) {
            if numbers[place].is_none() && key != CUTOFF {
                if !OPTIONAL.contains(&key) {
                    return missing(key);
                }
                numbers[place] = Some(parameter.default);
            }
        }
        let meant =
            members(family).find(|name| spelling(*name).1.map(|(_, member)| member) == wanted);
        let stranger = match wanted {
            Some(Member::Number(number)) if meant.is_none() => Some(number),
            _ => None,
        };
        Ok(Self { estimator: meant.unwrap_or(first), numbers, stranger })
    }
}

/// Name and cutoff of a filter, as text for people.
pub fn describe(filter: &VelocitySettings, rate_hz: f64) -> String {
    let name = filter.name().text();
    let (Some((parameter, _)), Some(cutoff_hz), Some(true_hz)) =
        (filter.tuning(), filter.cutoff_hz(), filter.true_cutoff_hz(rate_hz))
    else {
        return name.into();
    };
    let parameter = parameter.name;
    if true_hz == cutoff_hz {
        format!("{name}, {parameter} {cutoff_hz} Hz")
    } else {
        format!("{name}, {parameter} {cutoff_hz} Hz nominal (-3 dB at {true_hz:.1} Hz)")
    }
}

/// Converts a value to a type. A date is read as a map, because serde reads dates in the other tables of a scene as
/// maps.
fn typed<T: DeserializeOwned>(value: Value) -> Result<T, String> {
    let value = if value.is_datetime() { Value::Table(toml::Table::new()) } else { value };
    T::deserialize(value).map_err(|error| error.message().into())
}

/// All names of estimators in scenes.
fn families() -> Vec<&'static str> {
    let mut all: Vec<_> = EstimatorName::ALL.iter().map(|name| spelling(*name).0).collect();
    all.dedup();
    all
}

/// The error for an unknown name of an estimator.
fn no_family(text: &str) -> String {
    // In scenes the family `least-squares` replaces the old name `algebraic`.
    let family = (text == "algebraic").then_some("least-squares");
    match EstimatorName::replacing(text).or(family) {
        Some(other) => format!("estimator `{text}` is no more: use {other}"),
        None => unknown("variant", text, &families()),
    }
}

/// The error for an unknown name, with the same words as an error of serde.
fn unknown(what: &str, name: &str, known: &[&str]) -> String {
    let quoted: Vec<_> = known.iter().map(|known| format!("`{known}`")).collect();
    match quoted.as_slice() {
        [] => format!("unknown {what} `{name}`, there are no {what}s"),
        [one] => format!("unknown {what} `{name}`, expected {one}"),
        [one, other] => format!("unknown {what} `{name}`, expected {one} or {other}"),
        all => format!("unknown {what} `{name}`, expected one of {}", all.join(", ")),
    }
}

impl<'de> Deserialize<'de> for VelocityTable {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (family, given) = deserializer.deserialize_any(Table)?;
        Self::read(&family, given).map_err(de::Error::custom)
    }
}

/// Reads the table `[velocity]`: first the name, then the other keys and values.
struct Table;

impl<'de> Visitor<'de> for Table {
    type Value = (String, Vec<(String, Value)>);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a table with an estimator")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut family, mut given) = (None, vec![]);
        while let Some(key) = map.next_key::<String>()? {
            if key == TAG {
                family = Some(map.next_value::<Family>()?.0);
            } else {
                given.push((key, map.next_value()?));
            }
        }
        Ok((family.ok_or_else(|| de::Error::missing_field(TAG))?, given))
    }
}

struct Family(String);

impl<'de> Deserialize<'de> for Family {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Known;
        impl Visitor<'_> for Known {
            type Value = Family;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("variant identifier")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Family, E> {
                match members(text).next() {
                    Some(_) => Ok(Family(text.into())),
                    None => Err(E::custom(no_family(text))),
                }
            }
        }
        deserializer.deserialize_identifier(Known)
    }
}

impl JsonSchema for VelocityTable {
    fn schema_name() -> Cow<'static, str> {
        "VelocityTable".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let tables: Vec<_> = families().into_iter().map(schema_of).collect();
        json_schema!({ "type": "object", "oneOf": tables })
    }
}

/// The JSON schema of the keys that a scene can give with one estimator name.
fn schema_of(family: &str) -> serde_json::Value {
    let mut properties = serde_json::Map::from_iter([(TAG.into(), json!({ "const": family }))]);
    let mut required = vec![TAG];
    let first = members(family).next();
    for (key, parameter, _) in first.into_iter().flat_map(keys) {
        let kind = if parameter.is_whole() { "integer" } else { "number" };
        let described = json!({ "type": kind, "description": parameter.name });
        properties.insert(key.into(), described);
        if !OPTIONAL.contains(&key) && key != CUTOFF {
            required.push(key);
        }
    }
    if let Some((key, member)) = first.and_then(|name| spelling(name).1) {
        let described = match member {
            Member::Flag(_) => json!({
                "type": "boolean",
                "default": false,
                "description": "`true`: the cutoff is the -3 dB frequency. `false`: nominal, as in the paper."
            }),
            Member::Number(_) => {
                required.push(key);
                let known = members(family).filter_map(|name| match spelling(name).1 {
                    Some((_, Member::Number(number))) => Some(number),
                    _ => None,
                });
                json!({ "enum": known.collect::<Vec<_>>(), "description": key })
            }
        };
        properties.insert(key.into(), described);
    }
    json!({ "properties": properties, "required": required, "additionalProperties": false })
}

impl Serialize for VelocityTable {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (family, selects) = spelling(self.estimator);
        let others = || keys(self.estimator).filter(|(key, ..)| *key != CUTOFF);
        let known = self.cutoff_hz();
        let flags = usize::from(selects.is_some()) + usize::from(known.is_some());
        let fields = 1 + flags + others().count();
        let mut table = serializer.serialize_struct("VelocityTable", fields)?;
        if let Some(cutoff_hz) = known {
            table.serialize_field(CUTOFF, &cutoff_hz)?;
        }
        table.serialize_field(TAG, family)?;
        match selects {
            Some((key, Member::Flag(flag))) => table.serialize_field(key, &flag)?,
            Some((key, Member::Number(number))) => {
                table.serialize_field(key, &self.stranger.unwrap_or(number))?;
            }
            None => {}
        }
        for (key, parameter, place) in others() {
            let number = self.numbers[place].unwrap_or_default();
            if parameter.is_whole() {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a whole parameter is a u32"
                )]
                table.serialize_field(key, &(number as u32))?;
            } else {
                table.serialize_field(key, &number)?;
            }
        }
        table.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    /// A table that is written and read again is the same filter, with and without a cutoff. A cutoff that is absent is
    /// written without a key.
    #[test]
    fn a_table_is_read_as_it_was_written() {
        for name in EstimatorName::ALL {
            let settings = name.defaults();
            let whole = VelocityTable::from(settings);
            assert_eq!(
                (whole.settings(), whole.cutoff_hz()),
                (Some(settings), settings.cutoff_hz())
            );
            let open = whole.with_cutoff(None);
            assert_eq!(open.settings().is_none(), whole.has_cutoff(), "{name:?}");
            assert_eq!(open.at(20.0).cutoff_hz(), whole.has_cutoff().then_some(20.0));
            for table in [whole, open] {
                let text = toml::to_string(&table).unwrap();
                assert_eq!(text.contains(CUTOFF), table.cutoff_hz().is_some(), "{text}");
                assert_eq!(toml::from_str::<VelocityTable>(&text).unwrap(), table, "{text}");
            }
        }
    }

    #[test]
    fn a_built_in_scene_is_written_without_a_cutoff_of_its_filter() {
        let NamedScene { scene, .. } = NamedScene::load("paper-1um").unwrap();
        let written: toml::Table = toml::to_string(&scene).unwrap().parse().unwrap();
        let velocity = written["velocity"].as_table().unwrap();
        assert_eq!(velocity.keys().collect::<Vec<_>>(), ["estimator", "prewarp"]);
    }
}
