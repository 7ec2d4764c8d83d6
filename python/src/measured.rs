//! Functions for measured data of a device: identification from records, comparison of walks with a scene's walks, and
//! estimators on a capture.

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

/// Each option name in messages of `identify`, and its argument in Python.
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

/// Terms in addition to mass, damping and spring: one word, or names.
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

/// One path, or several.
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
    /// A fitted value with its 95 % interval. If the value was given, both ends are the value. The unit is part of the
    /// attribute's name, for example `mass_kg`.
    Estimate {
        /// The fitted or given value.
        value: f64,
        /// Lower end of the interval.
        low: f64,
        /// Upper end of the interval.
        high: f64,
        /// Half-width of the interval for white noise.
        white_half_width: f64,
    }
}

result! { value
    /// The periodic error of the encoder.
    EncoderTerm {
        /// Amplitude once per cycle, m.
        first_m: Part<Estimate>,
        /// Amplitude twice per cycle, m.
        second_m: Part<Estimate>,
        /// Phase at position 0, rad.
        phase_rad: Part<Estimate>,
        /// Travel per cycle, m.
        cycle_m: Part<Estimate>,
    }
}

result! { value
    /// A force that is periodic in the position.
    CoggingTerm {
        /// Amplitude, N.
        amplitude_n: Part<Estimate>,
        /// Travel from cog to cog, m.
        pitch_m: Part<Estimate>,
        /// Phase at position 0, rad.
        phase_rad: Part<Estimate>,
    }
}

result! { value
    /// Evidence that a term is present.
    TermTest {
        /// `friction`, `stribeck`, `amplifier`, `offset`, `cogging` or `phase`.
        term: String,
        /// Value divided by its standard error.
        standard_errors: f64,
        /// Probability of a value this far from 0 if the true value is 0, for all candidates together.
        p: f64,
    }
}

result! { value
    /// Residual of a fit.
    Residual {
        /// RMS of the residual, m.
        rms_m: f64,
        /// Whether the residual is white.
        white: bool,
        /// p-value of the Ljung-Box test.
        whiteness_p: f64,
        /// Autocorrelation from row to row.
        autocorrelation: f64,
        /// Whether the residual comes from quantisation and not from noise.
        bound_by_quantisation: bool,
        /// Fraction of the quantiser's sawtooth in the residual, 0 to 1.
        coherence: f64,
        /// Largest residual divided by the RMS.
        peak_per_rms: f64,
        /// RMS in counts; None for a sensor without counts.
        rms_counts: Option<f64>,
        /// RMS of the noise before the quantiser that explains the residual, counts. None for a sensor without counts.
        noise_counts: Option<f64>,
    }
}

