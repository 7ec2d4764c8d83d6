//! Functions for measured data of a device. They identify a device from records, compare measured walks with a scene's
//! walks, and run estimators on a capture.

use std::{path::PathBuf, sync::Arc};

use pyo3::{
    exceptions::PyValueError,
    inspect::PyStaticExpr,
    prelude::*,
    type_hint_identifier, type_hint_subscript, type_hint_union,
    types::{PyDict, PyString, PyTuple},
};
use sim_loop::{error::Error, scene::Units};
use sim_studies::analysis::{
    agree as walks,
    identify::{self as records, Asked, GainAsked, Json, Made, Planned, Span, Term, Terms},
    replay as counts,
};
use zwidth::units::Velocity;

use crate::{
    given::{Given, Place, Progress, several},
    result::{Any, Array, Keys, Part, Table, Tuple, columns, made, result},
    scene::{Scene, serialized},
    studies::{engine_of, not_empty},
    work::{Course, raised, run},
};

/// Pairs of names. The first is the option that messages of `identify` use. The second is its argument in Python.
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

/// Replaces names of options by names of arguments in a message.
fn with_arguments(line: &str) -> String {
    ARGUMENTS.iter().fold(line.to_owned(), |line, (option, name)| line.replace(option, name))
}

/// Replaces names of options by names of arguments in an error.
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
    Ok(Terms::these(has))
}

/// The terms to fit in addition to mass, damping and spring. The caller gives one word, or several names.
pub struct TermsAsked(Terms);

impl FromPyObject<'_, '_> for TermsAsked {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_union!(
        type_hint_identifier!("builtins", "str"),
        type_hint_subscript!(
            type_hint_identifier!("collections.abc", "Iterable"),
            type_hint_identifier!("builtins", "str")
        )
    );

    fn extract(of: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        let names = match of.extract::<String>() {
            Ok(word) => vec![word],
            Err(_) => several(&of, "terms")?,
        };
        terms_of(&names).map(Self)
    }
}

/// One path or several paths that the caller gives.
pub struct Places(Vec<PathBuf>);

impl FromPyObject<'_, '_> for Places {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_union!(
        Place::INPUT_TYPE,
        type_hint_subscript!(
            type_hint_identifier!("collections.abc", "Iterable"),
            Place::INPUT_TYPE
        )
    );

    fn extract(of: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        if of.is_instance_of::<PyString>() || of.hasattr("__fspath__")? {
            return Ok(Self(vec![of.extract()?]));
        }
        several(&of, "paths").map(Self)
    }
}

result! { value
    /// A fitted value with its 95 % interval. If the value was given, both ends of the interval are the value. The unit
    /// is part of the attribute's name, for example `mass_kg`.
    Estimate {
        /// The fitted or given value.
        value: f64,
        /// Lower end of the interval.
        low: f64,
        /// Upper end of the interval.
        high: f64,
        /// Half-width that the interval would have for white noise.
        white_half_width: f64,
    }
}

result! { value
    /// The periodic error of the encoder.
    EncoderTerm {
        /// Amplitude of the part that repeats once per cycle, in m.
        first_m: Part<Estimate>,
        /// Amplitude of the part that repeats twice per cycle, in m.
        second_m: Part<Estimate>,
        /// Phase at position 0, in rad.
        phase_rad: Part<Estimate>,
        /// Distance over which the error repeats, in m.
        cycle_m: Part<Estimate>,
    }
}

result! { value
    /// A force that is periodic in the position.
    CoggingTerm {
        /// Amplitude of the force, in N.
        amplitude_n: Part<Estimate>,
        /// Travel from cog to cog, in m.
        pitch_m: Part<Estimate>,
        /// Phase at position 0, in rad.
        phase_rad: Part<Estimate>,
    }
}

result! { value
    /// The test whether a term is present.
    TermTest {
        /// Name of the term: `friction`, `stribeck`, `amplifier`, `offset`, `cogging` or `phase`.
        term: String,
        /// The term's value divided by its standard error.
        standard_errors: f64,
        /// Probability of a value as far from 0 as this one, if the true value is 0. It is for all candidates together.
        p: f64,
    }
}

