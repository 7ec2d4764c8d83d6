//! Hits, walks, sweeps, grids and the linear boundary. Each returns plain values; `zwidth/results.py` gives them names.

use std::{
    ops::RangeInclusive,
    sync::{Arc, atomic::Ordering::Relaxed},
};

use numpy::{IntoPyArray as _, PyArray1};
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use sim_loop::{
    engine::{Depth, Engine, stream},
    error::Error,
    range::within,
    simulation::{
        prepared::{HitError, Numeric},
        trace::Trace,
    },
};
use sim_studies::{
    analysis::linear::{Boundary as LinearBoundary, StiffnessLimit, passivity::Passivity},
    study::{
        asked::{self, Names, Walls},
        boundary::Boundary,
        sweep::{self as study, Plan},
    },
};
use zwidth::experiment::{Ended, Verdict};

use crate::{
    columns::Columns,
    scene::Scene,
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

pub fn numeric_of(name: &str) -> PyResult<Numeric> {
    [Numeric::Fixed, Numeric::F64, Numeric::F64Rounded]
        .into_iter()
        .find(|numeric| numeric.name() == name)
        .ok_or_else(|| {
            PyValueError::new_err(format!("numeric is {name:?}, allowed fixed, f64, f64-rounded"))
        })
}

pub fn engine_of(name: &str) -> PyResult<Engine> {
    match name {
        "core" => Ok(Engine::Core),
        "lanes" => Ok(Engine::lanes()),
        _ => Err(PyValueError::new_err(format!("engine is {name:?}, allowed core, lanes"))),
    }
}

/// Refuses a count that the command line would refuse.
pub fn in_range(name: &str, value: u32, range: RangeInclusive<u32>) -> PyResult<()> {
    let range = f64::from(*range.start())..=f64::from(*range.end());
    within(name, f64::from(value), range).map_err(PyValueError::new_err)
}

/// One hit on a wall.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of a function")]
pub fn hit<'py>(
    py: Python<'py>,
    scene: &Scene,
    stiffness: f64,
    damping: f64,
    cutoff: Option<f64>,
    start_offset: f64,
    numeric: &str,
    trace: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let (scene, numeric) = (Arc::clone(&scene.0), numeric_of(numeric)?);
    let hit = asked::hit(&scene, cutoff, Some([stiffness, damping]), start_offset, NAMES)
        .map_err(raised)?;
    let cutoff_hz = hit.velocity.cutoff_hz();
    let passive = scene.scene.passivity.is_some();
    let (report, samples) = run(py, None, None, 0, move |_| {
        let prepared = asked::prepare(&scene)?.with_felt();
        if !trace {
            return Ok((prepared.hit(numeric, &hit, |_| ())?, None));
        }
        let mut samples = Trace::new(&prepared, &hit).map_err(|error| error.of(&scene.name))?;
        let report = prepared.hit(numeric, &hit, |sample| samples.push(sample))?;
        Ok((report, Some(traced(&samples))))
    })?;
    let made = PyDict::new(py);
    made.set_item("cutoff_hz", cutoff_hz)?;
    made.set_item("verdict", report.verdict.name())?;
    made.set_item("rms_m", report.rms_m)?;
    made.set_item("rms_motion_m", report.rms_motion_m)?;
    made.set_item("mean_m", report.mean_m)?;
    made.set_item("peak_penetration_m", report.peak_penetration_m)?;
    made.set_item("saturated_fraction", report.saturated_fraction)?;
    made.set_item("contact_fraction", report.contact_fraction)?;
    made.set_item("velocity_clipped_fraction", report.velocity_clipped_fraction)?;
    made.set_item("window_at_limit_fraction", report.at_limit_fraction)?;
    made.set_item("sensation_db", report.sensation_db)?;
    made.set_item("port_taken_j", report.port.taken_j)?;
    made.set_item("port_given_j", report.port.given_j)?;
    let limited = passive.then_some(report.port.limited_fraction);
    made.set_item("port_limited_fraction", limited)?;
    let withheld = passive.then_some(report.port.withheld_fraction);
    made.set_item("port_withheld_fraction", withheld)?;
    if let Some(samples) = samples {
        made.set_item("trace", samples.into_dict(py)?)?;
    }
    Ok(made)
}

