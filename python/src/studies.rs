//! Hits, walks, sweeps, grids and the linear boundary.

use std::{
    ops::RangeInclusive,
    sync::{Arc, atomic::Ordering::Relaxed},
};

use pyo3::{IntoPyObjectExt as _, exceptions::PyValueError, prelude::*, types::PyDict};
use sim_loop::{
    engine::{Depth, Engine, stream},
    error::Error,
    range::within,
    simulation::{
        prepared::{HitError, Numeric},
        trace::Trace as Samples,
    },
};
use sim_studies::{
    analysis::linear::{Boundary as LinearBoundary, StiffnessLimit, passivity::Passivity},
    study::{
        asked::{self, Names, Walls},
        boundary::{Boundary, BoundaryPoint},
        sweep::{self as study, Plan},
    },
};
use zwidth::experiment::{Ended, Verdict};

use crate::{
    given::{Given, Numbers, Progress},
    result::{Array, Keys, Part, Tuple, columns, result},
    work::{raised, run},
};

const NAMES: Names = Names {
    cutoff: "cutoff",
    stiffness: "stiffness",
    damping: "damping",
    start_offset: "start_offset",
};
const LISTS: Names =
    Names { cutoff: "cutoffs", stiffness: "stiffnesses", damping: "dampings", ..NAMES };

/// Names of the codes in `Grid.verdict`.
pub const VERDICTS: [&str; 4] = ["stable", "unstable", "no_contact", "out_of_range"];

/// The value with this name, or an error with all names.
pub fn named<T: Copy, const N: usize>(
    what: &str,
    name: &str,
    all: [T; N],
    named: impl Fn(T) -> &'static str,
) -> PyResult<T> {
    all.into_iter().find(|one| named(*one) == name).ok_or_else(|| {
        let all = all.map(&named).join(", ");
        PyValueError::new_err(format!("{what} is {name:?}, allowed {all}"))
    })
}

pub fn numeric_of(name: &str) -> PyResult<Numeric> {
    let all = [Numeric::Fixed, Numeric::F64, Numeric::F64Rounded];
    named("numeric", name, all, |numeric| numeric.name())
}

pub fn engine_of(name: &str) -> PyResult<Engine> {
    named("engine", name, ["core", "lanes"], |name| name)
        .map(|name| if name == "core" { Engine::Core } else { Engine::lanes() })
}

/// Refuses a number that the command line would refuse too.
pub fn in_range(name: &str, value: u32, range: RangeInclusive<u32>) -> PyResult<()> {
    let range = f64::from(*range.start())..=f64::from(*range.end());
    within(name, f64::from(value), range).map_err(PyValueError::new_err)
}

pub fn not_empty<T>(name: &str, list: &[T]) -> PyResult<()> {
    match list {
        [] => Err(PyValueError::new_err(format!("{name} is empty"))),
        _ => Ok(()),
    }
}