result! { value
    /// What the fit leaves unexplained: the measured position minus the model.
    Residual {
        /// RMS of the residual, in m.
        rms_m: f64,
        /// Whether the residual is white, as noise is.
        white: bool,
        /// p-value of the Ljung-Box test.
        whiteness_p: f64,
        /// Correlation of the residual from row to row.
        autocorrelation: f64,
        /// Whether the residual comes from quantisation and not from noise.
        bound_by_quantisation: bool,
        /// The share of the quantiser's sawtooth that remains in the residual, 0 to 1.
        coherence: f64,
        /// Largest residual divided by the residual's RMS.
        peak_per_rms: f64,
        /// RMS of the residual in counts; None for a sensor without counts.
        rms_counts: Option<f64>,
        /// RMS of the noise before the quantiser, in counts. Noise of this size explains the residual. None for a
        /// sensor without counts.
        noise_counts: Option<f64>,
    }
}

result! { table
    /// The identified device. Lengths and forces are at the handle, also for a rotary device. The table of this object
    /// is the fit of the first record.
    Identification {
        /// Names of the records.
        logs: Tuple<String>,
        /// Number of rows that were fitted in all records.
        rows: u64,
        /// Time from row to row, in s.
        step_s: f64,
        /// Confidence of the intervals. It is 0.95.
        confidence: f64,
        /// What the command in the records is: `voltage`, `force` or `current`.
        drive: String,
        /// Where the gain comes from: `given`, `motor`, `weight`, `added_mass`, or `force` if the records have the
        /// force.
        gain_source: String,
        /// Mass of the device, in kg.
        mass_kg: Part<Estimate>,
        /// Damping of the device, in N s/m.
        damping_n_s_per_m: Part<Estimate>,
        /// Stiffness of the spring in N/m; None without a spring.
        stiffness_n_per_m: Option<Part<Estimate>>,
        /// Rest position of the spring in m; None without a spring.
        rest_position_m: Option<Part<Estimate>>,
        /// Force per volt in N/V; None if the command is no voltage.
        gain_n_per_v: Option<Part<Estimate>>,
        /// Force per ampere in N/A; None if the command is no current.
        gain_n_per_a: Option<Part<Estimate>>,
        /// Time until the command of a row acts, in s. It begins at the row's time stamp.
        latency_s: Part<Estimate>,
        /// Dry friction in N; None if the model has no friction.
        friction_n: Option<Part<Estimate>>,
        /// Largest friction at rest in N; None if friction does not fall with the speed.
        static_friction_n: Option<Part<Estimate>>,
        /// Speed over which friction falls, in m/s; None if friction does not fall with the speed.
        stribeck_speed_m_per_s: Option<Part<Estimate>>,
        /// Time constant of the amplifier in s; None if the model has no lag.
        amplifier_lag_s: Option<Part<Estimate>>,
        /// Constant force in N; None if the model has no offset.
        offset_n: Option<Part<Estimate>>,
        /// Force that is periodic in the position; None if the model has no cogging.
        cogging: Option<Part<CoggingTerm>>,
        /// Periodic error of the encoder; None if the model has no such error.
        encoder_error: Option<Part<EncoderTerm>>,
        /// Tests of the terms that the model has in addition to mass, damping and spring.
        tests: Tuple<Part<TermTest>>,
        /// State of each record at its first fitted row. The columns are `time_s`, `position_m` and `speed_m_per_s`.
        initial: Table,
        /// Residual of the fit.
        residual: Part<Residual>,
        /// The largest ratio of an interval to the interval that white noise would give.
        widening: f64,
        /// Warnings about the fit.
        warnings: Tuple<String>,
        /// Notes about the scene.
        notes: Tuple<String>,
        /// Fit of each record, as a table. The columns are `time_s`, the command (`voltage_v`, `force_n` or
        /// `current_a`), `position_m`, `model_m` and `residual_m`. The residual is the position minus the model. If the
        /// encoder rounds down, half a count is added to the position.
        fits: Tuple<Table>,
        /// The base scene with the identified device, or the reason why it is not allowed.
        scene_or_reason: Any,
    }

    /// The base scene with the device.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     No scene can have this device. The message gives the reason.
    #[getter]
    fn scene<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, Scene>> {
        let made = self.scene_or_reason.0.bind(py);
        made.cast::<Scene>().cloned().map_err(|_| PyValueError::new_err(made.to_string()))
    }

    /// The columns of the table.
    fn columns(&self, py: Python<'_>) -> PyResult<Keys> {
        self.fits.0[0].columns(py)
    }
}

