//! `replay`: another estimator over a board's capture.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use zwidth::{Settings, WallSettings, contract::RATE_HZ, velocity::EstimatorName};

use super::Common;
use crate::{
    analysis::{replay::Replayed, telemetry::Capture},
    error::Error,
    input,
    output::{
        in_units::{self, InUnits},
        table::Kind,
        telemetry::replay_figure,
        terminal::print_result,
    },
    scene::NamedScene,
};

/// Runs an estimator over the counts of all samples of a capture, beside the board's own.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// File with the bytes of RTT up channel 1 as they came.
    capture: PathBuf,
    /// Estimator; the scene's if not given.
    #[arg(long, value_name = "NAME")]
    estimator: Option<String>,
    /// Nominal cutoff, Hz; what else tunes it is the scene's, or the default.
    #[arg(long, value_name = "HZ", default_value_t = 1500.0)]
    cutoff: f64,
    /// The scene that the board is built for.
    #[arg(long, default_value = "nucleo-f446re")]
    scene: String,
    /// Write sample, count and both velocities, in the integers of the control.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw position and both velocities over time; the ending, .svg or .png, says the format.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

#[derive(Serialize)]
struct Json<'a> {
    estimator: &'a str,
    cutoff_hz: f64,
    samples: usize,
    first_sample: u64,
    same_from_sample: Option<u64>,
    difference_rms_m_per_s: f64,
    later_s: Option<f64>,
    board_change_rms_m_per_s: f64,
    change_rms_m_per_s: f64,
}

pub fn run(args: &ReplayArgs, common: &Common) -> Result<(), Error> {
    let name = args.capture.display();
    let scene = NamedScene::load(&args.scene)?;
    let mut inputs = vec![args.capture.clone()];
    inputs.extend(scene.files.iter().cloned());
    let mut outputs = common.outputs(&inputs)?;
    let csv = outputs.table(
        args.csv.as_ref(),
        Kind::Moments { rate_hz: f64::from(RATE_HZ) },
        Some(&scene),
    )?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let scene = &scene.scene;
    let mut velocity = scene.velocity.settings(args.cutoff);
    if let Some(wanted) = &args.estimator {
        let found = EstimatorName::ALL.iter().find(|name| name.text() == wanted);
        let estimator = found.ok_or_else(|| {
            let known: Vec<_> = EstimatorName::ALL.iter().map(|name| name.text()).collect();
            Error::Input(format!("--estimator is {wanted}, allowed {}", known.join(", ")))
        })?;
        velocity = estimator.following(&velocity);
    }
    if let Some(sense) = velocity.name().missing(&[]) {
        let (estimator, sense) = (velocity.name().text(), sense.text());
        return Err(Error::Input(format!(
            "--estimator is {estimator}, which needs {sense} beside the count; a capture has none"
        )));
    }
    let wall = WallSettings {
        position_m: scene.wall.position_m,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        push_only: true,
    };
    let control = Settings { velocity, wall }
        .build(&scene.design())
        .map_err(|error| Error::Input(error.to_string()))?;
    let bytes = input::read(&args.capture, input::RECORD)?;
    let replayed =
        Replayed::of(&Capture::decode(&bytes), &control).map_err(|step| {
            Error::Input(match step {
                0 => format!("{name}: no telemetry in it; docs/telemetry.md has the layout"),
                1 => format!("{name}: fewer than 100 samples in a row, too few to replay"),
                step => format!(
                    "{name}: a sample in {step} only, allowed every one: record again with an image that tells all of them"
                ),
            })
        })?;
    if let Some(csv) = csv {
        outputs.write(csv, in_units::csv(scene.units, replayed.csv()).as_bytes())?;
    }
    if let Some(plot) = plot {
        let title = format!("{}, {} Hz beside the board's", velocity.name().text(), args.cutoff);
        let file = args.capture.file_name().unwrap_or_default().to_string_lossy().into_owned();
        outputs.draw(plot, &replay_figure(&replayed, [&title, &file], scene)?)?;
    }
    outputs.commit()?;
    let lsb = scene.encoder.resolution_m * scene.control.rate_hz / 65_536.0;
    let [board, here] = replayed.roughness().map(|lsbs| lsbs * lsb);
    let json = Json {
        estimator: velocity.name().text(),
        cutoff_hz: args.cutoff,
        samples: replayed.len(),
        first_sample: replayed.first,
        same_from_sample: replayed.same_from(),
        difference_rms_m_per_s: replayed.difference() * lsb,
        later_s: replayed.later().map(|samples| samples / scene.control.rate_hz + 0.0), // no minus before a zero
        board_change_rms_m_per_s: board,
        change_rms_m_per_s: here,
    };
    print_result(common.json, InUnits(scene.units, &json), || {
        let later = json.later_s.map_or_else(
            || "nothing moved".to_owned(),
            |later_s| format!("{:.3} ms later than the board's", later_s * 1e3),
        );
        let same = json.same_from_sample.map_or_else(
            || "never the same to the last bit up to the end".to_owned(),
            |sample| format!("the same to the last bit from sample {sample} to the end"),
        );
        scene.units.text(&format!(
            "{name}: {} samples from sample {} on, {} at {} Hz\n\
             {later}, {same}\n\
             difference to the board's {:.3e} m/s RMS; from sample to sample {:.3e} m/s, the board's {:.3e} m/s",
            json.samples,
            json.first_sample,
            json.estimator,
            json.cutoff_hz,
            json.difference_rms_m_per_s,
            json.change_rms_m_per_s,
            json.board_change_rms_m_per_s
        ))
    })
}