/// A column that repeats the cutoff in each row. It is NaN if there is no cutoff.
fn cutoffs(py: Python<'_>, cutoff_hz: Option<f64>, rows: usize) -> PyResult<Bound<'_, PyAny>> {
    Array::new(py, vec![cutoff_hz.unwrap_or(f64::NAN); rows])?.into_bound_py_any(py)
}

result! { arrays
    /// Every sample of a hit.
    Trace {
        /// Time since the start of the hit, in s.
        time_s: Array<f64>,
        /// True position of the handle, in m.
        position_m: Array<f64>,
        /// Count of the encoder.
        count: Array<i32>,
        /// Velocity that the controller uses, in m/s.
        velocity_m_per_s: Array<f64>,
        /// Force that the controller commands, in N. It is constant from output to output.
        force_n: Array<f64>,
        /// Force on the handle at the end of the sample, in N. It includes the latency and the output's quantisation.
        output_n: Array<f64>,
        /// Sum of three flags: 1 (inside the wall), 2 (an output was computed), 4 (the last output saturated).
        flags: Array<u8>,
        /// Energy that the wall has absorbed in this contact, in J. It is computed from the wall's force and the
        /// counts. A negative value means that the wall has supplied energy.
        port_energy_j: Array<f64>,
    }
}

result! { value
    /// One hit on a wall.
    Hit {
        /// Name of the scene.
        scene: String,
        /// Nominal cutoff in Hz; None for an estimator without a cutoff.
        cutoff_hz: Option<f64>,
        /// K of the wall, in N/m.
        stiffness_n_per_m: f64,
        /// B of the wall, in N s/m.
        damping_n_s_per_m: f64,
        /// Result by the scene's criterion: "stable", "unstable" or "no_contact".
        verdict: String,
        /// RMS of the counts about their mean over the measurement window, in m.
        rms_m: f64,
        /// RMS of the true motion about its mean over the window, in m.
        rms_motion_m: f64,
        /// Mean position over the window according to the counts, in m.
        mean_m: f64,
        /// Largest penetration behind the surface during the whole hit, in m.
        peak_penetration_m: f64,
        /// Fraction of the hit's outputs at which the force saturated.
        saturated_fraction: f64,
        /// Fraction of the window during which the handle is in contact.
        contact_fraction: f64,
        /// Fraction of the samples in which the velocity is at the limit of its number format.
        velocity_clipped_fraction: f64,
        /// Fraction of the window's outputs that are at the actuator's limit.
        window_at_limit_fraction: f64,
        /// Level of the window's motion above the threshold of human feeling, in dB; None if the window has no motion.
        sensation_db: Option<f64>,
        /// RMS of the window's outputs about their mean, in N. If there are several pushes, it is the value of the push
        /// that decides the verdict.
        force_rms_n: f64,
        /// K times the mean penetration, divided by the wall's mean force. The ratio is 1 if the handle rests at the
        /// wall. None if the wall has no force.
        penetration_ratio: Option<f64>,
        /// Energy that the wall has absorbed in the last contact, in J. It is computed from the wall's force and the
        /// counts.
        port_taken_j: f64,
        /// Largest energy that the wall has supplied in a contact beyond what it had absorbed, in J.
        port_given_j: f64,
        /// Fraction of the outputs in contact that the passivity controller has changed. None without the controller.
        port_limited_fraction: Option<f64>,
        /// Fraction of the wall's force that the passivity controller has withheld. None without the controller.
        port_withheld_fraction: Option<f64>,
        /// Every sample of the hit; None unless `trace` was set.
        trace: Option<Part<Trace>>,
    }

    /// Whether the wall counts as stable.
    #[getter]
    fn stable(&self) -> bool {
        self.verdict == "stable"
    }
}

/// Hit one wall and judge whether it is stable.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment.
/// stiffness, damping : float
///     The wall, N/m and N s/m.
/// cutoff : float, optional
///     Nominal cutoff of the velocity filter, Hz. Omit it for an estimator without a cutoff.
/// start_offset : float
///     Distance of the start from the scene's start, counts.
/// numeric : {"fixed", "f64", "f64-rounded"}
///     Numbers of the controller: the core's fixed point, its twin in floats, or the twin with the core's rounding of
///     the velocity.
/// trace : bool
///     Return every sample.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range. The message has the name, the value and the allowed range.
///
/// Examples
/// --------
/// >>> scene = Scene.load("paper-2um")
/// >>> made = hit(scene, stiffness=10e3, damping=30.0, cutoff=500)
/// >>> made.verdict, round(made.rms_m * 1e6, 3), round(made.peak_penetration_m * 1e3, 3)  # um, mm
/// ('stable', 0.998, 7.117)
/// >>> hit(scene, stiffness=200e3, damping=30.0, cutoff=500).verdict
/// 'unstable'
#[pyfunction]
#[pyo3(signature = (scene, *, stiffness, damping, cutoff = None, start_offset = 0.0, numeric = "fixed", trace = false))]
pub fn hit(
    py: Python<'_>,
    scene: Given,
    stiffness: f64,
    damping: f64,
    cutoff: Option<f64>,
    start_offset: f64,
    numeric: &str,
    trace: bool,
) -> PyResult<Hit> {
    let (scene, numeric) = (scene.0, numeric_of(numeric)?);
    let hit = asked::hit(&scene, cutoff, Some([stiffness, damping]), start_offset, NAMES)
        .map_err(raised)?;
    let cutoff_hz = hit.velocity.cutoff_hz();
    let passive = scene.scene.passivity.is_some();
    let name = scene.name.clone();
    let (report, samples) = run(py, None, None, 0, move |_| {
        let prepared = asked::prepare(&scene)?.with_felt();
        if !trace {
            return Ok((prepared.hit(numeric, &hit, |_| ())?, None));
        }
        let mut samples = Samples::new(&prepared, &hit).map_err(|error| error.of(&scene.name))?;
        let report = prepared.hit(numeric, &hit, |sample| samples.push(sample))?;
        Ok((report, Some(samples)))
    })?;
    let trace = samples.map(|samples| Py::new(py, traced(py, &samples)?)).transpose()?;
    Ok(Hit {
        scene: name,
        cutoff_hz,
        stiffness_n_per_m: stiffness,
        damping_n_s_per_m: damping,
        verdict: report.verdict.name().into(),
        rms_m: report.rms_m,
        rms_motion_m: report.rms_motion_m,
        mean_m: report.mean_m,
        peak_penetration_m: report.peak_penetration_m,
        saturated_fraction: report.saturated_fraction,
        contact_fraction: report.contact_fraction,
        velocity_clipped_fraction: report.velocity_clipped_fraction,
        window_at_limit_fraction: report.at_limit_fraction,
        sensation_db: report.sensation_db,
        force_rms_n: report.force_rms_n,
        penetration_ratio: report.penetration_ratio,
        port_taken_j: report.port.taken_j,
        port_given_j: report.port.given_j,
        port_limited_fraction: passive.then_some(report.port.limited_fraction),
        port_withheld_fraction: passive.then_some(report.port.withheld_fraction),
        trace: trace.map(Part),
    })
}

fn traced(py: Python<'_>, samples: &Samples) -> PyResult<Trace> {
    let rows = &samples.rows;
    #[expect(clippy::cast_precision_loss, reason = "at most 2^25 samples")]
    let time_s = |n: usize| n as f64 / samples.rate_hz;
    Ok(Trace {
        time_s: Array::new(py, (0..rows.len()).map(time_s).collect())?,
        position_m: Array::each(py, rows, |row| row.position_m)?,
        count: Array::each(py, rows, |row| row.count)?,
        velocity_m_per_s: Array::each(py, rows, |row| row.velocity_m_per_s)?,
        force_n: Array::each(py, rows, |row| row.force_n)?,
        output_n: Array::each(py, rows, |row| row.output_n)?,
        flags: Array::each(py, rows, |row| row.flags)?,
        port_energy_j: Array::each(py, rows, |row| row.port_energy_j)?,
    })
}

result! { table
    /// The boundary of the stable walls at one cutoff.
    Walk {
        /// Name of the scene.
        scene: String,
        /// Nominal cutoff in Hz; None for an estimator without a cutoff.
        cutoff_hz: Option<f64>,
        /// B of the boundary's points, in N s/m and in ascending order.
        damping_n_s_per_m: Array<f64>,
        /// The largest stable K at each B, in N/m.
        stiffness_n_per_m: Array<f64>,
        /// Area under the boundary, in N^2 s/m^2.
        area: f64,
        /// Number of wall hits of the walk.
        hits: u64,
        /// The reason why the walk ended; None if its first point is unstable.
        ended_by: Option<String>,
        /// Largest K of the boundary, in N/m; 0 if the boundary is empty.
        stiffness_peak_n_per_m: f64,
        /// Largest B with a stable K, in N s/m; 0 if the boundary is empty.
        damping_max_n_s_per_m: f64,
    }

    /// The columns of the table. Their names are those of the command line's CSV.
    fn columns(&self, py: Python<'_>) -> PyResult<Keys> {
        let b = self.damping_n_s_per_m.bound(py);
        columns(py, [
            ("cutoff_hz", cutoffs(py, self.cutoff_hz, b.len()?)?),
            ("damping_n_s_per_m", b),
            ("stiffness_n_per_m", self.stiffness_n_per_m.bound(py)),
        ])
    }
}

fn walked(py: Python<'_>, scene: &str, hz: Option<f64>, boundary: &Boundary) -> PyResult<Walk> {
    let points = &boundary.points;
    let most = |of: fn(&BoundaryPoint) -> f64| points.iter().map(of).fold(0.0, f64::max);
    Ok(Walk {
        scene: scene.into(),
        cutoff_hz: hz,
        stiffness_peak_n_per_m: most(|point| point.stiffness_n_per_m),
        damping_max_n_s_per_m: most(|point| point.damping_n_s_per_m),
        damping_n_s_per_m: Array::each(py, points, |point| point.damping_n_s_per_m)?,
        stiffness_n_per_m: Array::each(py, points, |point| point.stiffness_n_per_m)?,
        area: boundary.area,
        hits: boundary.hits,
        ended_by: boundary.ended.map(Ended::name).map(Into::into),
    })
}

/// Follow the boundary of the stable walls at one cutoff.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment.
/// cutoff : float, optional
///     Nominal cutoff of the velocity filter, Hz. Omit it for an estimator without a cutoff.
/// start_offset : float
///     Distance of the start from the scene's start, counts. The repeats of a sweep use 0, 1/4, 1/2, 3/4.
/// engine : {"lanes", "core"}
///     `"lanes"` computes many hits together in vector lanes. `"core"` runs the control core itself. The results are
///     equal, bit for bit.
/// numeric : {"fixed", "f64", "f64-rounded"}
///     As in `hit`.
/// threads : int, optional
///     Number of threads. Default: all cores. The result does not depend on this number.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range, or the first wall of the walk is unstable. The message says what to change.
///
/// Examples
/// --------
/// Coarse steps are quick:
///
/// >>> steps = {"stiffness_step_n_per_m": 10e3, "damping_step_n_s_per_m": 100.0}
/// >>> made = walk(Scene.load("paper-2um").replace(walk=steps), cutoff=500)
/// >>> made.damping_n_s_per_m.tolist()
/// [10.0, 110.0, 210.0, 310.0, 410.0, 510.0]
/// >>> made.stiffness_n_per_m.tolist()
/// [2000.0, 52000.0, 62000.0, 62000.0, 42000.0, 22000.0]
/// >>> round(made.area), made.hits
/// (24200000, 23)
#[pyfunction]
#[pyo3(signature = (scene, *, cutoff = None, start_offset = 0.0, engine = "lanes", numeric = "fixed", threads = None))]
pub fn walk(
    py: Python<'_>,
    scene: Given,
    cutoff: Option<f64>,
    start_offset: f64,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
) -> PyResult<Walk> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let scene = scene.0;
    let first = asked::hit(&scene, cutoff, None, start_offset, NAMES).map_err(raised)?;
    let cutoff_hz = first.velocity.cutoff_hz();
    let of_work = Arc::clone(&scene);
    let boundary = run(py, threads, None, 0, move |course| {
        let prepared = asked::prepare(&of_work)?;
        asked::boundary(&of_work, engine, &prepared, numeric, &first, &course.stop)
    })?;
    walked(py, &scene.name, cutoff_hz, &boundary)
}