result! { table(pulses)
    /// Pulses with which a scene's device can be identified. The table of this object is `pulses`.
    Plan {
        /// Name of the scene.
        scene: String,
        /// Position at which each pulse starts, in m.
        start_m: f64,
        /// Force of all pulses, in N.
        push_n: f64,
        /// The pulses in their order. `push_n` is the force in N, `seconds` is the duration in s. Two values come from
        /// the simulation: `excursion_m` is the distance from the start in m, and `speed_m_per_s` is the largest speed
        /// in m/s.
        pulses: Table,
        /// RMS of the force over the whole train with its pauses, in N.
        force_rms_n: f64,
        /// Force that the motor can give continuously, in N.
        continuous_force_n: f64,
        /// Limits that the scene does not have and whose values were guessed. They are in the scene's units.
        guessed: Tuple<String>,
        /// Lines to type at the board's console, in the scene's units. All other values are at the handle.
        console: Tuple<String>,
    }
}

/// Converts the rows of an attribute to columns. The rows are dictionaries.
fn turn<'py, const N: usize>(
    told: &Bound<'py, PyAny>,
    rows: &str,
    names: [&'static str; N],
) -> PyResult<()> {
    let of = told.get_item(rows)?;
    let column = |name: &'static str| {
        let cells = of.try_iter()?.map(|row| row?.get_item(name)?.extract::<f64>());
        Ok((name, Array::new(told.py(), cells.collect::<PyResult<_>>()?)?.bound(told.py())))
    };
    let turned = names.into_iter().map(column).collect::<PyResult<Vec<_>>>()?;
    told.set_item(rows, Table::new(told.py(), columns(told.py(), turned)?)?)
}

