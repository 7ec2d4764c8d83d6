//! Reads `STUDY.toml`: the measurement, the scenes, and the changes of their keys.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Deserializer, de::Error as _};
use toml::{Table, Value};

use crate::{
    error::Error,
    input,
    study::list::{self, List},
};

/// What is measured at each point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Measure {
    /// The boundary of the stable walls, walked from one start.
    Walk,
    /// One hit at one wall.
    Hit,
    /// The ideal cutoff. It is found with walks at every cutoff.
    Sweep,
}

impl Measure {
    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::Hit => "hit",
            Self::Sweep => "sweep",
        }
    }
}

/// Keys of a scene, each with its new value.
pub type Changes = Vec<(String, Value)>;

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Keys {
    pub measure: Measure,
    /// Scenes of the study. Each is the name of a built-in scene or a path.
    pub scenes: Vec<String>,
    #[serde(default)]
    estimators: Vec<Value>,
    /// Cutoffs of the study, in Hz. `None` stands for the cutoffs of each scene.
    #[serde(default, deserialize_with = "numbers")]
    pub cutoffs_hz: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "numbers")]
    starts_counts: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "numbers")]
    stiffnesses: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "numbers")]
    dampings: Option<Vec<f64>>,
    repeat: Option<u32>,
    /// Number of points in a unit. With `None`, a unit has as many points as take some seconds.
    pub points_per_unit: Option<u64>,
    #[serde(default)]
    product: Table,
    #[serde(default)]
    list: Vec<Table>,
}

/// The contents of a study's file. Checks for which the scenes must be known are made later.
#[derive(Clone, Debug)]
pub struct StudyFile {
    /// Name in error messages.
    pub origin: String,
    pub text: String,
    /// Folder in which scenes with a relative path are found.
    pub folder: PathBuf,
    pub keys: Keys,
    /// The table `[velocity]` for each estimator. The list is empty if each scene uses its own estimator.
    pub estimators: Vec<Table>,
    /// Every key of `[product]` with its values.
    pub product: Vec<(String, Vec<Value>)>,
    /// The changes of every `[[list]]`. If the file has no list, there is one entry without changes.
    pub list: Vec<Changes>,
}

impl Keys {
    /// Starts of the hits or walks, in counts from the scene's own start.
    pub fn starts_counts(&self) -> &[f64] {
        self.starts_counts.as_deref().unwrap_or(&[0.0])
    }

    /// K of the walls, in the unit that the scenes use.
    pub fn stiffnesses(&self) -> &[f64] {
        self.stiffnesses.as_deref().unwrap_or_default()
    }

    /// B of the walls, in the unit that the scenes use.
    pub fn dampings(&self) -> &[f64] {
        self.dampings.as_deref().unwrap_or_default()
    }

    /// Number of walks of each cutoff in a sweep.
    pub fn repeat(&self) -> u32 {
        self.repeat.unwrap_or(REPEAT)
    }
}

/// Reads numbers from an array or from the text of a list.
fn numbers<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Vec<f64>>, D::Error> {
    let wanted = "expected numbers: [A, B] or \"FROM:STEP:TO\"";
    match Value::deserialize(from)? {
        Value::String(text) => {
            list::parse(&text).map(|List(list)| Some(list)).map_err(D::Error::custom)
        }
        Value::Array(values) if values.is_empty() => Err(D::Error::custom("the list is empty")),
        Value::Array(values) => {
            let number = |value: &Value| as_number(value).ok_or_else(|| D::Error::custom(wanted));
            values.iter().map(number).collect::<Result<_, _>>().map(Some)
        }
        _ => Err(D::Error::custom(wanted)),
    }
}

fn as_number(value: &Value) -> Option<f64> {
    match value {
        Value::Integer(value) => Some(*value as f64),
        Value::Float(value) => Some(*value),
        _ => None,
    }
}

/// Names the kind of a value. `None` if no key can have a value of this kind.
fn kind(value: &Value) -> Option<&'static str> {
    match value {
        Value::Integer(_) | Value::Float(_) => Some("number"),
        Value::String(_) => Some("text"),
        Value::Boolean(_) => Some("true or false"),
        _ => None,
    }
}

