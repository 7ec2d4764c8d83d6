//! Reads a capture of a board's telemetry into columns.

use std::{
    fs,
    io::{self, Write as _},
    path::Path,
};

use pyo3::{
    exceptions::{PyOSError, PyValueError},
    prelude::*,
    types::PyBytes,
};
use sim_studies::analysis::{recompute::Recomputed, telemetry::Capture};
use zwidth::telemetry::Frame;

use crate::{
    given::Place,
    result::{Array, Bytes, Part, Tuple, result},
    work::run,
};

result! { arrays
    /// One row per output. The numbers are the integers of the control loop. The columns are those of `cargo sim
    /// telemetry --csv`.
    Outputs {
        /// Sequence number of the frame that has this output.
        sequence: Array<u32>,
        /// Number of the sample since the board's reset.
        sample: Array<u64>,
        /// Position of the handle, in counts.
        position_counts: Array<i32>,
        /// Velocity, in 2^-16 counts per sample.
        velocity_q16: Array<i32>,
        /// Force, in 2^-30 of full scale. It is positive into the wall.
        force_q30: Array<i32>,
        /// Output code of the DAC or the PWM.
        command: Array<i32>,
        /// Flags of the output; docs/telemetry.md explains them.
        flags: Array<u16>,
        /// Number of the settings that the board uses.
        settings: Array<u16>,
        /// Code of the fault that is latched; 0 for none.
        fault: Array<u8>,
    }
}

result! { arrays
    /// One row per sample, with the columns of `cargo sim telemetry --samples`.
    Samples {
        /// Number of the sample since the board's reset.
        sample: Array<u64>,
        /// Position of the handle, in counts.
        position_counts: Array<i32>,
        /// Velocity that the core computes, in 2^-16 counts per sample. It is 0 if it cannot be computed.
        velocity_q16: Array<i32>,
        /// Force of the last output, in 2^-30 of full scale. It is 0 before the first output.
        force_q30: Array<i32>,
        /// Whether the sample has an output.
        output: Array<bool>,
        /// Whether the velocity is known.
        computed: Array<bool>,
        /// Whether the force is known.
        driven: Array<bool>,
    }
}

result! { plain
    /// A decoded capture of a board's telemetry.
    ///
    /// Examples
    /// --------
    /// >>> told = Telemetry.load("examples/samples.bin")  # doctest: +SKIP
    /// >>> told.outputs.force_q30 / 2**30 * told.full_scale_n  # doctest: +SKIP
    Telemetry {
        /// The received bytes.
        capture: Bytes,
        /// One row for every output.
        outputs: Part<Outputs>,
        /// One row for every sample.
        samples: Part<Samples>,
        /// Number of frames that are missing between received frames.
        dropped: u64,
        /// Number of bytes that belong to no frame, for example the end of a frame that began before the capture.
        garbage_bytes: u64,
        /// Codes of the faults that were latched during the capture.
        faults: Tuple<u32>,
        /// First and last sample of each gap in the outputs.
        gaps: Tuple<(u64, u64)>,
        /// Ranges of samples that the core cannot compute. Each has its first sample, its last sample and the reason.
        unknown: Tuple<(u64, u64, String)>,
        /// Number of samples that the core has computed.
        computed: u64,
        /// Number of velocities that are equal to the board's velocities, bit for bit.
        velocities_equal: u64,
        /// Number of forces that are equal to the board's forces, bit for bit.
        forces_equal: u64,
        /// Number of estimator states that are equal to the board's states, bit for bit.
        states_equal: u64,
        /// Number of port energies that are equal to the board's energies, bit for bit.
        energies_equal: u64,
        /// Text of the first difference between board and core; None if there is none.
        first_difference: Option<String>,
        /// Sample rate of the first settings in the capture, in Hz; None without settings.
        rate_hz: Option<f64>,
        /// Length of a count at the handle in m, also for a rotary device; None without settings.
        resolution_m: Option<f64>,
        /// Force at full command, in N; None without settings.
        full_scale_n: Option<f64>,
    }

    /// Decode bytes of RTT up channel 1. The bytes may begin and end within a frame.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     The bytes have no frame.
    ///
    /// Examples
    /// --------
    /// >>> Telemetry.decode(b"no frame")
    /// Traceback (most recent call last):
    ///     ...
    /// ValueError: no telemetry frame of layout 1 or 2 in 8 bytes; docs/telemetry.md has the layout
    #[staticmethod]
    fn decode(py: Python<'_>, capture: Vec<u8>) -> PyResult<Self> {
        decode(py, capture)
    }

    /// Decode a capture in a file.
    #[staticmethod]
    fn load(py: Python<'_>, path: Place) -> PyResult<Self> {
        let bytes = fs::read(&path.0).map_err(|error| of_file(&error, &path.0))?;
        decode(py, bytes)
    }

    /// Write the capture to a file for `cargo sim telemetry`, `replay` and `identify`. `force` replaces an existing
    /// file.
    #[pyo3(signature = (path, *, force = false))]
    fn save(&self, py: Python<'_>, path: Place, force: bool) -> PyResult<()> {
        let mut options = fs::OpenOptions::new();
        options.write(true).create(force).truncate(force).create_new(!force);
        let bytes = self.capture.0.bind(py).cast::<PyBytes>()?;
        let written = options.open(&path.0).and_then(|mut file| file.write_all(bytes.as_bytes()));
        written.map_err(|error| of_file(&error, &path.0))
    }
}