/// Find mass, damping, stiffness and more of a device from recorded voltage and position.
///
/// One record cannot distinguish these values from the force per volt. So give the force per volt in one of four ways.
/// Only a rotary base scene already has a force per volt. Lengths and forces are at the handle, also for a rotary
/// scene.
///
/// Parameters
/// ----------
/// records : path or iterable of path
///     Logs, telemetry captures, or the CSV of a capture. Several records of one device are fitted together.
/// base : Scene
///     Gives encoder, voltage limit, latency, sample rate, and all other values that a scene needs.
/// gain : float, optional
///     Force per volt, N/V. For records with a current: force per ampere, N/A. Not allowed for records with a force.
/// torque_constant, amplifier_gain, drum_radius : float, optional
///     Force per volt from three values: torque constant, N m/A, times amplifier gain, A/V, divided by radius, m.
/// calibration_mass, calibration_voltage : float, optional
///     Force per volt from a weight, kg, and the voltage that holds it still, V.
/// added_mass : float, optional
///     Mass that was added to the device for the second of two records, kg. With this argument, the force per volt is
///     fitted too.
/// latency : float, optional
///     Time from a row's time stamp to the effect of its command, rows of the log. Default: the base scene's latency.
/// fit_latency : bool
///     Fit the latency too. `latency` is the first value.
/// spring : bool
///     Whether the device has a spring.
/// terms : {"auto", "none"} or iterable of {"friction", "stribeck", "amplifier", "offset", "cogging", "phase"}
///     Terms in addition to mass, damping and spring: the terms that the records show, no terms, or the named terms.
/// rest_position : float, optional
///     Rest position of the spring without any other force, m. With this value, a constant force can be distinguished
///     from a shift of the rest position.
/// encoder_cycle : float, optional
///     Travel per cycle of the encoder's signals, m. Default: the base scene's value. If the scene has no value, the
///     cycle is searched in the records.
/// resolution : float, optional
///     Size of a count, m; 0 for a sensor without counts. Default: the base scene's value.
/// span : tuple of float or None
///     First and last used time stamp of the records, s. None means the beginning or the end.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range, a file cannot be read, or the records do not determine the device. The message gives
///     the reason.
#[pyfunction]
#[pyo3(signature = (
    records, *, base, gain = None, torque_constant = None, amplifier_gain = None, drum_radius = None,
    calibration_mass = None, calibration_voltage = None, added_mass = None, latency = None, fit_latency = false,
    spring = true, terms = TermsAsked(Terms::Auto), rest_position = None, encoder_cycle = None, resolution = None,
    span = (None, None)
))]
pub fn identify(
    py: Python<'_>,
    records: Places,
    base: Given,
    gain: Option<f64>,
    torque_constant: Option<f64>,
    amplifier_gain: Option<f64>,
    drum_radius: Option<f64>,
    calibration_mass: Option<f64>,
    calibration_voltage: Option<f64>,
    added_mass: Option<f64>,
    latency: Option<f64>,
    fit_latency: bool,
    spring: bool,
    terms: TermsAsked,
    rest_position: Option<f64>,
    encoder_cycle: Option<f64>,
    resolution: Option<f64>,
    span: (Option<f64>, Option<f64>),
) -> PyResult<Py<Identification>> {
    let (logs, base) = (records.0, base.0);
    not_empty("records", &logs)?;
    let gain = GainAsked {
        gain,
        torque_constant,
        amplifier_gain,
        drum_radius,
        calibration_mass,
        calibration_voltage,
        added_mass,
    };
    let span = Span { from_s: span.0, to_s: span.1 };
    let asked = Asked {
        is_based: true,
        latency,
        fit_latency,
        spring,
        terms: terms.0,
        rest_position,
        encoder_cycle,
        resolution,
        span,
    };
    let identified = move |course: &Course| {
        let of_base = (&*base, base.name.as_str());
        // Lengths and forces are at the handle, also for a rotary scene.
        let (read, options) = records::read_all(&logs, of_base, (&asked, &gain), Units::Linear)?;
        let mut found = records::identify_in(base.scene.units, &read, &options, &course.stop)?;
        found.warnings.iter_mut().for_each(|warning| *warning = with_arguments(warning));
        let made = Made::new(&base, &found, &options)?;
        let scene = made.named(&base.name);
        Ok((read, found, options, scene, made.notes))
    };
    let work = move |course: &Course| identified(course).map_err(here);
    let (records, found, options, scene, notes) = run(py, None, None, 0, work)?;
    let told = serialized(py, &Json::new(&records, &found, &options))?;
    if let Some(terms) = told.cast::<PyDict>()?.get_item("terms")? {
        told.cast::<PyDict>()?.update(terms.cast()?)?;
        told.del_item("terms")?;
    } else {
        told.set_item("tests", PyTuple::empty(py))?;
    }
    if !told.cast::<PyDict>()?.contains("gain_n_per_a")? {
        told.set_item("gain_n_per_a", py.None())?;
    }
    turn(&told, "initial", ["time_s", "position_m", "speed_m_per_s"])?;
    let fits = records.iter().zip(&found.fits).map(|(record, fit)| {
        let names = ["time_s", record.command_column(), "position_m", "model_m", "residual_m"];
        let column = |(n, name)| {
            Ok((name, Array::new(py, fit.rows(record).map(|row| row[n]).collect())?.bound(py)))
        };
        let fit = names.into_iter().enumerate().map(column);
        Table::new(py, columns(py, fit.collect::<PyResult<Vec<_>>>()?)?)
    });
    told.set_item("fits", fits.collect::<PyResult<Vec<_>>>()?)?;
    told.set_item("notes", notes)?;
    match scene {
        Ok(scene) => told.set_item("scene_or_reason", Scene::from(scene))?,
        Err(error) => told.set_item("scene_or_reason", error.to_string())?,
    }
    made(&told)
}

