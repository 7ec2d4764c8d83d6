//! Tables of results. The ending of a file selects its format: CSV, Parquet or MCAP.
//!
//! A command writes CSV. Other formats are converted from this text, so all formats have the same values. Parquet and
//! MCAP need the feature `open-files`.
//!
//! A column has 64-bit floats if the column is an area, or if its name ends in a unit other than a count. This rule
//! does not depend on the cells, so all parts of a study have one schema. For other columns the cells decide: 64-bit
//! integers if all cells are integers, floats if all cells are numbers, else text. An empty cell is null.

use std::path::Path;

use super::in_units::AREAS;
use crate::{error::Error, scene::schema::unit};

#[cfg(feature = "open-files")]
mod mcap;
#[cfg(feature = "open-files")]
mod parquet;

/// What the rows of a table are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Rows that have no order in time.
    Rows,
    /// Each row is one instant. Its time is the column `time_s`, or else the column `sample` divided by this rate in
    /// Hz.
    Moments { rate_hz: f64 },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Comma-separated values, as described in docs/files.md.
    Csv,
    /// Apache Parquet, one row group, compressed with Snappy.
    Parquet,
    /// MCAP with one JSON message for each row.
    Mcap,
}

impl Format {
    /// The format that the ending of a file selects. Every ending except `.parquet` and `.mcap` gives CSV.
    ///
    /// # Errors
    /// [`Error::Input`] if this build lacks the format, or if the format needs times and the table has none.
    pub fn of(path: &Path, kind: Kind) -> Result<Self, Error> {
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        let shown = path.display();
        let format = match ending {
            "parquet" => Self::Parquet,
            "mcap" if kind == Kind::Rows => {
                return Err(Error::Input(format!(
                    "{shown}: this table has no times, which MCAP wants; allowed endings are .csv and .parquet"
                )));
            }
            "mcap" => Self::Mcap,
            _ => Self::Csv,
        };
        format.is_there(&shown.to_string()).map(|()| format)
    }

    /// Checks that this build has the format. `what` names the option that needs the format.
    pub fn is_there(self, what: &str) -> Result<(), Error> {
        if self == Self::Csv || cfg!(feature = "open-files") {
            return Ok(());
        }
        Err(Error::Input(format!(
            "{what}: this build writes CSV only; cargo sim-files in place of cargo sim has the feature open-files"
        )))
    }
}

/// What a file needs to know about a table in addition to its rows.
#[derive(Clone, Debug)]
pub struct About {
    pub kind: Kind,
    pub manifest: String,
}

/// The bytes of a table in `format`.
///
/// # Errors
/// [`Error::Internal`] if a value cannot be written.
#[cfg(feature = "open-files")]
pub fn bytes(format: Format, csv: &str, about: &About) -> Result<Vec<u8>, Error> {
    let table = Table::of_csv(csv);
    let bytes = match format {
        Format::Csv => return Ok(csv.into()),
        Format::Parquet => {
            parquet::bytes(&table, &about.manifest).map_err(|error| error.to_string())
        }
        Format::Mcap => mcap::bytes(&table, about),
    };
    bytes.map_err(|error| Error::Internal(format!("cannot write the table: {error}")))
}

/// The bytes of a table as CSV. For other formats, [`Format::of`] has already returned an error.
#[cfg(not(feature = "open-files"))]
pub fn bytes(_: Format, csv: &str, _: &About) -> Result<Vec<u8>, Error> {
    Ok(csv.into())
}

/// Endings of column names that scene keys do not have. Each has a unit, and whether the values are whole numbers.
const UNITS: [(&str, &str, bool); 5] = [
    ("_fraction", "1", false),
    ("_counts", "counts", true),
    ("_samples", "samples", true),
    ("_q16", "2^-16 counts per sample", true),
    ("_q30", "2^-30 of full scale", true),
];

/// The cells of one column. An empty cell is `None`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cells {
    Integers(Vec<Option<i64>>),
    Numbers(Vec<Option<f64>>),
    Words(Vec<Option<String>>),
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Column {
    pub name: String,
    pub unit: Option<String>,
    pub cells: Cells,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    pub columns: Vec<Column>,
    pub rows: usize,
}

#[cfg_attr(
    not(feature = "open-files"),
    allow(dead_code, reason = "CSV stays as it is; tests use it")
)]
impl Table {
    pub fn of_csv(text: &str) -> Self {
        let mut lines = text.lines();
        let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        let mut cells = vec![vec![]; names.len()];
        let mut rows = 0;
        for line in lines {
            rows += 1;
            let mut values = line.split(',');
            for column in &mut cells {
                column.push(values.next().unwrap_or_default());
            }
        }
        let columns = names.into_iter().zip(cells).map(|(name, cells)| Column::of(name, &cells));
        Self { columns: columns.collect(), rows }
    }
}

impl Column {
    fn of(name: &str, cells: &[&str]) -> Self {
        let known = UNITS.iter().find(|(end, ..)| name.ends_with(end));
        let (unit, is_real) = match known {
            Some(&(_, unit, whole)) => (Some(unit.to_owned()), !whole),
            None => {
                let unit = name.contains('_').then(|| unit(name)).flatten();
                let is_real = unit.is_some() || AREAS.contains(&name);
                (unit, is_real)
            }
        };
        let integers = if is_real { None } else { all(cells, |cell| cell.parse().ok()) };
        let cells = match integers {
            Some(integers) => Cells::Integers(integers),
            None => match all(cells, |cell| cell.parse().ok()) {
                Some(numbers) => Cells::Numbers(numbers),
                None => Cells::Words(all(cells, |cell| Some(cell.to_owned())).unwrap_or_default()),
            },
        };
        Self { name: name.to_owned(), unit, cells }
    }
}

/// Converts all cells. Returns `None` if a cell is not empty and cannot be converted.
fn all<T>(cells: &[&str], read: impl Fn(&str) -> Option<T>) -> Option<Vec<Option<T>>> {
    let read = |cell: &&str| if cell.is_empty() { Some(None) } else { read(cell).map(Some) };
    cells.iter().map(read).collect()
}

#[cfg(test)]
mod tests;