/// The exception that Python's own file functions raise.
fn of_file(error: &io::Error, path: &Path) -> PyErr {
    let text = error.to_string().split(" (os error").next().unwrap_or_default().to_owned();
    PyOSError::new_err((error.raw_os_error(), text, path.display().to_string()))
}

fn decode(py: Python<'_>, bytes: Vec<u8>) -> PyResult<Telemetry> {
    let capture = PyBytes::new(py, &bytes).into_any().unbind();
    let length = bytes.len();
    let (told, all) = run(py, None, None, 0, move |course| {
        let capture = Capture::decode_until(&bytes, &course.stop);
        let all = Recomputed::until(&capture, &course.stop);
        Ok((capture, all))
    })?;
    if told.frames.is_empty() {
        return Err(PyValueError::new_err(format!(
            "no telemetry frame of layout 1 or 2 in {length} bytes; docs/telemetry.md has the layout"
        )));
    }
    let mut designs = told.chunks.iter().flat_map(|chunk| &chunk.settings).map(|told| told.design);
    let design = designs.next();
    Ok(Telemetry {
        capture: Bytes(capture),
        outputs: Part(Py::new(py, outputs(py, &told.frames)?)?),
        samples: Part(Py::new(py, samples(py, &all)?)?),
        dropped: told.dropped,
        garbage_bytes: told.garbage_bytes,
        faults: told.faults().into_iter().map(u32::from).collect(),
        gaps: all.gaps().into_iter().collect(),
        unknown: all.unknown.iter().map(|(from, to, why)| (*from, *to, why.to_string())).collect(),
        computed: all.computed,
        velocities_equal: all.velocities,
        forces_equal: all.forces,
        states_equal: all.states,
        energies_equal: all.energies,
        first_difference: all.first_difference().map(ToString::to_string),
        rate_hz: design.map(|design| design.rate_hz),
        resolution_m: design.map(|design| design.resolution_m),
        full_scale_n: design.map(|design| design.full_scale_n),
    })
}

fn outputs(py: Python<'_>, frames: &[Frame]) -> PyResult<Outputs> {
    Ok(Outputs {
        sequence: Array::each(py, frames, |frame| frame.sequence)?,
        sample: Array::each(py, frames, |frame| frame.record.sample)?,
        position_counts: Array::each(py, frames, |frame| frame.record.position.counts())?,
        velocity_q16: Array::each(py, frames, |frame| frame.record.velocity.bits())?,
        force_q30: Array::each(py, frames, |frame| frame.record.force.bits())?,
        command: Array::each(py, frames, |frame| frame.record.command.code())?,
        flags: Array::each(py, frames, |frame| frame.record.flags.bits())?,
        settings: Array::each(py, frames, |frame| frame.record.settings)?,
        fault: Array::each(py, frames, |frame| frame.record.fault)?,
    })
}

/// An unknown value is 0 in the table. Another column marks it as unknown.
fn samples(py: Python<'_>, all: &Recomputed) -> PyResult<Samples> {
    let rows = &all.rows;
    Ok(Samples {
        sample: Array::each(py, rows, |row| row.sample)?,
        position_counts: Array::each(py, rows, |row| row.position.counts())?,
        velocity_q16: Array::each(py, rows, |row| row.velocity.map_or(0, |v| v.bits()))?,
        force_q30: Array::each(py, rows, |row| row.force.map_or(0, |force| force.bits()))?,
        output: Array::each(py, rows, |row| row.told.is_some())?,
        computed: Array::each(py, rows, |row| row.velocity.is_some())?,
        driven: Array::each(py, rows, |row| row.force.is_some())?,
    })
}
