//! Tables of the studies as columns of numpy's.

use std::borrow::Borrow;

use numpy::{Element, IntoPyArray as _};
use pyo3::{prelude::*, types::PyDict};
use sim_studies::table::{Cell, Column, Kind};

/// A column that becomes an array without a copy.
type Made = Box<dyn for<'py> FnOnce(Python<'py>) -> Bound<'py, PyAny> + Send>;

/// Long columns by name, in their order, made where the work is done: the interpreter only takes them.
#[derive(Default)]
pub struct Columns(Vec<(&'static str, Made)>);

impl Columns {
    /// With another column.
    pub fn with<T: Element + Send + 'static>(
        mut self,
        name: &'static str,
        values: impl IntoIterator<Item = T>,
    ) -> Self {
        let values: Vec<T> = values.into_iter().collect();
        self.0.push((name, Box::new(move |py| values.into_pyarray(py).into_any())));
        self
    }

    /// As a dictionary.
    pub fn into_dict(self, py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
        let made = PyDict::new(py);
        for (name, column) in self.0 {
            made.set_item(name, column(py))?;
        }
        Ok(made)
    }
}

/// Columns by name, in their order: arrays, and of texts lists. A number that there is not is NaN, a text empty.
pub fn columns<'py, C: Borrow<Column>>(
    py: Python<'py>,
    columns: impl IntoIterator<Item = C>,
    rows: &[Vec<Cell>],
) -> PyResult<Bound<'py, PyDict>> {
    let made = PyDict::new(py);
    for (n, column) in columns.into_iter().enumerate() {
        let Column { name, kind } = column.borrow();
        let cells = rows.iter().map(|row| &row[n]);
        match kind {
            Kind::Number => {
                let number =
                    |cell: &Cell| if let Cell::Number(value) = cell { *value } else { f64::NAN };
                made.set_item(name, cells.map(number).collect::<Vec<f64>>().into_pyarray(py))?;
            }
            Kind::Whole => {
                let whole = |cell: &Cell| if let Cell::Whole(value) = cell { *value } else { 0 };
                made.set_item(name, cells.map(whole).collect::<Vec<u64>>().into_pyarray(py))?;
            }
            Kind::Flag => {
                let flag = |cell: &Cell| matches!(cell, Cell::Flag(true));
                made.set_item(name, cells.map(flag).collect::<Vec<bool>>().into_pyarray(py))?;
            }
            Kind::Text => {
                let text = |cell: &Cell| match cell {
                    Cell::Text(text) | Cell::Quoted(text) => text.to_string(),
                    _ => String::new(),
                };
                made.set_item(name, cells.map(text).collect::<Vec<String>>())?;
            }
        }
    }
    Ok(made)
}

/// All columns of a table.
pub fn table<'py>(
    py: Python<'py>,
    table: &sim_studies::table::Table,
) -> PyResult<Bound<'py, PyDict>> {
    columns(py, &table.columns, &table.rows)
}
