//! What was measured on a device: records that identify it, walks beside those of a scene, estimators
//! over a capture.

use std::{path::PathBuf, sync::Arc};

use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use sim_loop::{error::Error, scene::Units};
use sim_studies::analysis::{
    agree as walks,
    identify::{self as records, Asked, GainAsked, Json, Made, Planned, Record, Span, Term, Terms},
    replay as counts,
};

use crate::{
    columns::{self, Columns},
    scene::{Scene, serialized},
    studies::engine_of,
    work::{Course, raised, run},
};

/// What the studies call an option of `identify`, and its argument here.
const ARGUMENTS: [(&str, &str); 15] = [
    ("--no-spring", "spring=False"),
    ("--torque-constant", "torque_constant"),
    ("--amplifier-gain", "amplifier_gain"),
    ("--drum-radius", "drum_radius"),
    ("--calibration-mass", "calibration_mass"),
    ("--calibration-voltage", "calibration_voltage"),
    ("--added-mass", "added_mass"),
    ("--fit-latency", "fit_latency"),
    ("--latency", "latency"),
    ("--rest-position", "rest_position"),
    ("--encoder-cycle", "encoder_cycle"),
    ("--resolution", "resolution"),
    ("--gain", "gain"),
    ("--from", "from"),
    ("--to", "to"),
];

/// A line of the studies with the names of arguments.
fn with_arguments(line: &str) -> String {
    ARGUMENTS.iter().fold(line.to_owned(), |line, (option, name)| line.replace(option, name))
}

/// The error with them.
fn here(error: Error) -> Error {
    match error {
        Error::Input(line) => Error::Input(with_arguments(&line)),
        other => other,
    }
}

fn terms_of(names: &[String]) -> PyResult<Terms> {
    match names {
        [one] if one == "auto" => return Ok(Terms::Auto),
        [one] if one == "none" => return Ok(Terms::NONE),
        _ => {}
    }
    let all = Term::ALL.map(Term::name);
    if let Some(other) = names.iter().find(|name| !all.contains(&name.as_str())) {
        return Err(PyValueError::new_err(format!(
            "terms has {other:?}, allowed auto or none alone, or some of {}",
            all.join(", ")
        )));
    }
    let has = |term: Term| names.iter().any(|name| name == term.name());
    Ok(Terms::These {
        friction: has(Term::Friction),
        amplifier: has(Term::Amplifier),
        offset: has(Term::Offset),
        phase: has(Term::Phase),
    })
}

/// What is asked of records, as `zwidth.identify` has it.
#[derive(FromPyObject)]
pub struct IdentifyAsked {
    #[pyo3(item)]
    gain: Option<f64>,
    #[pyo3(item)]
    torque_constant: Option<f64>,
    #[pyo3(item)]
    amplifier_gain: Option<f64>,
    #[pyo3(item)]
    drum_radius: Option<f64>,
    #[pyo3(item)]
    calibration_mass: Option<f64>,
    #[pyo3(item)]
    calibration_voltage: Option<f64>,
    #[pyo3(item)]
    added_mass: Option<f64>,
    #[pyo3(item)]
    latency: Option<f64>,
    #[pyo3(item)]
    fit_latency: bool,
    #[pyo3(item)]
    spring: bool,
    #[pyo3(item)]
    terms: Vec<String>,
    #[pyo3(item)]
    rest_position: Option<f64>,
    #[pyo3(item)]
    encoder_cycle: Option<f64>,
    #[pyo3(item)]
    resolution: Option<f64>,
    #[pyo3(item)]
    span: (Option<f64>, Option<f64>),
}

impl IdentifyAsked {
    fn gain(&self) -> GainAsked {
        GainAsked {
            gain: self.gain,
            torque_constant: self.torque_constant,
            amplifier_gain: self.amplifier_gain,
            drum_radius: self.drum_radius,
            calibration_mass: self.calibration_mass,
            calibration_voltage: self.calibration_voltage,
            added_mass: self.added_mass,
        }
    }

    fn asked(&self) -> PyResult<Asked> {
        Ok(Asked {
            latency: self.latency,
            fit_latency: self.fit_latency,
            spring: self.spring,
            terms: terms_of(&self.terms)?,
            rest_position: self.rest_position,
            encoder_cycle: self.encoder_cycle,
            resolution: self.resolution,
            span: Span { from_s: self.span.0, to_s: self.span.1 },
        })
    }
}

