//! `telemetry`: a board's binary stream, decoded.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::Common;
use crate::{
    analysis::telemetry::Capture,
    error::Error,
    input,
    output::{files::Outputs, telemetry::telemetry_figure, terminal::print_result},
    scene::NamedScene,
};

/// Decodes a capture of a board's binary telemetry (RTT up channel 1).
#[derive(Debug, Args)]
pub struct TelemetryArgs {
    /// File with the bytes as they came.
    capture: PathBuf,
    /// Write every frame as CSV, in the integers of the control.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw position, velocity, force and flags over time; the ending, .svg or .png, says the format.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// The scene that the board is built for: the figure is in SI units then.
    #[arg(long, requires = "plot")]
    scene: Option<String>,
}

#[derive(Serialize)]
struct Json {
    frames: usize,
    dropped: u64,
    garbage_bytes: u64,
    first_sample: u64,
    last_sample: u64,
    faults: Vec<u8>,
}

pub fn run(args: &TelemetryArgs, common: &Common) -> Result<(), Error> {
    let name = args.capture.display();
    let scene = args.scene.as_ref().map(|scene| NamedScene::load(scene)).transpose()?;
    let mut inputs = vec![args.capture.clone()];
    inputs.extend(scene.iter().flat_map(|scene| scene.files.iter().cloned()));
    let mut outputs = Outputs::new(common.force, &inputs);
    let csv = outputs.option(args.csv.as_ref())?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let bytes = input::read(&args.capture, input::RECORD)?;
    let capture = Capture::decode(&bytes);
    let (Some(first), Some(last)) = (capture.frames.first(), capture.frames.last()) else {
        let length = bytes.len();
        return Err(Error::Input(format!(
            "{name}: no telemetry frame of layout 1 or 2 in {length} bytes; docs/telemetry.md has the layout"
        )));
    };
    if let Some(csv) = csv {
        outputs.write(csv, capture.csv().as_bytes())?;
    }
    if let Some(plot) = plot {
        let file = args
            .capture
            .file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let figure = telemetry_figure(&capture, &file, scene.as_ref().map(|scene| &scene.scene))?;
        outputs.draw(plot, &figure)?;
    }
    outputs.commit()?;
    let json = Json {
        frames: capture.frames.len(),
        dropped: capture.dropped,
        garbage_bytes: capture.garbage_bytes,
        first_sample: first.record.sample,
        last_sample: last.record.sample,
        faults: capture.faults(),
    };
    print_result(common.json, &json, || {
        format!(
            "{name}: {} frames, {} dropped, {} bytes of garbage, samples {} to {}, fault codes {:?}",
            json.frames,
            json.dropped,
            json.garbage_bytes,
            json.first_sample,
            json.last_sample,
            json.faults
        )
    })
}
