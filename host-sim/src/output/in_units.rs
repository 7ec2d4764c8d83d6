//! Converts results to the units of their scene, for example to rad and N m for a rotary scene. Within the program all
//! values are in m and N. The names of columns and keys end in their unit, so one conversion is enough for all results.

use std::fmt::{self, Write as _};

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{MapAccess, Visitor},
    ser::Error as _,
};
use serde_json::Number;

use crate::scene::Units;

/// Columns of areas, as tables of version 1 name them. The names have no unit.
pub(super) const AREAS: [&str; 3] = ["area", "area_low", "area_high"];
const AREA: &str = "area_n2_s_per_m2";

/// Columns of a table that is written row by row.
#[derive(Clone, Debug)]
pub struct Columns {
    pub header: String,
    /// Factor for the numbers of each column. `None` if the numbers do not change.
    factors: Vec<Option<f64>>,
}

impl Columns {
    pub fn new(units: Units, header: &str) -> Self {
        let column = |name: &str| match units.key(if AREAS.contains(&name) { AREA } else { name }) {
            Some((_, factor)) if AREAS.contains(&name) => (name.to_owned(), Some(factor)),
            Some((renamed, factor)) => (renamed, Some(factor)),
            None => (name.to_owned(), None),
        };
        let (names, factors): (Vec<_>, Vec<_>) = header.trim_end().split(',').map(column).unzip();
        let end = &header[header.trim_end().len()..];
        Self { header: names.join(",") + end, factors }
    }

    /// Converts a row, with or without a line end.
    pub fn row(&self, row: &str) -> String {
        let mut quoted = false;
        let ends = |c| {
            quoted ^= c == '"';
            c == ',' && !quoted
        };
        let cells = row.split(ends).enumerate().map(|(n, cell)| {
            let factor = self.factors.get(n).copied().flatten();
            let value = cell.trim_end().parse::<f64>();
            match (factor, value) {
                (Some(factor), Ok(value)) => {
                    let end = &cell[cell.trim_end().len()..];
                    format!("{}{end}", Units::told(value, factor))
                }
                _ => cell.to_owned(),
            }
        });
        cells.collect::<Vec<_>>().join(",")
    }
}

pub fn csv(units: Units, table: String) -> String {
    if !units.is_rotary() {
        return table;
    }
    let mut lines = table.lines();
    let columns = Columns::new(units, lines.next().unwrap_or_default());
    let mut text = columns.header.clone() + "\n";
    for line in lines {
        let _ = writeln!(text, "{}", columns.row(line));
    }
    text
}

/// A value that is written as JSON in these units.
#[derive(Clone, Copy, Debug)]
pub struct InUnits<T>(pub Units, pub T);

impl<T: Serialize> Serialize for InUnits<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if !self.0.is_rotary() {
            return self.1.serialize(serializer);
        }
        let text = serde_json::to_string(&self.1).map_err(S::Error::custom)?;
        let value: Ordered = serde_json::from_str(&text).map_err(S::Error::custom)?;
        value.told(self.0, None).serialize(serializer)
    }
}

/// JSON that keeps the order of its keys.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Ordered {
    Plain(Option<bool>),
    Number(Number),
    Text(String),
    List(Vec<Ordered>),
    Table(Pairs),
}

struct Pairs(Vec<(String, Ordered)>);

impl Ordered {
    /// Converts keys and numbers to these units. `factor` is the factor for the key of this value.
    fn told(self, units: Units, factor: Option<f64>) -> Self {
        match (self, factor) {
            (Self::Number(number), Some(factor)) => {
                let told = number.as_f64().map(|value| Units::told(value, factor));
                Self::Number(told.and_then(Number::from_f64).unwrap_or(number))
            }
            (Self::List(values), factor) => {
                Self::List(values.into_iter().map(|value| value.told(units, factor)).collect())
            }
            (Self::Table(Pairs(pairs)), factor) => {
                let told = |(key, value): (String, Self)| match units.key(&key) {
                    Some((renamed, factor)) => (renamed, value.told(units, Some(factor))),
                    // the ends of an interval have the unit of the key above them
                    None => (key, value.told(units, factor)),
                };
                Self::Table(Pairs(pairs.into_iter().map(told).collect()))
            }
            (other, _) => other,
        }
    }
}

impl Serialize for Pairs {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(key, value)| (key, value)))
    }
}

impl<'de> Deserialize<'de> for Pairs {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct InOrder;
        impl<'de> Visitor<'de> for InOrder {
            type Value = Pairs;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Pairs, A::Error> {
                let mut pairs = vec![];
                while let Some(pair) = map.next_entry()? {
                    pairs.push(pair);
                }
                Ok(Pairs(pairs))
            }
        }
        deserializer.deserialize_map(InOrder)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PADDLE: Units = Units::Rotary { radius_m: 0.25 };

    #[test]
    fn tables_change_their_columns_and_numbers_and_nothing_else() {
        let table = "cutoff_hz,stiffness_n_per_m,area,name\n1500,1600,256,a\n,inf,,b\n";
        let told = "cutoff_hz,stiffness_n_m_per_rad,area,name\n1500,100,1,a\n,inf,,b\n";
        assert_eq!(csv(PADDLE, table.into()), told);
        assert_eq!(csv(Units::Linear, table.into()), table);
        let quoted = "does,stiffness_n_per_m\n\"a, b, \"\"c,\"\"\",1600\n";
        assert_eq!(
            csv(PADDLE, quoted.into()),
            quoted.replace("_n_per_m", "_n_m_per_rad").replace("1600", "100")
        );
    }

    #[test]
    fn objects_keep_the_order_of_their_keys() {
        #[derive(Serialize)]
        struct Inner {
            push_n: Option<f64>,
            further_n_per_m: Vec<(f64, f64)>,
        }
        #[derive(Serialize)]
        struct Outer {
            z: u64,
            #[serde(flatten)]
            inner: Inner,
            a: f64,
        }
        let value = Outer {
            z: 3,
            inner: Inner { push_n: None, further_n_per_m: vec![(16.0, 32.0)] },
            a: 0.1,
        };
        let text = |units| serde_json::to_string(&InUnits(units, &value)).unwrap();
        let plain = r#"{"z":3,"push_n":null,"further_n_per_m":[[16.0,32.0]],"a":0.1}"#;
        assert_eq!(text(Units::Linear), plain);
        let told = r#"{"z":3,"push_n_m":null,"further_n_m_per_rad":[[1.0,2.0]],"a":0.1}"#;
        assert_eq!(text(PADDLE), told);
    }
}