result! { table
    /// Walks at every cutoff, repeated from several starts.
    Sweep {
        /// Name of the scene.
        scene: String,
        /// Nominal cutoffs in Hz, in ascending order.
        cutoffs_hz: Array<f64>,
        /// Frequencies at which the discrete filters have -3 dB, in Hz.
        true_cutoffs_hz: Array<f64>,
        /// Mean area of each cutoff over the repeats, in N^2 s/m^2.
        area: Array<f64>,
        /// Area of every walk, in N^2 s/m^2. The shape is (cutoffs, repeats).
        areas: Array<f64>,
        /// The walks. `walks[n][repeat]` is a walk at cutoff number `n`.
        walks: Tuple<Tuple<Part<Walk>>>,
        /// The ideal cutoff in Hz: the lowest one whose mean area is at least 98 % of the largest mean area. None if
        /// every walk failed.
        ideal_cutoff_hz: Option<f64>,
        /// Lowest and highest cutoff that the repeats cannot distinguish from the ideal cutoff, in Hz.
        ideal_range_hz: Option<(f64, f64)>,
        /// Name of the rule that has given the range.
        ideal_basis: Option<String>,
        /// Notes that a reader needs to understand the numbers.
        notes: Tuple<String>,
    }

    /// The columns of the table. Their names are those of the command line's CSV.
    fn columns(&self, py: Python<'_>) -> PyResult<Keys> {
        let of = |of: fn(&Walk) -> f64, choose: fn(f64, f64) -> f64| {
            let best = |walks: &Tuple<Part<Walk>>| {
                walks.0.iter().map(|walk| of(walk.0.get())).reduce(choose).unwrap_or(f64::NAN)
            };
            Array::new(py, self.walks.0.iter().map(best).collect())?.into_bound_py_any(py)
        };
        columns(py, [
            ("cutoff_hz", self.cutoffs_hz.bound(py)),
            ("true_cutoff_hz", self.true_cutoffs_hz.bound(py)),
            ("area", self.area.bound(py)),
            ("area_low", of(|walk| walk.area, f64::min)?),
            ("area_high", of(|walk| walk.area, f64::max)?),
            ("stiffness_peak_n_per_m", of(|walk| walk.stiffness_peak_n_per_m, f64::max)?),
            ("damping_max_n_s_per_m", of(|walk| walk.damping_max_n_s_per_m, f64::max)?),
        ])
    }
}

