//! The estimator of a scene: the core's table of estimators in the keys of `[velocity]`.
//!
//! Names and keys are the table's. A parameter that is a frequency comes from the command line or from
//! `[sweep]` instead.

use std::fmt;

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{self, DeserializeOwned, MapAccess, Visitor},
    ser::SerializeStruct,
};
use toml::Value;
use zwidth::{
    SettingsError, VelocitySettings,
    velocity::{EstimatorName, PARAMETERS, Parameter, Sense, true_cutoff_hz},
};

/// What a key of a family tells its members by.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Member {
    Flag(bool),
    Number(u32),
}

/// Estimators that share a name in scenes: that name, the key that tells them apart, and its value.
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
/// Keys that a scene may leave out; the parameter is at the table's default then.
const OPTIONAL: [&str; 3] = ["noise_counts", "lambda_ratio", "lead"];
/// The key of the name.
const TAG: &str = "estimator";

/// The name in scenes, and the key with which it is this estimator.
fn spelling(name: EstimatorName) -> (&'static str, Option<(&'static str, Member)>) {
    match FAMILIES.iter().find(|(member, ..)| *member == name) {
        Some((_, family, key, member)) => (family, Some((key, *member))),
        None => (name.text(), None),
    }
}

/// The estimators that a scene writes by that name.
fn members(family: &str) -> impl Iterator<Item = EstimatorName> {
    EstimatorName::ALL.iter().copied().filter(move |name| spelling(*name).0 == family)
}

/// The parameters that a scene has: key, parameter, place.
fn keys(name: EstimatorName) -> impl Iterator<Item = (&'static str, Parameter, usize)> {
    let parameters = name.parameters().into_iter().flatten().enumerate();
    let keyed = name.keys().iter().zip(parameters);
    keyed
        .map(|(key, (place, parameter))| (*key, parameter, place))
        .filter(|(_, p, _)| !p.is_frequency())
}

/// The key of the scene for a parameter of the core, if it is one of an estimator's.
pub fn key_of(parameter: &str) -> Option<String> {
    let selects = FAMILIES.iter().any(|(_, _, key, _)| *key == parameter);
    let mut all = EstimatorName::ALL
        .iter()
        .flat_map(|name| name.keys().iter().zip(name.parameters().into_iter().flatten()));
    match all.find(|(key, _)| **key == parameter) {
        Some((_, known)) if known.is_frequency() => Some("sweep.cutoffs_hz".into()),
        None if !selects => None,
        _ => Some(format!("velocity.{parameter}")),
    }
}

/// A velocity estimator as a scene says it. Where it is tuned by a cutoff, that comes from the command
/// line or from `[sweep]`; every other parameter stands here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorChoice {
    /// A cutoff is 0.
    settings: VelocitySettings,
    /// What the family's key says, if it has no such member: [`check`](Self::check) refuses it.
    stranger: Option<u32>,
}

impl From<VelocitySettings> for EstimatorChoice {
    fn from(settings: VelocitySettings) -> Self {
        Self::of(&settings).0
    }
}

impl EstimatorChoice {
    /// The core's settings; `cutoff_hz` is for estimators that have a cutoff.
    pub fn settings(self, cutoff_hz: f64) -> VelocitySettings {
        if self.has_cutoff() { self.settings.with_tuning(cutoff_hz) } else { self.settings }
    }

    /// The scene's form of those settings, and their cutoff if they have one.
    pub fn of(settings: &VelocitySettings) -> (Self, Option<f64>) {
        let cutoff_hz = settings.tuning().filter(|(parameter, _)| parameter.is_frequency());
        let rest = cutoff_hz.map_or(*settings, |_| settings.with_tuning(0.0));
        (Self { settings: rest, stranger: None }, cutoff_hz.map(|(_, value)| value))
    }

    /// Says whether there is such an estimator; its parameters are for the core to check.
    ///
    /// # Errors
    /// Names the key, and its range.
    pub fn check(self) -> Result<(), SettingsError> {
        let (family, key) = spelling(self.settings.name());
        let (Some(value), Some((parameter, _))) = (self.stranger, key) else { return Ok(()) };
        let known = members(family).filter_map(|name| match spelling(name).1 {
            Some((_, Member::Number(number))) => Some(f64::from(number)),
            _ => None,
        });
        let (low, high) =
            known.fold((f64::MAX, f64::MIN), |(low, high), n| (low.min(n), high.max(n)));
        Err(SettingsError { parameter, value: value.into(), range: low..=high })
    }

