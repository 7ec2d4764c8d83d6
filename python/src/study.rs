//! Studies of many points.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering::Relaxed},
};

use pyo3::{
    exceptions::{PyRuntimeError, PyValueError},
    prelude::*,
    types::PyDict,
};
use sim_loop::{error::Error, input};
use sim_studies::study::planned::{Study, StudyFile, unit::How};

use crate::{
    columns::columns,
    scene::of_python,
    studies::{engine_of, numeric_of},
    work::{raised, run},
};

/// Text of a study, what errors call it, and the folder of its scenes: of a dictionary with the keys of a study's file, or
/// of the file at a path.
pub fn text_of(asked: &Bound<'_, PyAny>) -> PyResult<(String, String, PathBuf)> {
    if asked.cast::<PyDict>().is_ok() {
        let text = toml::to_string(&of_python(asked)?);
        let text = text.map_err(|error| PyValueError::new_err(error.to_string()))?;
        return Ok((text, "study".into(), PathBuf::new()));
    }
    let path = asked.extract::<PathBuf>()?;
    let text = input::read_text(&path, input::STUDY).map_err(raised)?;
    let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
    Ok((text, path.display().to_string(), folder))
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
    let (text, origin, folder) = text_of(study)?;
    let file = StudyFile::parse(text, &origin, &folder).map_err(raised)?;
    let study = Arc::new(run(py, threads, None, 0, move |_| Study::new(file))?);
    let of_work = Arc::clone(&study);
    let (rows, hits) = run(py, threads, progress, study.units, move |course| {
        let study = of_work;
        let how = How { engine, numeric, stop: &course.stop };
        let (mut rows, mut hits) = (vec![], 0);
        for unit in 0..study.units {
            if course.stop.load(Relaxed) {
                return Err(Error::Interrupted);
            }
            let made = study.run(unit, how)?;
            rows.extend(made.table.rows);
            hits += made.hits;
            course.add(1);
        }
        Ok((rows, hits))
    })?;
    let first = study.blocks.first();
    let first = first.ok_or_else(|| PyRuntimeError::new_err("a study has no scene"))?;
    let columns = columns(py, study.columns(first), &rows)?;
    let made = PyDict::new(py);
    made.set_item("measure", study.file.measure.name())?;
    made.set_item("points", study.points)?;
    made.set_item("units", study.units)?;
    made.set_item("hits", hits)?;
    made.set_item("columns", columns)?;
    Ok(made)
}
