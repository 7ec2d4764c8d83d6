//! A capture of a board's telemetry as columns. `zwidth/telemetry.py` gives them names.

use pyo3::{exceptions::PyValueError, prelude::*, pybacked::PyBackedBytes, types::PyDict};
use sim_studies::analysis::{recompute::Recomputed, telemetry::Capture};
use zwidth::telemetry::Frame;

use crate::{columns::Columns, work::run};

/// Every output and every sample of a capture, with what the core computes once more.
#[pyfunction]
pub fn decode(py: Python<'_>, data: PyBackedBytes) -> PyResult<Bound<'_, PyDict>> {
    let length = data.len();
    let (capture, all, outputs, samples) = run(py, None, None, 0, move |course| {
        let capture = Capture::decode_until(&data, &course.stop);
        let all = Recomputed::until(&capture, &course.stop);
        let (outputs, samples) = (outputs(&capture.frames), samples(&all));
        Ok((capture, all, outputs, samples))
    })?;
    if capture.frames.is_empty() {
        return Err(PyValueError::new_err(format!(
            "no telemetry frame of layout 1 or 2 in {length} bytes; docs/telemetry.md has the layout"
        )));
    }
    let made = PyDict::new(py);
    made.set_item("outputs", outputs.into_dict(py)?)?;
    made.set_item("samples", samples.into_dict(py)?)?;
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

fn outputs(frames: &[Frame]) -> Columns {
    let records = || frames.iter().map(|frame| &frame.record);
    Columns::default()
        .with("sequence", frames.iter().map(|frame| frame.sequence))
        .with("sample", records().map(|record| record.sample))
        .with("position_counts", records().map(|record| record.position.counts()))
        .with("velocity_q16", records().map(|record| record.velocity.bits()))
        .with("force_q30", records().map(|record| record.force.bits()))
        .with("command", records().map(|record| record.command.code()))
        .with("flags", records().map(|record| record.flags.bits()))
        .with("settings", records().map(|record| record.settings))
        .with("fault", records().map(|record| record.fault))
}

/// What is not known is 0, with a column that says so.
fn samples(all: &Recomputed) -> Columns {
    let rows = || all.rows.iter();
    Columns::default()
        .with("sample", rows().map(|row| row.sample))
        .with("position_counts", rows().map(|row| row.position.counts()))
        .with("velocity_q16", rows().map(|row| row.velocity.map_or(0, |v| v.bits())))
        .with("force_q30", rows().map(|row| row.force.map_or(0, |force| force.bits())))
        .with("output", rows().map(|row| row.told.is_some()))
        .with("computed", rows().map(|row| row.velocity.is_some()))
        .with("driven", rows().map(|row| row.force.is_some()))
}