fn traced(trace: &Trace) -> Columns {
    let rows = || trace.rows.iter();
    #[expect(clippy::cast_precision_loss, reason = "at most 2^25 samples")]
    let time_s = |n: usize| n as f64 / trace.rate_hz;
    Columns::default()
        .with("time_s", (0..trace.rows.len()).map(time_s))
        .with("position_m", rows().map(|row| row.position_m))
        .with("velocity_m_per_s", rows().map(|row| row.velocity_m_per_s))
        .with("force_n", rows().map(|row| row.force_n))
        .with("output_n", rows().map(|row| row.output_n))
        .with("port_energy_j", rows().map(|row| row.port_energy_j))
        .with("count", rows().map(|row| row.count))
        .with("flags", rows().map(|row| row.flags))
}

fn boundary_dict<'py>(py: Python<'py>, boundary: &Boundary) -> PyResult<Bound<'py, PyDict>> {
    let made = PyDict::new(py);
    let (b, k): (Vec<f64>, Vec<f64>) = boundary
        .points
        .iter()
        .map(|point| (point.damping_n_s_per_m, point.stiffness_n_per_m))
        .unzip();
    made.set_item("damping_n_s_per_m", b.into_pyarray(py))?;
    made.set_item("stiffness_n_per_m", k.into_pyarray(py))?;
    made.set_item("area", boundary.area)?;
    made.set_item("hits", boundary.hits)?;
    made.set_item("ended_by", boundary.ended.map(Ended::name))?;
    Ok(made)
}

/// The boundary of the stable walls at one cutoff.
#[pyfunction]
pub fn walk<'py>(
    py: Python<'py>,
    scene: &Scene,
    cutoff: Option<f64>,
    start_offset: f64,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let scene = Arc::clone(&scene.0);
    let first = asked::hit(&scene, cutoff, None, start_offset, NAMES).map_err(raised)?;
    let cutoff_hz = first.velocity.cutoff_hz();
    let boundary = run(py, threads, None, 0, move |course| {
        let prepared = asked::prepare(&scene)?;
        asked::boundary(&scene, engine, &prepared, numeric, &first, &course.stop)
    })?;
    let made = boundary_dict(py, &boundary)?;
    made.set_item("cutoff_hz", cutoff_hz)?;
    Ok(made)
}

/// Walks at every cutoff, repeated from several starts.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of a function")]
pub fn sweep<'py>(
    py: Python<'py>,
    scene: &Scene,
    cutoffs: Option<Vec<f64>>,
    repeat: u32,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let scene = Arc::clone(&scene.0);
    in_range("repeat", repeat, 1..=1000)?;
    let velocity = &scene.scene.velocity;
    let cutoffs_hz = match &cutoffs {
        Some(_) if !velocity.has_cutoff() => return Err(raised(asked::no_cutoff(&scene))),
        Some(cutoffs_hz) if cutoffs_hz.is_empty() => {
            return Err(PyValueError::new_err("cutoffs is empty"));
        }
        Some(cutoffs_hz) => cutoffs_hz,
        None => &scene.scene.sweep.cutoffs_hz,
    };
    let filters = study::filters(velocity, cutoffs_hz);
    let walls =
        Walls { filters, dampings: vec![0.0], stiffnesses: vec![0.0], start_offset_counts: 0.0 };
    walls.check(&scene, LISTS).map_err(raised)?;
    let total = walls.filters.len() as u64 * u64::from(repeat);
    let results = run(py, threads, progress, total, move |course| {
        let prepared = asked::prepare(&scene)?;
        let plan = Plan { name: &scene.name, prepared: &prepared, filters: &walls.filters };
        study::sweep(engine, &[plan], numeric, repeat, &course.stop, |_| course.add(1))
    })?;
    let Some(result) = results.into_iter().next() else {
        return Err(raised(Error::Internal("a scene has no result".into())));
    };
    let made = PyDict::new(py);
    let column = |of: fn(&study::CutoffResult) -> f64| -> Bound<'py, PyArray1<f64>> {
        result.cutoffs.iter().map(of).collect::<Vec<_>>().into_pyarray(py)
    };
    made.set_item("cutoffs_hz", column(|cutoff| cutoff.cutoff_hz))?;
    made.set_item("true_cutoffs_hz", column(|cutoff| cutoff.true_cutoff_hz))?;
    let walks: PyResult<Vec<Vec<_>>> = result
        .cutoffs
        .iter()
        .map(|cutoff| {
            cutoff.boundaries.iter().map(|boundary| boundary_dict(py, boundary)).collect()
        })
        .collect();
    made.set_item("walks", walks?)?;
    made.set_item("area", column(|cutoff| cutoff.boundaries.area()))?;
    let ideal = result.ideal.as_ref();
    made.set_item("ideal_cutoff_hz", ideal.map(|ideal| ideal.cutoff_hz))?;
    made.set_item("ideal_range_hz", ideal.map(|ideal| (ideal.range_hz[0], ideal.range_hz[1])))?;
    made.set_item("ideal_basis", ideal.map(|ideal| ideal.basis.name()))?;
    made.set_item("notes", result.notes())?;
    Ok(made)
}

