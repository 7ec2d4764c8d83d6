//! A capture of a board's telemetry as columns. `zwidth/telemetry.py` gives them names.

use numpy::IntoPyArray as _;
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use sim_studies::analysis::{recompute::Recomputed, telemetry::Capture};
use zwidth::telemetry::{Frame, Record};

use crate::work::run;

/// Every output and every sample of a capture, with what the core computes once more.
#[pyfunction]
pub fn decode<'py>(py: Python<'py>, data: &[u8]) -> PyResult<Bound<'py, PyDict>> {
    let (capture, all) = run(py, None, None, 0, |course| {
        let capture = Capture::decode_until(data, course.stop);
        let all = Recomputed::until(&capture, course.stop);
        Ok((capture, all))
    })?;
    if capture.frames.is_empty() {
        let length = data.len();
        return Err(PyValueError::new_err(format!(
            "no telemetry frame of layout 1 or 2 in {length} bytes; docs/telemetry.md has the layout"
        )));
    }
    let made = PyDict::new(py);
    made.set_item("outputs", outputs(py, &capture.frames)?)?;
    made.set_item("samples", samples(py, &all)?)?;
    made.set_item("dropped", capture.dropped)?;
    made.set_item("garbage_bytes", capture.garbage_bytes)?;
    made.set_item("faults", capture.faults().into_iter().map(u32::from).collect::<Vec<_>>())?;
    made.set_item("gaps", all.gaps())?;
    made.set_item("unknown", &all.unknown)?;
    made.set_item("computed", all.computed)?;
    made.set_item("velocities_equal", all.velocities)?;
    made.set_item("forces_equal", all.forces)?;
    made.set_item("states_equal", all.states)?;
    made.set_item("energies_equal", all.energies)?;
    made.set_item("first_difference", all.first_difference().map(ToString::to_string))?;
    let design =
        capture.chunks.iter().flat_map(|chunk| &chunk.settings).map(|told| told.design).next();
    made.set_item("rate_hz", design.map(|design| design.rate_hz))?;
    made.set_item("resolution_m", design.map(|design| design.resolution_m))?;
    made.set_item("full_scale_n", design.map(|design| design.full_scale_n))?;
    Ok(made)
}

fn outputs<'py>(py: Python<'py>, frames: &[Frame]) -> PyResult<Bound<'py, PyDict>> {
    type Of = fn(&Record) -> i32;
    let columns = PyDict::new(py);
    let sequence: Vec<u32> = frames.iter().map(|frame| frame.sequence).collect();
    let sample: Vec<u64> = frames.iter().map(|frame| frame.record.sample).collect();
    columns.set_item("sequence", sequence.into_pyarray(py))?;
    columns.set_item("sample", sample.into_pyarray(py))?;
    let signed: [(_, Of); 4] = [
        ("position_counts", |record| record.position.counts()),
        ("velocity_q16", |record| record.velocity.bits()),
        ("force_q30", |record| record.force.bits()),
        ("command", |record| record.command.code()),
    ];
    for (name, of) in signed {
        let column: Vec<i32> = frames.iter().map(|frame| of(&frame.record)).collect();
        columns.set_item(name, column.into_pyarray(py))?;
    }
    let flags: Vec<u16> = frames.iter().map(|frame| frame.record.flags.bits()).collect();
    let settings: Vec<u16> = frames.iter().map(|frame| frame.record.settings).collect();
    let fault: Vec<u8> = frames.iter().map(|frame| frame.record.fault).collect();
    columns.set_item("flags", flags.into_pyarray(py))?;
    columns.set_item("settings", settings.into_pyarray(py))?;
    columns.set_item("fault", fault.into_pyarray(py))?;
    Ok(columns)
}

/// What is not known is 0, with a column that says so.
fn samples<'py>(py: Python<'py>, all: &Recomputed) -> PyResult<Bound<'py, PyDict>> {
    let (columns, rows) = (PyDict::new(py), &all.rows);
    let sample: Vec<u64> = rows.iter().map(|row| row.sample).collect();
    columns.set_item("sample", sample.into_pyarray(py))?;
    let numbers: [(_, Vec<i32>); 3] = [
        ("position_counts", rows.iter().map(|row| row.position.counts()).collect()),
        ("velocity_q16", rows.iter().map(|row| row.velocity.map_or(0, |v| v.bits())).collect()),
        ("force_q30", rows.iter().map(|row| row.force.map_or(0, |force| force.bits())).collect()),
    ];
    for (name, column) in numbers {
        columns.set_item(name, column.into_pyarray(py))?;
    }
    let facts: [(_, Vec<bool>); 3] = [
        ("output", rows.iter().map(|row| row.told.is_some()).collect()),
        ("computed", rows.iter().map(|row| row.velocity.is_some()).collect()),
        ("driven", rows.iter().map(|row| row.force.is_some()).collect()),
    ];
    for (name, column) in facts {
        columns.set_item(name, column.into_pyarray(py))?;
    }
    Ok(columns)
}