impl StudyFile {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// [`Error::Input`] with file, key, value, and what is allowed.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let text = input::read_text(path, input::STUDY)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::parse(text, &path.display().to_string(), folder)
    }

    /// Reads a study from `text`. Error messages name it with `origin`. `folder` is the folder for scenes with a
    /// relative path.
    ///
    /// # Errors
    /// An error of [`load`](Self::load).
    pub fn parse(text: String, origin: &str, folder: &Path) -> Result<Self, Error> {
        let keys: Keys = toml::from_str(&text).map_err(|error| {
            let start = error.span().map_or(0, |span| span.start);
            let line = text[..start.min(text.len())].matches('\n').count() + 1;
            let said = text.lines().nth(line - 1).unwrap_or_default().trim();
            let said: String = said.chars().take(60).collect();
            Error::Input(format!(
                "{origin}:{line}: `{said}`: {}",
                error.message().replace('\n', " ")
            ))
        })?;
        let refused = |what: String| Error::Input(format!("{origin}: {what}"));
        let product = keys.product().map_err(refused)?;
        let list = keys.list(&product).map_err(refused)?;
        let estimators = keys.estimators().map_err(refused)?;
        keys.check().map_err(refused)?;
        let (origin, folder) = (origin.to_owned(), folder.to_path_buf());
        Ok(Self { origin, text, folder, keys, estimators, product, list })
    }
}

/// Default number of walks of each cutoff in a sweep.
const REPEAT: u32 = 4;
/// Largest number of walks of each cutoff.
const REPEAT_MAX: u32 = 1000;
/// Largest number of points of a unit.
const PER_UNIT_MAX: u64 = 1_000_000;

impl Keys {
    /// Checks the rules for the keys that need no scene.
    fn check(&self) -> Result<(), String> {
        if self.scenes.is_empty() {
            return Err("scenes is empty, allowed built-in names and scene files".into());
        }
        let measure = self.measure.name();
        let given = [
            ("stiffnesses", self.stiffnesses.is_some(), [Measure::Hit].as_slice()),
            ("dampings", self.dampings.is_some(), &[Measure::Hit]),
            ("starts_counts", self.starts_counts.is_some(), &[Measure::Hit, Measure::Walk]),
            ("repeat", self.repeat.is_some(), &[Measure::Sweep]),
        ];
        for (key, is_given, of) in given {
            let names: Vec<&str> = of.iter().map(|measure| measure.name()).collect();
            if is_given && !of.contains(&self.measure) {
                let allowed = names.join(" and ");
                return Err(format!(
                    "{key} is given, but measure is {measure}, allowed with {allowed}"
                ));
            }
            let is_needed = matches!(key, "stiffnesses" | "dampings");
            if !is_given && is_needed && self.measure == Measure::Hit {
                return Err(format!("{key} is missing, measure = \"hit\" needs it"));
            }
        }
        if let Some(repeat) = self.repeat.filter(|repeat| !(1..=REPEAT_MAX).contains(repeat)) {
            return Err(format!("repeat is {repeat}, allowed 1 to {REPEAT_MAX}"));
        }
        match self.points_per_unit {
            Some(points) if !(1..=PER_UNIT_MAX).contains(&points) => {
                Err(format!("points_per_unit is {points}, allowed 1 to {PER_UNIT_MAX}"))
            }
            _ => Ok(()),
        }
    }

    /// The estimators of the study, each as a table `[velocity]` of a scene.
    fn estimators(&self) -> Result<Vec<Table>, String> {
        let table = |value: &Value| match value {
            Value::String(name) => {
                Ok(Table::from_iter([("estimator".to_owned(), Value::String(name.clone()))]))
            }
            Value::Table(table) => Ok(table.clone()),
            other => Err(format!(
                "estimators has {other}, allowed names and tables as [velocity] of a scene"
            )),
        };
        self.estimators.iter().map(table).collect()
    }

