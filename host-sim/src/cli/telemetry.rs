//! `telemetry`: decodes the binary telemetry of a board.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use serde::Serialize;
use zwidth::contract::RATE_HZ;

use super::Common;
use crate::{
    analysis::{
        recompute::{Difference, Recomputed},
        telemetry::Capture,
    },
    error::Error,
    input,
    output::{table::Kind, telemetry::telemetry_figure, terminal::print_result},
    scene::{NamedScene, Units},
};

/// Decodes a capture of a board's binary telemetry (RTT up channel 1), and checks every sample with the core.
#[derive(Debug, Args)]
pub struct TelemetryArgs {
    /// File with the unchanged bytes of the capture.
    capture: PathBuf,
    /// Write every frame as CSV, in integers of the control core.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write every sample as CSV: position, velocity from the core, force.
    #[arg(long, value_name = "FILE")]
    samples: Option<PathBuf>,
    /// Draw position, velocity, force and flags over time. The ending, .svg or .png, selects the format.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// The scene of the board. With a scene, the figure is in SI units.
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
    samples: usize,
    gaps: Vec<(u64, u64)>,
    computed: u64,
    velocities_equal: u64,
    forces_equal: u64,
    states_equal: u64,
    energies_equal: u64,
    unknown: Vec<(u64, u64, &'static str)>,
    first_difference: Option<Difference>,
}

impl Json {
    fn text(&self, name: &str) -> String {
        let mut text = format!(
            "{name}: {} frames, {} dropped, {} bytes of garbage, samples {} to {}, fault codes {:?}",
            self.frames,
            self.dropped,
            self.garbage_bytes,
            self.first_sample,
            self.last_sample,
            self.faults
        );
        if self.computed > 0 {
            let _ = write!(
                text,
                "\n{} of {} samples computed by the core: {} velocities, {} forces, {} states of the estimator and {} \
                 energies at the port are the board's, bit for bit",
                self.computed,
                self.samples,
                self.velocities_equal,
                self.forces_equal,
                self.states_equal,
                self.energies_equal
            );
        }
        for (from, to) in &self.gaps {
            let _ = write!(text, "\nmissing: samples {from} to {to}");
        }
        for (from, to, why) in &self.unknown {
            let _ = write!(text, "\nnot computed: samples {from} to {to}: {why}");
        }
        if let Some(Difference { sample, what, board, core }) = &self.first_difference {
            let _ = write!(
                text,
                "\nthe first that differs: sample {sample}, its {what} is {board} on the board, {core} by the core"
            );
        }
        text
    }
}

pub fn run(args: &TelemetryArgs, common: &Common) -> Result<(), Error> {
    let name = args.capture.display();
    let scene = args.scene.as_ref().map(|scene| NamedScene::load(scene)).transpose()?;
    let mut inputs = vec![args.capture.clone()];
    inputs.extend(scene.iter().flat_map(|scene| scene.files.iter().cloned()));
    let kind = Kind::Moments { rate_hz: f64::from(RATE_HZ) };
    let mut outputs = common.outputs(&inputs)?;
    let csv = outputs.table(args.csv.as_ref(), kind, scene.as_ref())?;
    let samples = outputs.table(args.samples.as_ref(), kind, scene.as_ref())?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let bytes = input::read(&args.capture, input::RECORD)?;
    let capture = Capture::decode(&bytes);
    let (Some(first), Some(last)) = (capture.frames.first(), capture.frames.last()) else {
        let length = bytes.len();
        return Err(Error::Input(format!(
            "{name}: no telemetry frame of layout 1 or 2 in {length} bytes; docs/telemetry.md has the layout"
        )));
    };
    let all = Recomputed::of(&capture);
    outputs.tell(samples, Units::Linear, || all.csv())?;
    outputs.tell(csv, Units::Linear, || capture.csv())?;
    outputs.draw(plot, || {
        let file = args.capture.file_name().unwrap_or_default().to_string_lossy();
        telemetry_figure(&capture, &file, scene.as_ref().map(|scene| &scene.scene))
    })?;
    outputs.commit()?;
    let json = Json {
        frames: capture.frames.len(),
        dropped: capture.dropped,
        garbage_bytes: capture.garbage_bytes,
        first_sample: first.record.sample,
        last_sample: last.record.sample,
        faults: capture.faults(),
        samples: all.rows.len(),
        gaps: all.gaps(),
        computed: all.computed,
        velocities_equal: all.velocities,
        forces_equal: all.forces,
        states_equal: all.states,
        energies_equal: all.energies,
        first_difference: all.first_difference().cloned(),
        unknown: all.unknown,
    };
    print_result(common.json, &json, || json.text(&name.to_string()))
}
