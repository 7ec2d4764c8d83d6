//! Tables of the studies as columns of numpy's.

use std::borrow::Borrow;

use numpy::IntoPyArray as _;
use pyo3::{prelude::*, types::PyDict};
use sim_studies::table::{Cell, Column, Kind};

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
                let text = |cell: &Cell| {
                    if let Cell::Text(text) = cell { text.to_string() } else { String::new() }
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