/// Walk at every cutoff, and find the ideal cutoff.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment.
/// cutoffs : iterable of float, optional
///     Nominal cutoffs, Hz. Default: the scene's cutoffs.
/// repeat : int
///     Number of walks of each cutoff. The starts are spread over a count.
/// engine, numeric, threads
///     As in `walk`.
/// progress : callable, optional
///     Called from this thread with the number of finished walks and the number of all walks. An exception in this
///     function ends the sweep.
///
/// Raises
/// ------
/// ValueError
///     Something is out of range, or the handle does not reach the wall.
///
/// Examples
/// --------
/// >>> steps = {"stiffness_step_n_per_m": 10e3, "damping_step_n_s_per_m": 100.0}
/// >>> made = sweep(Scene.load("paper-2um").replace(walk=steps), cutoffs=[100, 500, 2000], repeat=2)
/// >>> (made.area / 1e6).round(2).tolist()  # 10^6 N^2 s/m^2
/// [1.4, 24.2, 35.2]
/// >>> made.ideal_cutoff_hz
/// 2000.0
/// >>> made.notes[1]
/// 'the ideal range touches an end of the cutoffs that were tried; it may go on beyond'
#[pyfunction]
#[pyo3(signature = (
    scene, *, cutoffs = None, repeat = 4, engine = "lanes", numeric = "fixed", threads = None, progress = None
))]
pub fn sweep(
    py: Python<'_>,
    scene: Given,
    cutoffs: Option<Numbers>,
    repeat: u32,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Sweep> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let scene = scene.0;
    in_range("repeat", repeat, 1..=1000)?;
    let velocity = &scene.scene.velocity;
    let cutoffs_hz = match &cutoffs {
        Some(_) if !velocity.has_cutoff() => return Err(raised(asked::no_cutoff(&scene))),
        Some(cutoffs_hz) => &cutoffs_hz.0,
        None => &scene.scene.sweep.cutoffs_hz,
    };
    not_empty("cutoffs", cutoffs_hz)?;
    let filters = study::filters(velocity, cutoffs_hz);
    let walls =
        Walls { filters, dampings: vec![0.0], stiffnesses: vec![0.0], start_offset_counts: 0.0 };
    walls.check(&scene, LISTS).map_err(raised)?;
    let total = walls.filters.len() as u64 * u64::from(repeat);
    let name = scene.name.clone();
    let results = run(py, threads, progress.as_ref(), total, move |course| {
        let prepared = asked::prepare(&scene)?;
        let plan = Plan { name: &scene.name, prepared: &prepared, filters: &walls.filters };
        study::sweep(engine, &[plan], numeric, repeat, &course.stop, |_| course.add(1))
    })?;
    let Some(result) = results.into_iter().next() else {
        return Err(raised(Error::Internal("a scene has no result".into())));
    };
    let walks = result.cutoffs.iter().map(|cutoff| {
        let hz = cutoff.velocity.cutoff_hz();
        let walks = cutoff.boundaries.iter();
        walks.map(|boundary| Ok(Part(Py::new(py, walked(py, &name, hz, boundary)?)?))).collect()
    });
    let areas = result.cutoffs.iter().flat_map(|cutoff| cutoff.boundaries.iter());
    let areas: Vec<f64> = areas.map(|boundary| boundary.area).collect();
    let shape = [result.cutoffs.len(), areas.len() / result.cutoffs.len().max(1)];
    let ideal = result.ideal.as_ref();
    Ok(Sweep {
        cutoffs_hz: Array::each(py, &result.cutoffs, |cutoff| cutoff.cutoff_hz)?,
        true_cutoffs_hz: Array::each(py, &result.cutoffs, |cutoff| cutoff.true_cutoff_hz)?,
        area: Array::each(py, &result.cutoffs, |cutoff| cutoff.boundaries.area())?,
        areas: Array::shaped(py, areas, &shape)?,
        walks: walks.collect::<PyResult<_>>()?,
        ideal_cutoff_hz: ideal.map(|ideal| ideal.cutoff_hz),
        ideal_range_hz: ideal.map(|ideal| (ideal.range_hz[0], ideal.range_hz[1])),
        ideal_basis: ideal.map(|ideal| ideal.basis.name().into()),
        notes: result.notes().into_iter().collect(),
        scene: name,
    })
}