/// The device of records.
#[pyfunction]
pub fn identify<'py>(
    py: Python<'py>,
    logs: Vec<PathBuf>,
    base: &Scene,
    asked: IdentifyAsked,
) -> PyResult<Bound<'py, PyDict>> {
    let base = Arc::clone(&base.0);
    if logs.is_empty() {
        return Err(PyValueError::new_err("records is empty"));
    }
    // Lengths and forces are said at the handle, of a rotary scene too.
    let gain = asked.gain().source(&base.scene, Units::Linear);
    let gain = gain.map_err(|error| raised(here(error)))?;
    let asked = asked.asked()?;
    let options = asked.options(&base.scene, gain, Units::Linear);
    let options = options.map_err(|error| raised(here(error)))?;
    let identified = move |course: &Course| {
        let of_base = (&*base, base.name.as_str());
        let read = |log: &PathBuf| records::read(log, of_base, &options, asked.span);
        let read: Vec<Record> = logs.iter().map(read).collect::<Result<_, Error>>()?;
        let mut found = records::identify_in(base.scene.units, &read, &options, &course.stop)?;
        found.warnings.iter_mut().for_each(|warning| *warning = with_arguments(warning));
        let made = Made::new(&base, &found, &options)?;
        let scene = made.named(&base.name);
        let fits = read.iter().zip(&found.fits).map(|(record, fit)| {
            let column = |n: usize| fit.rows(record).map(move |row| row[n]);
            let names = ["time_s", "voltage_v", "position_m", "model_m", "residual_m"];
            let numbered = (0..).zip(names);
            numbered.fold(Columns::default(), |all, (n, name)| all.with(name, column(n)))
        });
        let fits: Vec<Columns> = fits.collect();
        Ok((read, found, options, fits, scene, made.notes))
    };
    let work = move |course: &Course| identified(course).map_err(here);
    let (records, found, options, fits, scene, notes) = run(py, None, None, 0, work)?;
    let made = PyDict::new(py);
    let told = serialized(py, &Json::new(&records, &found, &options))?;
    made.set_item("told", told)?;
    let fits = fits.into_iter().map(|fit| fit.into_dict(py));
    made.set_item("fits", fits.collect::<PyResult<Vec<_>>>()?)?;
    made.set_item("notes", notes)?;
    match scene {
        Ok(scene) => made.set_item("scene", Py::new(py, Scene::from(scene))?)?,
        Err(error) => made.set_item("refused", error.to_string())?,
    }
    Ok(made)
}

/// The pulses that identify a scene's device, with the lines for the console.
#[pyfunction]
pub fn identify_plan<'py>(py: Python<'py>, scene: &Scene) -> PyResult<Bound<'py, PyAny>> {
    let scene = Arc::clone(&scene.0);
    let planned = run(py, None, None, 0, move |_| Planned::new(&scene))?;
    serialized(py, &planned)
}

/// A measured walk beside the one that a scene predicts.
#[pyfunction]
pub fn agree<'py>(
    py: Python<'py>,
    scene: &Scene,
    measured: PathBuf,
    engine: &str,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (scene, engine) = (Arc::clone(&scene.0), engine_of(engine)?);
    let total = walks::most_walks(&scene.scene);
    let name = measured.display().to_string();
    let of_work = Arc::clone(&scene);
    let (walk, found) = run(py, threads, progress, total, move |course| {
        let done = || course.add(1);
        walks::agree_with_file(engine, &of_work, &measured, &course.stop, done)
    })?;
    let made = PyDict::new(py);
    made.set_item("told", serialized(py, &walks::Told::new(&scene, &name, &walk, &found))?)?;
    made.set_item("table", columns::table(py, &found.table())?)?;
    Ok(made)
}

/// Another estimator over a board's capture.
#[pyfunction]
pub fn replay<'py>(
    py: Python<'py>,
    scene: &Scene,
    capture: PathBuf,
    estimator: Option<&str>,
    cutoff: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let scene = Arc::clone(&scene.0);
    let own = scene.scene.velocity.at(cutoff);
    let velocity = counts::velocity(own, estimator, "estimator").map_err(raised)?;
    let lsb_m_per_s = counts::lsb_m_per_s(&scene.scene);
    let (told, table) = run(py, None, None, 0, move |course| {
        let scene = &scene.scene;
        let replayed = counts::replay(&capture, scene, velocity, &course.stop)?;
        let told = counts::Told::new(scene, velocity, cutoff, &replayed, &course.stop)?;
        let positions = replayed.positions.iter();
        let table = Columns::default()
            .with("sample", (replayed.first..).take(replayed.len()))
            .with("position_counts", positions.map(|position| position.counts()))
            .with("board_velocity_lsb", replayed.board.iter().map(|velocity| velocity.bits()))
            .with("velocity_lsb", replayed.velocities.iter().map(|velocity| velocity.bits()));
        Ok((told, table))
    })?;
    let made = PyDict::new(py);
    made.set_item("told", serialized(py, &told)?)?;
    made.set_item("lsb_m_per_s", lsb_m_per_s)?;
    made.set_item("table", table.into_dict(py)?)?;
    Ok(made)
}
