//! Runs studies with many points.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering::Relaxed},
};

use pyo3::{
    exceptions::{PyRuntimeError, PyValueError},
    prelude::*,
    types::{PyDict, PyMapping},
};
use sim_loop::{error::Error, input};
use sim_studies::study::{
    How,
    planned::{Study as Planned, StudyFile},
};

use crate::{
    given::Progress,
    result::{Asked, Table, result},
    scene::of_python,
    studies::{engine_of, numeric_of},
    work::{raised, run},
};

/// Text of a study, its name in errors, and the folder of its scenes. `asked` is the path of a study's file, or a
/// dictionary with the keys of such a file.
pub fn text_of(asked: &Bound<'_, PyAny>) -> PyResult<(String, String, PathBuf)> {
    if let Ok(keys) = asked.cast::<PyMapping>() {
        let own = PyDict::new(asked.py());
        own.update(keys)?;
        let text = toml::to_string(&of_python(&own)?);
        let text = text.map_err(|error| PyValueError::new_err(error.to_string()))?;
        return Ok((text, "study".into(), PathBuf::new()));
    }
    let path = asked.extract::<PathBuf>()?;
    let text = input::read_text(&path, input::STUDY).map_err(raised)?;
    let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
    Ok((text, path.display().to_string(), folder))
}

result! { table(table)
    /// The results of a study.
    Study {
        /// What is measured at each point: `walk`, `hit` or `sweep`.
        measure: String,
        /// Number of the study's points.
        points: u64,
        /// Number of the study's units.
        units: u64,
        /// Number of hits that all points needed.
        hits: u64,
        /// The results in the order of the points. The columns are those of the command line's parts. A hit or a walk
        /// has one row per point. A sweep has one row per cutoff of a point.
        table: Table,
    }
}

/// Walk, hit or sweep at every point of a product or list. The results stay in memory: no folder is written.
///
/// Parameters
/// ----------
/// study : path or mapping
///     The path of a study's file, or its keys: `measure`, `scenes` (names and paths), `product`, `list` and others.
/// engine, numeric, threads
///     As in `walk`.
/// progress : callable, optional
///     Called from this thread with the number of finished units and the number of all units. An exception in this
///     function ends the study.
///
/// Raises
/// ------
/// ValueError
///     A key, a value or a scene with its changes is wrong. The message gives the wrong item and what is allowed.
///
/// Examples
/// --------
/// >>> made = study(
/// ...     {
/// ...         "measure": "hit",
/// ...         "scenes": ["paper-2um"],
/// ...         "cutoffs_hz": [500],
/// ...         "stiffnesses": [10e3, 40e3],
/// ...         "dampings": [100],
/// ...         "product": {"actuator.latency": [5, 20]},
/// ...     }
/// ... )
/// >>> made.points, made.table["actuator.latency"].tolist()
/// (4, [5.0, 5.0, 20.0, 20.0])
/// >>> made.table["verdict"].tolist()
/// ['stable', 'stable', 'stable', 'unstable']
#[pyfunction]
#[pyo3(signature = (study, *, engine = "lanes", numeric = "fixed", threads = None, progress = None))]
pub fn study(
    py: Python<'_>,
    study: Asked,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Study> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let (text, origin, folder) = text_of(study.0.bind(py))?;
    let file = StudyFile::parse(text, &origin, &folder).map_err(raised)?;
    let study = Arc::new(run(py, threads, None, 0, move |_| Planned::new(file))?);
    let of_work = Arc::clone(&study);
    let (rows, hits) = run(py, threads, progress.as_ref(), study.units, move |course| {
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
    Ok(Study {
        measure: study.file.keys.measure.name().into(),
        points: study.points,
        units: study.units,
        hits,
        table: Table::of_rows(py, study.columns(first), &rows)?,
    })
}