/// Every wall of a grid, hit once.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "keywords of a function")]
pub fn grid<'py>(
    py: Python<'py>,
    scene: &Scene,
    cutoffs: Option<Vec<f64>>,
    dampings: Vec<f64>,
    stiffnesses: Vec<f64>,
    start_offset: f64,
    engine: &str,
    numeric: &str,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (engine, numeric) = (engine_of(engine)?, numeric_of(numeric)?);
    let scene = Arc::clone(&scene.0);
    let filters = match cutoffs {
        Some(_) if !scene.scene.velocity.has_cutoff() => {
            return Err(raised(asked::no_cutoff(&scene)));
        }
        Some(cutoffs_hz) => asked::filters(&scene, &cutoffs_hz).map_err(raised)?,
        None => vec![asked::filter(&scene, None).map_err(raised)?],
    };
    let lengths = [filters.len(), dampings.len(), stiffnesses.len()];
    for (name, length) in ["cutoffs", "dampings", "stiffnesses"].into_iter().zip(lengths) {
        if length == 0 {
            return Err(PyValueError::new_err(format!("{name} is empty")));
        }
    }
    let walls = Walls { filters, dampings, stiffnesses, start_offset_counts: start_offset };
    let total = walls.count();
    let (walls, verdicts, rms) = run(py, threads, progress, total, move |course| {
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
    let made = PyDict::new(py);
    let cutoffs_hz = walls.filters.iter().map(|filter| filter.cutoff_hz().unwrap_or_default());
    made.set_item("cutoffs_hz", cutoffs_hz.collect::<Vec<_>>().into_pyarray(py))?;
    made.set_item("dampings_n_s_per_m", walls.dampings.into_pyarray(py))?;
    made.set_item("stiffnesses_n_per_m", walls.stiffnesses.into_pyarray(py))?;
    made.set_item("verdict", verdicts.into_pyarray(py))?;
    made.set_item("rms_m", rms.into_pyarray(py))?;
    Ok(made)
}

/// Codes of verdicts in a grid, in the order of `zwidth.VERDICTS`.
fn code(verdict: Verdict) -> u8 {
    match verdict {
        Verdict::Stable => 0,
        Verdict::Unstable => 1,
        Verdict::NoContact => 2,
    }
}
const OUT_OF_RANGE: u8 = 3;

/// The linear stability boundary at one cutoff.
#[pyfunction]
pub fn linear<'py>(
    py: Python<'py>,
    scene: &Scene,
    cutoff: Option<f64>,
    dampings: Vec<f64>,
    multirate: bool,
    passivity: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let scene = Arc::clone(&scene.0);
    if dampings.is_empty() {
        return Err(PyValueError::new_err("dampings is empty"));
    }
    let filter = asked::filter(&scene, cutoff).map_err(raised)?;
    let walls =
        Walls { filters: vec![filter], dampings, stiffnesses: vec![0.0], start_offset_counts: 0.0 };
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
    let made = PyDict::new(py);
    made.set_item("cutoff_hz", filter.cutoff_hz())?;
    made.set_item("damping_n_s_per_m", walls.dampings.into_pyarray(py))?;
    let stiffness: Vec<f64> = limits.iter().map(|limit| limit.stiffness_max).collect();
    made.set_item("stiffness_max_n_per_m", stiffness.into_pyarray(py))?;
    let holds: Vec<bool> = limits.iter().map(StiffnessLimit::gain_margin_holds).collect();
    made.set_item("gain_margin_holds", holds.into_pyarray(py))?;
    let passive = (!passive.is_empty()).then(|| passive.into_pyarray(py));
    made.set_item("stiffness_passive_n_per_m", passive)?;
    made.set_item("left_out", scene.scene.nonlinear_elements())?;
    Ok(made)
}