result! { table
    /// The identified device. Lengths and forces are at the handle, also for a rotary device. The table of this object
    /// is the fit of the first record.
    Identification {
        /// Names of the records.
        logs: Tuple<String>,
        /// Number of fitted rows of all records.
        rows: u64,
        /// Time from row to row, s.
        step_s: f64,
        /// Confidence of the intervals, 0.95.
        confidence: f64,
        /// Command in the records: `voltage`, `force` or `current`.
        drive: String,
        /// Source of the gain: `given`, `motor`, `weight`, `added_mass`, or `force` if the records have the force.
        gain_source: String,
        /// Mass of the device, kg.
        mass_kg: Part<Estimate>,
        /// Damping of the device, N s/m.
        damping_n_s_per_m: Part<Estimate>,
        /// Stiffness, N/m; None without a spring.
        stiffness_n_per_m: Option<Part<Estimate>>,
        /// Rest position of the spring, m; None without a spring.
        rest_position_m: Option<Part<Estimate>>,
        /// Force per volt, N/V. None if the command is no voltage.
        gain_n_per_v: Option<Part<Estimate>>,
        /// Force per ampere, N/A. None if the command is no current.
        gain_n_per_a: Option<Part<Estimate>>,
        /// Time from a row's time stamp to the effect of its command, s.
        latency_s: Part<Estimate>,
        /// Dry friction, N; None if the model has no friction.
        friction_n: Option<Part<Estimate>>,
        /// Largest friction at rest, N; None if friction does not fall with the speed.
        static_friction_n: Option<Part<Estimate>>,
        /// Speed over which friction falls, m/s; None if friction does not fall with the speed.
        stribeck_speed_m_per_s: Option<Part<Estimate>>,
        /// Time constant of the amplifier, s; None if the model has no lag.
        amplifier_lag_s: Option<Part<Estimate>>,
        /// Constant force, N; None if the model has no offset.
        offset_n: Option<Part<Estimate>>,
        /// Force that is periodic in the position; None if the model has no cogging.
        cogging: Option<Part<CoggingTerm>>,
        /// Periodic error of the encoder; None if the model has no such error.
        encoder_error: Option<Part<EncoderTerm>>,
        /// Test of each term in the model, in addition to mass, damping and spring.
        tests: Tuple<Part<TermTest>>,
        /// `time_s`, `position_m`, `speed_m_per_s` at the first fitted row of each record.
        initial: Table,
        /// Residual of the fit.
        residual: Part<Residual>,
        /// Largest ratio of a stated interval to the interval for white noise.
        widening: f64,
        /// Warnings about the fit.
        warnings: Tuple<String>,
        /// Notes about the scene.
        notes: Tuple<String>,
        /// Fit of each record: `time_s`, the command (`voltage_v`, `force_n` or `current_a`), `position_m`, `model_m`,
        /// `residual_m`. The residual is the position minus the model. If the encoder rounds down, half a count is
        /// added to the position.
        fits: Tuple<Table>,
        /// The base scene with the device, or the reason why it is not allowed.
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
    /// Pulses that identify a scene's device. The table of this object is `pulses`.
    Plan {
        /// Name of the scene.
        scene: String,
        /// Start of each pulse, m.
        start_m: f64,
        /// Force of the pulse train, N.
        push_n: f64,
        /// The pulses in order: force `push_n`, N, and duration `seconds`, s. The simulation gives the distance from
        /// the start `excursion_m`, m, and the largest speed `speed_m_per_s`, m/s.
        pulses: Table,
        /// RMS of the force over the whole train with its pauses, N.
        force_rms_n: f64,
        /// Continuous force that the motor allows, N.
        continuous_force_n: f64,
        /// Guessed values of limits that the scene does not have, in the scene's units.
        guessed: Tuple<String>,
        /// Lines for the board's console, in the scene's units. All other values are at the handle.
        console: Tuple<String>,
    }
}

/// Converts the rows of an attribute (dictionaries) to columns.
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
        /// Key in the scene.
        key: String,
        /// Unit of its values.
        unit: String,
        /// The value that explains most of the difference.
        value: f64,
        /// Lowest tried value that explains the difference as well as the best value.
        low: f64,
        /// Highest tried value that explains the difference as well as the best value.
        high: f64,
        /// Whether the range reaches the first or the last tried value.
        at_edge: bool,
        /// Remaining distance between the walks with this value, N/m.
        left_n_per_m: f64,
        /// Whether the value explains the whole difference.
        explains: bool,
        /// Value in the scene; None if the scene does not have the element.
        scene: Option<f64>,
    }
}

result! { table(walls)
    /// A measured walk and the predicted walk of a scene. The table of this object is `walls`.
    Agreement {
        /// Name of the scene.
        scene: String,
        /// Name of the file.
        measured: String,
        /// Nominal cutoff, Hz; None for an estimator without a cutoff.
        cutoff_hz: Option<f64>,
        /// Whether the distance of the measured walk from the prediction is within the scatter of the scene's own
        /// walks.
        agrees: bool,
        /// Step of K, which is the resolution of a walk, N/m.
        stiffness_step_n_per_m: f64,
        /// Distance of the measured walk from the prediction beyond one step of K, N/m.
        distance_n_per_m: f64,
        /// Largest distance among the scene's own walks, N/m.
        scatter_n_per_m: f64,
        /// For each B: `damping_n_s_per_m`, predicted K with its range over the starts (`predicted_n_per_m`,
        /// `predicted_low_n_per_m`, `predicted_high_n_per_m`), and measured K (`measured_n_per_m`). `explained_n_per_m`
        /// is K with the best suspect, or NaN if the walks agree. K is 0 if a walk does not reach the B.
        walls: Table,
        /// The suspects, the smallest remaining distance first. Empty if the walks agree.
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
    /// Another estimator on the counts of a capture, compared with the board's estimator. The table of this object is
    /// `table`.
    Replay {
        /// Name of the estimator.
        estimator: String,
        /// Nominal cutoff of the estimator, Hz.
        cutoff_hz: f64,
        /// Number of consecutive samples.
        samples: u64,
        /// Number of the first sample.
        first_sample: u64,
        /// First sample from which both velocities are equal, bit for bit, up to the end.
        same_from_sample: Option<u64>,
        /// RMS of the difference from the board's velocity, m/s.
        difference_rms_m_per_s: f64,
        /// Delay relative to the board's velocity, s; None if nothing moved.
        later_s: Option<f64>,
        /// RMS of the change of the board's velocity from sample to sample, m/s.
        board_change_rms_m_per_s: f64,
        /// RMS of the change of the estimator's velocity from sample to sample, m/s.
        change_rms_m_per_s: f64,
        /// One LSB of the velocities, m/s.
        lsb_m_per_s: f64,
        /// Columns `sample`, `position_counts`, `board_velocity_lsb` and `velocity_lsb`, in integers of the control
        /// loop.
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
