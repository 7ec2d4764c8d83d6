//! Estimators beside each other, and what limits the walls of a scene.

use std::sync::Arc;

use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use sim_studies::{
    analysis::{
        compare::{self as study, Entry, most_walks, search::Budget, table, winners::winners},
        explain as changed,
    },
    study::asked,
    table::{Kind, Table},
};

use crate::{
    columns,
    scene::{Scene, serialized},
    studies::{engine_of, in_range},
    work::{raised, run},
};

/// What a search may cost, checked as the command line does.
fn budget_of(tunings: u32, repeats: u32, fewest_repeats: u32) -> PyResult<Budget> {
    in_range("budget", tunings, 3..=1000)?;
    in_range("repeat", repeats, fewest_repeats..=1000)?;
    Ok(Budget { tunings, repeats })
}

/// Every estimator, tuned by the same search.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of a function")]
pub fn compare<'py>(
    py: Python<'py>,
    scene: &Scene,
    estimators: Option<Vec<String>>,
    damping: Option<f64>,
    budget: u32,
    repeat: u32,
    engine: &str,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (scene, engine) = (Arc::clone(&scene.0), engine_of(engine)?);
    let budget = budget_of(budget, repeat, 1)?;
    let entries = match estimators {
        Some(named) if named.is_empty() => {
            return Err(PyValueError::new_err("estimators is empty"));
        }
        named => Entry::named(&named.unwrap_or_default(), &scene, "estimators").map_err(raised)?,
    };
    if let Some(damping) = damping {
        asked::check_read_off(&scene, damping, "damping").map_err(raised)?;
    }
    let total = most_walks(&entries, budget);
    let of_work = Arc::clone(&scene);
    let (place, compared) = run(py, threads, progress, total, move |course| {
        asked::prepare(&of_work)?;
        let (scene, done) = (&of_work.scene, |walks| course.add(walks));
        study::compare(engine, scene, &entries, damping, budget, &course.stop, done)
    })?;
    let mut walls =
        Table::new([("stiffness_n_per_m", Kind::Number), ("damping_n_s_per_m", Kind::Number)]);
    for wall in place.walls {
        walls.rows.push(vec![wall.stiffness_n_per_m.into(), wall.damping_n_s_per_m.into()]);
    }
    let mut notes = table::notes(&compared, &place, scene.scene.units);
    notes.extend(scene.scene.estimated_note());
    let made = PyDict::new(py);
    for (name, table) in [
        ("table", table::table(&compared, &place)),
        ("tunings", table::tunings(&compared)),
        ("boundaries", table::boundaries(&compared)),
        ("fidelity", table::fidelities(&compared)),
        ("walls", walls),
    ] {
        made.set_item(name, columns::table(py, &table)?)?;
    }
    made.set_item("damping_n_s_per_m", place.middle().damping_n_s_per_m)?;
    made.set_item("stiffness_n_per_m", place.middle().stiffness_n_per_m)?;
    made.set_item("true_velocity_area_n2_s_per_m2", place.told_area)?;
    let of_loop = compared.first().map(|first| first.fidelity.of_loop);
    made.set_item("impedance_error_of_loop", of_loop)?;
    let winners = winners(&compared, &place);
    let winners = winners.iter().map(|winner| serialized(py, winner));
    made.set_item("winners", winners.collect::<PyResult<Vec<_>>>()?)?;
    made.set_item("notes", notes)?;
    Ok(made)
}

/// One element changed at a time, each tuned anew.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of a function")]
pub fn explain<'py>(
    py: Python<'py>,
    scene: &Scene,
    damping: Option<f64>,
    budget: u32,
    repeat: u32,
    engine: &str,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (scene, engine) = (Arc::clone(&scene.0), engine_of(engine)?);
    let budget = budget_of(budget, repeat, 2)?;
    if let Some(damping) = damping {
        asked::check_read_off(&scene, damping, "damping").map_err(raised)?;
    }
    let total = changed::most_walks(&scene.scene, budget);
    let found = run(py, threads, progress, total, move |course| {
        asked::prepare(&scene)?;
        let done = |walks| course.add(walks);
        changed::explain(engine, &scene.scene, damping, budget, &course.stop, done)
            .map_err(|error| error.of(&scene.name))
    })?;
    let made = PyDict::new(py);
    made.set_item("table", columns::table(py, &found.table())?)?;
    made.set_item("boundaries", columns::table(py, &found.boundaries())?)?;
    made.set_item("damping_n_s_per_m", found.damping_n_s_per_m)?;
    made.set_item("answers", found.answers())?;
    Ok(made)
}