    /// What the estimator cannot do without, beside the position.
    pub fn sense(self) -> Option<Sense> {
        self.settings.name().sense()
    }

    /// Whether it is tuned by a cutoff.
    pub fn has_cutoff(self) -> bool {
        self.settings.tuning().is_some_and(|(parameter, _)| parameter.is_frequency())
    }

    /// Name in reports and in the envelope.
    pub fn name(self) -> &'static str {
        self.settings.name().text()
    }

    /// Name and cutoff, for people.
    pub fn describe(self, cutoff_hz: f64, rate_hz: f64) -> String {
        let name = self.name();
        let parameter = match self.settings.tuning() {
            Some((parameter, _)) if parameter.is_frequency() => parameter.name,
            _ => return name.into(),
        };
        let true_hz = self.true_cutoff_hz(cutoff_hz, rate_hz);
        if true_hz == cutoff_hz {
            format!("{name}, {parameter} {cutoff_hz} Hz")
        } else {
            format!("{name}, {parameter} {cutoff_hz} Hz nominal (-3 dB at {true_hz:.1} Hz)")
        }
    }

    /// -3 dB frequency of the digital filter of that nominal cutoff, Hz; the cutoff itself where the
    /// estimator is no such filter.
    pub fn true_cutoff_hz(self, cutoff_hz: f64, rate_hz: f64) -> f64 {
        match self.settings {
            VelocitySettings::Butterworth { .. } | VelocitySettings::FirstOrder { .. } => {
                true_cutoff_hz(cutoff_hz, rate_hz, false)
            }
            _ => cutoff_hz,
        }
    }

    /// From the keys of a scene, beside the name.
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
            if numbers[place].is_none() {
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
        let numbers = numbers.map(Option::unwrap_or_default);
        Ok(Self { settings: meant.unwrap_or(first).settings(numbers), stranger })
    }
}

/// A value of that type, or why it is none; to serde a date is a map, here as in a scene's other tables.
fn typed<T: DeserializeOwned>(value: Value) -> Result<T, String> {
    let value = if value.is_datetime() { Value::Table(toml::Table::new()) } else { value };
    T::deserialize(value).map_err(|error| error.message().into())
}

/// All names in scenes.
fn families() -> Vec<&'static str> {
    let mut all: Vec<_> = EstimatorName::ALL.iter().map(|name| spelling(*name).0).collect();
    all.dedup();
    all
}

/// Why a scene names no estimator.
fn no_family(text: &str) -> String {
    // a family as this is one
    let family = (text == "algebraic").then_some("least-squares");
    match EstimatorName::replacing(text).or(family) {
        Some(other) => format!("estimator `{text}` is no more: use {other}"),
        None => unknown("variant", text, &families()),
    }
}

/// serde's own line for what it does not know.
fn unknown(what: &str, name: &str, known: &[&str]) -> String {
    let quoted: Vec<_> = known.iter().map(|known| format!("`{known}`")).collect();
    match quoted.as_slice() {
        [] => format!("unknown {what} `{name}`, there are no {what}s"),
        [one] => format!("unknown {what} `{name}`, expected {one}"),
        [one, other] => format!("unknown {what} `{name}`, expected {one} or {other}"),
        all => format!("unknown {what} `{name}`, expected one of {}", all.join(", ")),
    }
}

impl<'de> Deserialize<'de> for EstimatorChoice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (family, given) = deserializer.deserialize_any(Table)?;
        Self::read(&family, given).map_err(de::Error::custom)
    }
}

/// The table `[velocity]`: the name, and the other keys with their values.
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

/// A name in scenes.
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

impl Serialize for EstimatorChoice {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (name, numbers) = EstimatorName::of(&self.settings);
        let (family, selects) = spelling(name);
        let fields = 1 + usize::from(selects.is_some()) + keys(name).count();
        let mut table = serializer.serialize_struct("EstimatorChoice", fields)?;
        table.serialize_field(TAG, family)?;
        match selects {
            Some((key, Member::Flag(flag))) => table.serialize_field(key, &flag)?,
            Some((key, Member::Number(number))) => {
                table.serialize_field(key, &self.stranger.unwrap_or(number))?;
            }
            None => {}
        }
        for (key, parameter, place) in keys(name) {
            if parameter.is_whole() {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a whole parameter is a u32"
                )]
                table.serialize_field(key, &(numbers[place] as u32))?;
            } else {
                table.serialize_field(key, &numbers[place])?;
            }
        }
        table.end()
    }
}