/// Plan the pulses that identify a scene's device. The pulses are as strong as travel, speed and motor allow.
///
/// **The device moves.** The plan uses the scene's own mass, damping, spring and friction. If these values are a first
/// guess, begin with a tenth of the force. Keep hands and objects away from the whole travel.
///
/// Parameters
/// ----------
/// scene : Scene
///     The device on its board.
///
/// Raises
/// ------
/// ValueError
///     The travel leaves no room for pulses.
///
/// Examples
/// --------
/// >>> made = identify_plan(Scene.load("paper-1um"))
/// >>> (made.pulses["excursion_m"] * 1e3).round(2).tolist()  # mm
/// [21.17, 21.17, 20.36, 20.36]
/// >>> "; ".join(made.console)
/// 'zero; k 0; b 0; arm; wait 1; start 0.051700; pulses 2.9530; wait 21; disarm'
#[pyfunction]
pub fn identify_plan(py: Python<'_>, scene: Given) -> PyResult<Py<Plan>> {
    let planned = run(py, None, None, 0, move |_| Planned::new(&scene.0))?;
    let told = serialized(py, &planned)?;
    turn(&told, "pulses", ["push_n", "seconds", "excursion_m", "speed_m_per_s"])?;
    made(&told)
}

result! { value
    /// A value of the scene that may explain why two walks differ.
    Suspect {
        /// Name in reports.
        name: String,
        /// Key of the value in the scene.
        key: String,
        /// Unit of the values below.
        unit: String,
        /// The value that explains the largest part of the difference.
        value: f64,
        /// Lowest tried value that explains the difference as well as the best value.
        low: f64,
        /// Highest tried value that explains the difference as well as the best value.
        high: f64,
        /// Whether `low` is the first tried value or `high` is the last one.
        at_edge: bool,
        /// Distance that remains between the walks with this value, in N/m.
        left_n_per_m: f64,
        /// Whether the value explains the whole difference.
        explains: bool,
        /// The value in the scene; None if the scene does not have the element.
        scene: Option<f64>,
    }
}

result! { table(walls)
    /// A measured walk, compared with the walk that a scene predicts. The table of this object is `walls`.
    Agreement {
        /// Name of the scene.
        scene: String,
        /// Name of the file with the measured walk.
        measured: String,
        /// Nominal cutoff in Hz; None for an estimator without a cutoff.
        cutoff_hz: Option<f64>,
        /// Whether the measured walk differs from the prediction no more than the scene's own walks do.
        agrees: bool,
        /// Step of K in N/m. A walk does not resolve smaller differences.
        stiffness_step_n_per_m: f64,
        /// Distance of the measured walk from the prediction, in N/m. Differences of up to one step of K are not
        /// counted.
        distance_n_per_m: f64,
        /// The largest distance that one of the scene's own walks has from the mean of the others, in N/m.
        scatter_n_per_m: f64,
        /// One row for each B (`damping_n_s_per_m`). A row has the predicted K with its range over the starts
        /// (`predicted_n_per_m`, `predicted_low_n_per_m`, `predicted_high_n_per_m`), and the measured K
        /// (`measured_n_per_m`). `explained_n_per_m` is the K that the best suspect predicts, or NaN if the walks
        /// agree. K is 0 if a walk does not reach the B.
        walls: Table,
        /// The suspects. The one with the smallest remaining distance comes first. Empty if the walks agree.
        suspects: Tuple<Part<Suspect>>,
        /// The answer in words.
        answers: Tuple<String>,
    }
}

