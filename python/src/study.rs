//! Studies of many points.

use std::{path::Path, sync::atomic::Ordering::Relaxed};

use numpy::IntoPyArray as _;
use pyo3::{
    exceptions::{PyRuntimeError, PyValueError},
    prelude::*,
    types::PyDict,
};
use sim_loop::error::Error;
use sim_studies::study::planned::{
    Study, StudyFile,
    table::{Cell, Kind},
    unit::How,
};

use crate::{
    scene::of_python,
    studies::{engine_of, numeric_of},
    work::{raised, run},
};

/// The study of a dictionary with the keys of a study's file, or of the file at a path.
fn file_of(asked: &Bound<'_, PyAny>) -> PyResult<StudyFile> {
    if asked.cast::<PyDict>().is_ok() {
        let text = toml::to_string(&of_python(asked)?);
        let text = text.map_err(|error| PyValueError::new_err(error.to_string()))?;
        return StudyFile::parse(text, "study", Path::new("")).map_err(raised);
    }
    StudyFile::load(&asked.extract::<std::path::PathBuf>()?).map_err(raised)
}

/// Every point of a study.
#[pyfunction]
pub fn study<'py>(
    py: Python<'py>,
    study: &Bound<'py, PyAny>,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let file = file_of(study)?;
    let study = run(py, threads, None, 0, |_| Study::new(file))?;
    let (rows, hits) = run(py, threads, progress, study.units, |course| {
        let how = How { engine, numeric, stop: course.stop };
        let (mut rows, mut hits) = (vec![], 0);
        for unit in 0..study.units {
            if course.stop.load(Relaxed) {
                return Err(Error::Interrupted);
            }
            let made = study.run(unit, how)?;
            rows.extend(made.table.rows);
            hits += made.hits;
            course.done.fetch_add(1, Relaxed);
        }
        Ok((rows, hits))
    })?;
    let columns = PyDict::new(py);
    let first = study.blocks.first();
    let first = first.ok_or_else(|| PyRuntimeError::new_err("a study has no scene"))?;
    for (n, column) in study.columns(first).into_iter().enumerate() {
        let cells = rows.iter().map(|row| &row[n]);
        match column.kind {
            Kind::Number => {
                let number =
                    |cell: &Cell| if let Cell::Number(value) = cell { *value } else { f64::NAN };
                columns.set_item(
                    column.name,
                    cells.map(number).collect::<Vec<f64>>().into_pyarray(py),
                )?;
            }
            Kind::Whole => {
                let whole = |cell: &Cell| if let Cell::Whole(value) = cell { *value } else { 0 };
                columns.set_item(
                    column.name,
                    cells.map(whole).collect::<Vec<u64>>().into_pyarray(py),
                )?;
            }
            Kind::Flag => {
                let flag = |cell: &Cell| matches!(cell, Cell::Flag(true));
                columns.set_item(
                    column.name,
                    cells.map(flag).collect::<Vec<bool>>().into_pyarray(py),
                )?;
            }
            Kind::Text => {
                let text = |cell: &'_ Cell| {
                    if let Cell::Text(text) = cell { text.to_string() } else { String::new() }
                };
                columns.set_item(column.name, cells.map(text).collect::<Vec<String>>())?;
            }
        }
    }
    let made = PyDict::new(py);
    made.set_item("measure", study.file.measure.name())?;
    made.set_item("points", study.points)?;
    made.set_item("units", study.units)?;
    made.set_item("hits", hits)?;
    made.set_item("columns", columns)?;
    Ok(made)
}