result! { table
    /// A grid of walls, each hit once.
    Grid {
        /// Name of the scene.
        scene: String,
        /// Cutoffs of the grid, in Hz.
        cutoffs_hz: Array<f64>,
        /// B of the grid, in N s/m.
        dampings_n_s_per_m: Array<f64>,
        /// K of the grid, in N/m.
        stiffnesses_n_per_m: Array<f64>,
        /// The verdict of each wall, as an index of `zwidth.VERDICTS`. The shape is (cutoffs, dampings, stiffnesses).
        verdict: Array<u8>,
        /// RMS of the counts in m, with the same shape. It is NaN for a hit without an RMS.
        rms_m: Array<f64>,
        /// Whether each wall is stable, with the same shape.
        stable: Array<bool>,
    }

    /// The columns of the table. Their names are those of the command line's CSV.
    fn columns(slf: &Bound<'_, Self>) -> PyResult<Keys> {
        let (py, own, numpy) = (slf.py(), slf.get(), slf.py().import("numpy")?);
        let axes = (
            own.cutoffs_hz.bound(py),
            own.dampings_n_s_per_m.bound(py),
            own.stiffnesses_n_per_m.bound(py),
        );
        let keywords = PyDict::new(py);
        keywords.set_item("indexing", "ij")?;
        let axes = numpy.call_method("meshgrid", axes, Some(&keywords))?;
        let axis = |n: usize| axes.get_item(n)?.call_method0("ravel");
        let names = numpy.call_method1("array", (VERDICTS,))?;
        columns(py, [
            ("cutoff_hz", axis(0)?),
            ("damping_n_s_per_m", axis(1)?),
            ("stiffness_n_per_m", axis(2)?),
            ("verdict", names.get_item(own.verdict.bound(py).call_method0("ravel")?)?),
            ("rms_m", own.rms_m.bound(py).call_method0("ravel")?),
        ])
    }
}