/// Check whether a measured walk agrees with the scene's walks. If the walks differ, find the value that best explains
/// the difference.
///
/// Parameters
/// ----------
/// scene : Scene
///     The scene that predicts the walk.
/// measured : path
///     The measured walk in the scene's units, as `cargo board walk --csv` writes it.
/// engine, threads
///     As in `walk`.
/// progress : callable, optional
///     Called from this thread with the number of finished walks and the largest possible number. An exception in this
///     function ends the work.
///
/// Raises
/// ------
/// ValueError
///     The file cannot be read or is no walk of this scene, or the handle does not reach the wall.
#[pyfunction]
#[pyo3(signature = (scene, measured, *, engine = "lanes", threads = None, progress = None))]
pub fn agree(
    py: Python<'_>,
    scene: Given,
    measured: Place,
    engine: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Py<Agreement>> {
    let (scene, engine, measured) = (scene.0, engine_of(engine)?, measured.0);
    let total = walks::most_walks(&scene.scene);
    let name = measured.display().to_string();
    let of_work = Arc::clone(&scene);
    let (walk, found) = run(py, threads, progress.as_ref(), total, move |course| {
        let done = || course.add(1);
        walks::agree_with_file(engine, &of_work, &measured, &course.stop, done)
    })?;
    let told = serialized(py, &walks::Told::new(&scene, &name, &walk, &found))?;
    told.set_item("walls", Table::of(py, &found.table())?)?;
    made(&told)
}

result! { table(table)
    /// Compares another estimator with the board's estimator. It runs on the counts of a capture. The table of this
    /// object is `table`.
    Replay {
        /// Name of the other estimator.
        estimator: String,
        /// Nominal cutoff of the estimator, in Hz.
        cutoff_hz: f64,
        /// Number of consecutive samples that were used.
        samples: u64,
        /// Number of the first sample.
        first_sample: u64,
        /// First sample from which on both velocities are equal, bit for bit, up to the end.
        same_from_sample: Option<u64>,
        /// RMS of the difference between both velocities, in m/s.
        difference_rms_m_per_s: f64,
        /// Delay of the estimator relative to the board's velocity, in s; None if nothing moved.
        later_s: Option<f64>,
        /// RMS of how much the board's velocity changes from sample to sample, in m/s.
        board_change_rms_m_per_s: f64,
        /// RMS of how much the estimator's velocity changes from sample to sample, in m/s.
        change_rms_m_per_s: f64,
        /// One LSB of the velocities, in m/s.
        lsb_m_per_s: f64,
        /// The velocities of each sample. The columns `sample`, `position_counts`, `board_velocity_lsb` and
        /// `velocity_lsb` have the integers of the control loop.
        table: Table,
    }
}

/// Run an estimator on the counts of a capture, from rest. Compare its velocity with the board's velocity.
///
/// Parameters
/// ----------
/// scene : Scene
///     The scene of the board's device record.
/// capture : path
///     A file with the received bytes of RTT up channel 1 (`Telemetry.save` writes it).
/// estimator : str, optional
///     A name of `ESTIMATORS`. Default: the scene's estimator.
/// cutoff : float
///     Nominal cutoff, Hz. Other parameters come from the scene, or are the defaults.
///
/// Raises
/// ------
/// ValueError
///     There is no such estimator, its cutoff is out of range, or the estimator needs more inputs than counts. Or the
///     capture has no range in which all samples are present.
#[pyfunction]
#[pyo3(signature = (scene, capture, *, estimator = None, cutoff = 1500.0))]
pub fn replay(
    py: Python<'_>,
    scene: Given,
    capture: Place,
    estimator: Option<&str>,
    cutoff: f64,
) -> PyResult<Py<Replay>> {
    let scene = scene.0;
    let own = scene.scene.velocity.at(cutoff);
    let velocity = counts::velocity(own, estimator, "estimator").map_err(raised)?;
    let lsb_m_per_s = counts::lsb_m_per_s(&scene.scene);
    let (told, replayed) = run(py, None, None, 0, move |course| {
        let scene = &scene.scene;
        let replayed = counts::replay(&capture.0, scene, velocity, &course.stop)?;
        let told = counts::Told::new(scene, velocity, cutoff, &replayed, &course.stop)?;
        Ok((told, replayed))
    })?;
    let told = serialized(py, &told)?;
    told.set_item("lsb_m_per_s", lsb_m_per_s)?;
    let samples = (replayed.first..).take(replayed.len()).collect();
    let positions = replayed.positions.iter().map(|position| position.counts()).collect();
    let bits = |of: &[Velocity]| Array::new(py, of.iter().map(|v| v.bits()).collect());
    let table = columns(
        py,
        [
            ("sample", Array::<u64>::new(py, samples)?.bound(py)),
            ("position_counts", Array::<i32>::new(py, positions)?.bound(py)),
            ("board_velocity_lsb", bits(&replayed.board)?.bound(py)),
            ("velocity_lsb", bits(&replayed.velocities)?.bound(py)),
        ],
    )?;
    told.set_item("table", Table::new(py, table)?)?;
    made(&told)
}
