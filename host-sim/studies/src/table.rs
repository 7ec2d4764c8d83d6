//! A result as a table. Each column has one kind of value. The table is written as CSV, and Python gets it as arrays.

use std::{borrow::Cow, fmt::Write as _};

use serde::{Serialize, Serializer};

/// What kind of values a column has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Number,
    Whole,
    Text,
    Flag,
}

/// One value. A cell of any column may be empty.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    Empty,
    Number(f64),
    Whole(u64),
    Text(Cow<'static, str>),
    /// A text that is always quoted, such as a sentence with commas.
    Quoted(Cow<'static, str>),
    Flag(bool),
}

impl From<f64> for Cell {
    fn from(value: f64) -> Self {
        Self::Number(value)
    }
}

impl From<bool> for Cell {
    fn from(value: bool) -> Self {
        Self::Flag(value)
    }
}

impl From<&'static str> for Cell {
    fn from(value: &'static str) -> Self {
        Self::Text(value.into())
    }
}

impl From<String> for Cell {
    fn from(value: String) -> Self {
        Self::Text(value.into())
    }
}

impl Cell {
    pub fn count(value: usize) -> Self {
        Self::Whole(value as u64)
    }

    /// A cell with a text. It is empty for `None`.
    pub fn text(value: Option<&'static str>) -> Self {
        value.map_or(Self::Empty, Self::from)
    }

    /// A cell with a number. It is empty for `None`.
    pub fn number(value: Option<f64>) -> Self {
        value.map_or(Self::Empty, Self::Number)
    }
}

impl Serialize for Cell {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Empty => serializer.serialize_none(),
            Self::Number(value) => serializer.serialize_f64(*value),
            Self::Whole(value) => serializer.serialize_u64(*value),
            Self::Text(text) | Self::Quoted(text) => serializer.serialize_str(text),
            Self::Flag(value) => serializer.serialize_bool(*value),
        }
    }
}

/// A column for rows of type `R`: its name, its kind, and the function from a row to its cell.
pub type Told<R> = (&'static str, Kind, fn(&R) -> Cell);

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Name of the column. It ends in the unit.
    pub name: String,
    pub kind: Kind,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    pub columns: Vec<Column>,
    /// The rows. Each has a cell for every column.
    pub rows: Vec<Vec<Cell>>,
}

/// The cells as a line of CSV, with the line end. A text with a comma, a quote or a line end is quoted.
pub fn csv_line(cells: &[Cell]) -> String {
    let mut text = String::new();
    for (n, cell) in cells.iter().enumerate() {
        if n > 0 {
            text.push(',');
        }
        let _ = match cell {
            Cell::Empty => Ok(()),
            Cell::Number(value) => write!(text, "{value}"),
            Cell::Whole(value) => write!(text, "{value}"),
            Cell::Flag(value) => write!(text, "{value}"),
            Cell::Text(value) if !value.contains([',', '"', '\n', '\r']) => {
                write!(text, "{value}")
            }
            Cell::Text(value) | Cell::Quoted(value) => {
                write!(text, "\"{}\"", value.replace('"', "\"\""))
            }
        };
    }
    text.push('\n');
    text
}

impl Table {
    pub fn new<N: Into<String>>(columns: impl IntoIterator<Item = (N, Kind)>) -> Self {
        let column = |(name, kind): (N, Kind)| Column { name: name.into(), kind };
        Self { columns: columns.into_iter().map(column).collect(), rows: vec![] }
    }

    pub fn of<R>(columns: &[Told<R>], rows: &[R]) -> Self {
        let mut table = Self::new(columns.iter().map(|(name, kind, _)| (*name, *kind)));
        let cells = |row: &R| columns.iter().map(|(.., cell)| cell(row)).collect();
        table.rows = rows.iter().map(cells).collect();
        table
    }

    pub fn csv(&self) -> String {
        let names = self.columns.iter().map(|column| Cell::Text(column.name.clone().into()));
        let mut text = csv_line(&names.collect::<Vec<_>>());
        for row in &self.rows {
            text.push_str(&csv_line(row));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_that_would_break_a_row_are_quoted() {
        let column = |name: &str, kind| Column { name: name.into(), kind };
        let table = Table {
            columns: vec![column("a,b", Kind::Text), column("c", Kind::Number)],
            rows: vec![
                vec![Cell::Text("x\"y\n".into()), Cell::Number(0.1)],
                vec![Cell::Empty, Cell::Empty],
                vec![Cell::Quoted("z".into()), Cell::Empty],
            ],
        };
        assert_eq!(table.csv(), "\"a,b\",c\n\"x\"\"y\n\",0.1\n,\n\"z\",\n");
    }
}