/// Hit every wall of a grid once.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment.
/// stiffnesses, dampings : iterable of float
///     K, N/m, and B, N s/m.
/// cutoffs : iterable of float, optional
///     Nominal cutoffs, Hz. Omit them for an estimator without a cutoff.
/// start_offset, engine, numeric, threads
///     As in `walk`.
/// progress : callable, optional
///     Called from this thread with the number of finished walls and the number of all walls. An exception in this
///     function ends the grid.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range, or a list is empty.
///
/// Examples
/// --------
/// >>> scene = Scene.load("paper-2um")
/// >>> made = grid(scene, stiffnesses=[10e3, 40e3, 160e3], dampings=[10, 100], cutoffs=[500])
/// >>> made.stable.tolist()  # by cutoff, B and K
/// [[[False, False, False], [True, True, False]]]
/// >>> (made.rms_m[0, 1] * 1e6).round(2).tolist()  # um
/// [1.02, 1.35, 868.12]
#[pyfunction]
#[pyo3(signature = (
    scene, *, stiffnesses, dampings, cutoffs = None, start_offset = 0.0, engine = "lanes", numeric = "fixed",
    threads = None, progress = None
))]
pub fn grid(
    py: Python<'_>,
    scene: Given,
    stiffnesses: Numbers,
    dampings: Numbers,
    cutoffs: Option<Numbers>,
    start_offset: f64,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Grid> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let scene = scene.0;
    let filters = match cutoffs {
        Some(_) if !scene.scene.velocity.has_cutoff() => {
            return Err(raised(asked::no_cutoff(&scene)));
        }
        Some(cutoffs_hz) => {
            not_empty("cutoffs", &cutoffs_hz.0)?;
            asked::filters(&scene, &cutoffs_hz.0).map_err(raised)?
        }
        None => vec![asked::filter(&scene, None).map_err(raised)?],
    };
    let (dampings, stiffnesses) = (dampings.0, stiffnesses.0);
    for (name, list) in [("dampings", &dampings), ("stiffnesses", &stiffnesses)] {
        not_empty(name, list)?;
    }
    let walls = Walls { filters, dampings, stiffnesses, start_offset_counts: start_offset };
    let total = walls.count();
    let name = scene.name.clone();
    let (walls, verdicts, rms) = run(py, threads, progress.as_ref(), total, move |course| {
        walls.check(&scene, LISTS)?;
        let prepared = asked::prepare(&scene)?;
        let (mut verdicts, mut rms) = (vec![], vec![]);
        let wall = |number| walls.wall(number);
        let sink = |_, outcome: Result<sim_loop::engine::Outcome, HitError>| {
            let (verdict, rms_m) = match outcome {
                Ok(outcome) => (code(outcome.verdict), outcome.rms_m),
                Err(HitError::OutOfRange(_)) => (OUT_OF_RANGE, None),
                Err(error) => return Err(error.into()),
            };
            verdicts.push(verdict);
            rms.push(rms_m.unwrap_or(f64::NAN));
            course.add(1);
            Ok(())
        };
        stream(engine, &prepared, numeric, Depth::Whole, total, wall, &course.stop, sink)?;
        Ok((walls, verdicts, rms))
    })?;
    let cutoffs_hz = walls.filters.iter().map(|filter| filter.cutoff_hz().unwrap_or_default());
    let cutoffs_hz: Vec<f64> = cutoffs_hz.collect();
    let shape = [cutoffs_hz.len(), walls.dampings.len(), walls.stiffnesses.len()];
    let stable = verdicts.iter().map(|verdict| *verdict == code(Verdict::Stable)).collect();
    Ok(Grid {
        scene: name,
        cutoffs_hz: Array::new(py, cutoffs_hz)?,
        dampings_n_s_per_m: Array::new(py, walls.dampings)?,
        stiffnesses_n_per_m: Array::new(py, walls.stiffnesses)?,
        verdict: Array::shaped(py, verdicts, &shape)?,
        rms_m: Array::shaped(py, rms, &shape)?,
        stable: Array::shaped(py, stable, &shape)?,
    })
}

