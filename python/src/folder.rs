//! A study whose results are in a folder. Any machine can run units of it. Only this process writes the results.

use std::{path::PathBuf, sync::Arc};

use host_sim::output::study::{Folder, Part};
use pyo3::{exceptions::PyValueError, prelude::*};
use sim_loop::simulation::prepared::Numeric;
use sim_studies::study::{
    How,
    planned::{Study, StudyFile},
};

use crate::{
    result::Asked,
    studies::{engine_of, numeric_of},
    study::text_of,
    work::{raised, run},
};

/// Text of a study, its name in errors, and the folder of its scenes. A worker needs all three to read the study again.
#[pyfunction]
pub fn study_text(py: Python<'_>, study: Asked) -> PyResult<(String, String, PathBuf)> {
    text_of(study.0.bind(py))
}

/// A study that was read and checked, with its units.
#[pyclass(frozen, module = "zwidth._native")]
pub struct StudyUnits {
    study: Arc<Study>,
    /// The study's name in errors. It is the path of the study's file if the study was read from a file.
    origin: PathBuf,
}

#[pymethods]
impl StudyUnits {
    #[new]
    fn new(py: Python<'_>, text: String, origin: &str, folder: PathBuf) -> PyResult<Self> {
        let file = StudyFile::parse(text, origin, &folder).map_err(raised)?;
        let study = run(py, None, None, 0, move |_| Study::new(file))?;
        Ok(Self { study: Arc::new(study), origin: origin.into() })
    }

    /// Runs a unit. Returns the unit's key, its part of the result, and the part's numbers of rows and hits.
    fn make(
        &self,
        py: Python<'_>,
        unit: u64,
        engine: &str,
        numeric: &str,
        threads: Option<usize>,
    ) -> PyResult<(String, String, u64, u64)> {
        let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
        if unit >= self.study.units {
            let last = self.study.units.saturating_sub(1);
            return Err(PyValueError::new_err(format!("unit is {unit}, allowed 0 to {last}")));
        }
        let study = Arc::clone(&self.study);
        let Part { csv, rows, hits } = run(py, threads, None, 0, move |course| {
            let made = study.run(unit, How { engine, numeric, stop: &course.stop })?;
            Ok(Part::from(&made))
        })?;
        Ok((self.study.unit_key(unit, numeric), csv, rows, hits))
    }
}

/// The folder of a study, as `cargo sim study --out` writes it. Only one process at a time may use the folder.
#[pyclass(module = "zwidth._native")]
pub struct StudyFolder {
    #[pyo3(get)]
    measure: &'static str,
    #[pyo3(get)]
    points: u64,
    #[pyo3(get)]
    units: u64,
    /// Key of the study.
    #[pyo3(get)]
    key: String,
    study: Arc<Study>,
    numeric: Numeric,
    folder: Option<Folder>,
}

#[pymethods]
impl StudyFolder {
    #[new]
    fn new(units: Py<StudyUnits>, out: PathBuf, resume: bool, numeric: &str) -> PyResult<Self> {
        let numeric = numeric_of(numeric)?;
        let StudyUnits { study, origin } = units.get();
        let mut inputs = study.files.clone();
        inputs.extend(origin.exists().then(|| origin.clone()));
        let folder = Folder::open(&out, study, numeric, resume, &inputs).map_err(raised)?;
        Ok(Self {
            measure: study.file.keys.measure.name(),
            points: study.points,
            units: study.units,
            key: study.key(numeric),
            study: Arc::clone(study),
            numeric,
            folder: Some(folder),
        })
    }

    /// Numbers of the units whose parts are not in the folder yet.
    fn missing(&self) -> PyResult<Vec<u64>> {
        let done = self.open()?.done();
        Ok((0..self.units).filter(|unit| !done.contains_key(unit)).collect())
    }

    /// Writes the part of a unit and adds the part to the manifest.
    fn add(&mut self, unit: u64, key: &str, csv: String, rows: u64, hits: u64) -> PyResult<()> {
        let own = self.study.unit_key(unit, self.numeric);
        if own != key {
            return Err(PyValueError::new_err(format!(
                "unit {unit} was made of another study or by another program: install the same zwidth everywhere"
            )));
        }
        let folder = self.folder.as_mut().ok_or_else(closed)?;
        folder.add(unit, own, &Part { csv, rows, hits }).map_err(raised)
    }

    /// Sorts the manifest. Returns the sums of rows, hits and bytes over all parts.
    fn finish(&mut self) -> PyResult<(u64, u64, u64)> {
        let done = self.folder.take().ok_or_else(closed)?.finish().map_err(raised)?;
        Ok(done.values().fold((0, 0, 0), |(rows, hits, bytes), entry| {
            (rows + entry.rows, hits + entry.hits, bytes + entry.bytes)
        }))
    }
}

impl StudyFolder {
    fn open(&self) -> PyResult<&Folder> {
        self.folder.as_ref().ok_or_else(closed)
    }
}

fn closed() -> PyErr {
    PyValueError::new_err("the folder of this study is finished")
}