    /// The keys of `[product]`, each with its values.
    fn product(&self) -> Result<Vec<(String, Vec<Value>)>, String> {
        let leaves = flat("product", &self.product)?;
        let mut product = vec![];
        for (key, value) in leaves {
            let values = match value {
                Value::Array(values) => values,
                Value::String(text) => {
                    let list =
                        list::parse(&text).map_err(|error| format!("product.{key}: {error}"))?;
                    list.0.into_iter().map(Value::Float).collect()
                }
                other => {
                    return Err(format!(
                        "product.{key} is {other}, allowed [A, B] or \"FROM:STEP:TO\""
                    ));
                }
            };
            may_change("product", &key)?;
            if values.is_empty() {
                return Err(format!("product.{key} is empty, allowed [A, B] or \"FROM:STEP:TO\""));
            }
            one_kind("product", &key, &values)?;
            product.push((key, values));
        }
        Ok(product)
    }

    /// The changes that each `[[list]]` makes.
    fn list(&self, product: &[(String, Vec<Value>)]) -> Result<Vec<Changes>, String> {
        let mut list: Vec<Changes> = vec![];
        for table in &self.list {
            list.push(flat("list", table)?);
        }
        let keys = |changes: &Changes| -> Vec<String> {
            changes.iter().map(|(key, _)| key.clone()).collect()
        };
        let first = list.first().map(keys).unwrap_or_default();
        for (n, changes) in (1..).zip(&list) {
            if keys(changes) != first {
                let [here, first] = [keys(changes), first].map(|keys| keys.join(", "));
                return Err(format!(
                    "list: entry {n} has the keys {here}, allowed those of the first: {first}"
                ));
            }
            if changes.is_empty() {
                return Err(format!("list: entry {n} is empty, allowed keys of a scene"));
            }
        }
        for (place, key) in first.iter().enumerate() {
            may_change("list", key)?;
            if product.iter().any(|(other, _)| other == key) {
                return Err(format!(
                    "{key} is in [product] and in [[list]], allowed in one of them"
                ));
            }
            let values: Vec<Value> = list.iter().map(|changes| changes[place].1.clone()).collect();
            one_kind("list", key, &values)?;
        }
        if list.is_empty() {
            list.push(vec![]);
        }
        Ok(list)
    }
}

/// Refuses a change of a scene's key if the study itself has a key for it.
fn may_change(table: &str, key: &str) -> Result<(), String> {
    let place = match key {
        "velocity.estimator" => "the key `estimators` of the study",
        "wall_hit.felt_curve" => "the scene's own file",
        key if key.starts_with("sweep.") => "the key `cutoffs_hz` of the study",
        key if !key.contains('.') => "keys as TABLE.KEY, such as actuator.latency",
        _ => return Ok(()),
    };
    Err(format!("{table} has {key}, allowed for that: {place}"))
}

/// Refuses values of different kinds, because they share one column.
fn one_kind(table: &str, key: &str, values: &[Value]) -> Result<(), String> {
    let first = values.first().and_then(kind);
    match values.iter().find(|value| kind(value) != first || first.is_none()) {
        Some(value) => Err(format!(
            "{table}.{key} has {value}, allowed are numbers, texts, or true and false, all of one kind"
        )),
        None => Ok(()),
    }
}

/// The values below a table, each with its dotted key. The keys are in alphabetical order.
fn flat(name: &str, table: &Table) -> Result<Changes, String> {
    let mut leaves = vec![];
    flatten("", table, &mut leaves);
    leaves.sort_by(|(a, _), (b, _)| a.cmp(b));
    match leaves.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        Some(pair) => Err(format!("{name} has {} twice, allowed once", pair[0].0)),
        None => Ok(leaves),
    }
}

/// Adds the values below a table to `leaves`, each with its dotted key.
fn flatten(above: &str, table: &Table, leaves: &mut Changes) {
    for (key, value) in table {
        let key = if above.is_empty() { key.clone() } else { format!("{above}.{key}") };
        match value {
            Value::Table(table) => flatten(&key, table, leaves),
            other => leaves.push((key, other.clone())),
        }
    }
}