/// The index of a verdict in [`VERDICTS`].
fn code(verdict: Verdict) -> u8 {
    match verdict {
        Verdict::Stable => 0,
        Verdict::Unstable => 1,
        Verdict::NoContact => 2,
    }
}
const OUT_OF_RANGE: u8 = 3;

result! { table
    /// The linear stability boundary at one cutoff (paper, section 2.1).
    Linear {
        /// Name of the scene.
        scene: String,
        /// Nominal cutoff in Hz; None for an estimator without a cutoff.
        cutoff_hz: Option<f64>,
        /// B of the walls, in N s/m.
        damping_n_s_per_m: Array<f64>,
        /// Largest stable K at each B, in N/m. Every K from 0 to this value is stable. It is infinite if no K is
        /// unstable.
        stiffness_max_n_per_m: Array<f64>,
        /// Whether the paper's gain-margin method gives the same result.
        gain_margin_holds: Array<bool>,
        /// Largest passive K at each B, in N/m. Up to this K, no motion takes energy out of wall and damper. It is 0 if
        /// there is no such K. None without `passivity`.
        stiffness_passive_n_per_m: Option<Array<f64>>,
        /// Names of the scene's tables that the linear analysis ignores.
        left_out: Tuple<String>,
    }

    /// The columns of the table. Their names are those of the command line's CSV.
    fn columns(&self, py: Python<'_>) -> PyResult<Keys> {
        let b = self.damping_n_s_per_m.bound(py);
        let passive = self.stiffness_passive_n_per_m.as_ref();
        let passive = passive.map(|k| ("stiffness_passive_n_per_m", k.bound(py)));
        let all = [
            ("cutoff_hz", cutoffs(py, self.cutoff_hz, b.len()?)?),
            ("damping_n_s_per_m", b),
            ("stiffness_max_n_per_m", self.stiffness_max_n_per_m.bound(py)),
        ];
        columns(py, all.into_iter().chain(passive))
    }
}

