//! Estimators beside each other, and what limits the walls of a scene.

use std::sync::Arc;

use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use sim_loop::scene::NamedScene;
use sim_studies::{
    analysis::{
        compare::{
            self as study, Entry, most_walks,
            peers::{PeerQuestion, compare_peers},
            search::Budget,
            table,
            usable::{self as commanded, UsableQuestion, UsableStudy},
            winners::winners,
        },
        explain as changed,
    },
    study::{
        asked,
        limits_asked::{LimitAsked, Names},
    },
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

/// Those that are named, each once; none where nobody names one.
fn entries_of(named: Option<&[String]>, scene: &NamedScene) -> PyResult<Option<Vec<Entry>>> {
    match named {
        Some([]) => Err(PyValueError::new_err("estimators is empty")),
        Some(named) => Entry::named(named, scene, "estimators").map(Some).map_err(raised),
        None => Ok(None),
    }
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
    let entries = entries_of(estimators.as_deref(), &scene)?;
    let entries = entries.unwrap_or_else(|| Entry::usual(&scene.scene));
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

const NAMES: Names = Names { limits: "limits", steps: "steps" };

/// A limit as Python has it: metres, or words as on the command line.
#[derive(FromPyObject)]
pub enum LimitGiven {
    Metres(f64),
    Words(String),
}

impl LimitGiven {
    fn asked(&self) -> PyResult<LimitAsked> {
        let asked = match self {
            Self::Metres(metres) => LimitAsked::parse(&metres.to_string()),
            Self::Words(words) => LimitAsked::parse(words),
        };
        asked.map_err(|line| PyValueError::new_err(format!("limits: {line}")))
    }
}

/// The defaults of other systems, untuned, beside the scene's own estimator.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of a function")]
pub fn peers<'py>(
    py: Python<'py>,
    scene: &Scene,
    limits: Vec<LimitGiven>,
    steps: Option<Vec<f64>>,
    repeat: u32,
    engine: &str,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (scene, engine) = (Arc::clone(&scene.0), engine_of(engine)?);
    in_range("repeat", repeat, 1..=1000)?;
    if limits.is_empty() {
        return Err(PyValueError::new_err("limits is empty"));
    }
    let limits = limits.iter().map(LimitGiven::asked).collect::<PyResult<Vec<_>>>()?;
    let two = |steps: Vec<f64>| {
        let refused = |steps: Vec<f64>| format!("steps has {} numbers, allowed 2", steps.len());
        <[f64; 2]>::try_from(steps).map_err(|steps| PyValueError::new_err(refused(steps)))
    };
    let steps = steps.map(two).transpose()?;
    let question = PeerQuestion::of(&scene, &limits, steps, repeat, NAMES).map_err(raised)?;
    let total = question.walks();
    let of_work = Arc::clone(&scene);
    let found = run(py, threads, progress, total, move |course| {
        asked::prepare(&of_work)?;
        compare_peers(engine, question, &course.stop, || course.add(1))
            .map_err(|error| error.of(&of_work.name))
    })?;
    let made = PyDict::new(py);
    made.set_item("table", columns::table(py, &found.table())?)?;
    let mut notes = found.notes;
    notes.extend(scene.scene.estimated_note());
    made.set_item("notes", notes)?;
    Ok(made)
}

/// Walls that are stable and rendered as commanded, each estimator tuned for each limit.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of a function")]
pub fn usable<'py>(
    py: Python<'py>,
    scene: &Scene,
    percents: Vec<f64>,
    estimators: Option<Vec<String>>,
    budget: u32,
    repeat: u32,
    engine: &str,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (scene, engine) = (Arc::clone(&scene.0), engine_of(engine)?);
    let budget = budget_of(budget, repeat, 1)?;
    if percents.is_empty() {
        return Err(PyValueError::new_err("percents is empty"));
    }
    let percents = commanded::percents(&percents, "percents").map_err(raised)?;
    let entries = entries_of(estimators.as_deref(), &scene)?;
    let entries = entries.unwrap_or_else(|| commanded::usual(&scene.scene));
    let question = UsableQuestion::of(entries, &percents, budget);
    let total = question.most_walks();
    let found = run(py, threads, progress, total, move |course| {
        asked::prepare(&scene)?;
        let done = |walks| course.add(walks);
        let found = commanded::usable(engine, &scene.scene, &question, &course.stop, done)
            .map_err(|error| error.of(&scene.name))?;
        Ok(UsableStudy { question, found })
    })?;
    let made = PyDict::new(py);
    made.set_item("table", columns::table(py, &found.table())?)?;
    Ok(made)
}