/// Linear stability boundary K(B). Quantisation and saturation are ignored. The wall acts on both sides of its surface.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and linear elements.
/// dampings : iterable of float
///     B of the wall, N s/m.
/// cutoff : float, optional
///     Nominal cutoff of the velocity filter, Hz.
/// multirate : bool
///     True: the loop with the scene's output period and latency. False: a new force at every sample without latency,
///     as in the paper's equations (3) to (5).
/// passivity : bool
///     Add the largest K that is passive for any hand or load on the handle.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range, or the estimator is no linear function of the position alone.
///
/// Examples
/// --------
/// >>> made = linear(Scene.load("paper-2um"), dampings=[0, 30, 300], cutoff=500, passivity=True)
/// >>> made.stiffness_max_n_per_m.round().tolist()
/// [110414.0, 571914.0, 1451017.0]
/// >>> made.stiffness_passive_n_per_m.round().tolist()  # 0: none
/// [110390.0, 0.0, 0.0]
#[pyfunction]
#[pyo3(signature = (scene, *, dampings, cutoff = None, multirate = false, passivity = false))]
pub fn linear(
    py: Python<'_>,
    scene: Given,
    dampings: Numbers,
    cutoff: Option<f64>,
    multirate: bool,
    passivity: bool,
) -> PyResult<Linear> {
    let scene = scene.0;
    not_empty("dampings", &dampings.0)?;
    let filter = asked::filter(&scene, cutoff).map_err(raised)?;
    let walls = Walls {
        filters: vec![filter],
        dampings: dampings.0,
        stiffnesses: vec![0.0],
        start_offset_counts: 0.0,
    };
    walls.check(&scene, LISTS).map_err(raised)?;
    let of_work = Arc::clone(&scene);
    let (walls, limits, passive) = run(py, None, None, 0, move |course| {
        let scene = of_work;
        let of = asked::linear_loop(&scene.scene, &filter, multirate)?;
        let boundary = LinearBoundary::new(&of).map_err(Error::input)?;
        let passivity = passivity.then(|| Passivity::new(&of)).transpose().map_err(Error::input)?;
        let (mut limits, mut passive): (Vec<StiffnessLimit>, Vec<f64>) = (vec![], vec![]);
        for &damping in &walls.dampings {
            if course.stop.load(Relaxed) {
                return Err(Error::Interrupted);
            }
            limits.push(boundary.at(damping).map_err(Error::input)?);
            if let Some(passivity) = &passivity {
                let b = scene.scene.device.damping_n_s_per_m;
                let limit = passivity.stiffness_max(b, damping).map_err(Error::input)?;
                passive.push(limit.unwrap_or(0.0));
            }
        }
        Ok((walls, limits, passive))
    })?;
    let passive = (!passive.is_empty()).then(|| Array::new(py, passive)).transpose()?;
    Ok(Linear {
        scene: scene.name.clone(),
        cutoff_hz: filter.cutoff_hz(),
        damping_n_s_per_m: Array::new(py, walls.dampings)?,
        stiffness_max_n_per_m: Array::each(py, &limits, |limit| limit.stiffness_max)?,
        gain_margin_holds: Array::each(py, &limits, StiffnessLimit::gain_margin_holds)?,
        stiffness_passive_n_per_m: passive,
        left_out: scene.scene.nonlinear_elements().into_iter().map(Into::into).collect(),
    })
}
