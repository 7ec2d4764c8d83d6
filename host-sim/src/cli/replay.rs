//! `replay`: runs another estimator over a board's capture.

use std::path::PathBuf;

use clap::Args;
use zwidth::contract::RATE_HZ;

use super::Common;
use crate::{
    analysis::replay::{Told, replay, velocity},
    error::Error,
    interrupt,
    output::{in_units::InUnits, table::Kind, telemetry::replay_figure, terminal::print_result},
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
    /// Nominal cutoff, Hz [default: `velocity.cutoff_hz` of the scene, else 1500]; what else tunes it is the scene's, or the
    /// default.
    #[arg(long, value_name = "HZ")]
    cutoff: Option<f64>,
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

/// Cutoff without `--cutoff` and `velocity.cutoff_hz`, Hz.
const CUTOFF_HZ: f64 = 1500.0;

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
    let cutoff_hz = args.cutoff.or(scene.velocity.cutoff_hz()).unwrap_or(CUTOFF_HZ);
    let own = scene.velocity.at(cutoff_hz);
    let velocity = velocity(own, args.estimator.as_deref(), "--estimator")?;
    let replayed = replay(&args.capture, scene, velocity, interrupt::flag())?;
    outputs.tell(csv, scene.units, || replayed.csv())?;
    outputs.draw(plot, || {
        let title = format!("{}, {} Hz beside the board's", velocity.name().text(), cutoff_hz);
        let file = args.capture.file_name().unwrap_or_default().to_string_lossy().into_owned();
        replay_figure(&replayed, [&title, &file], scene)
    })?;
    outputs.commit()?;
    let told = Told::new(scene, velocity, cutoff_hz, &replayed, interrupt::flag())?;
    print_result(common.json, InUnits(scene.units, &told), || {
        let later = told.later_s.map_or_else(
            || "nothing moved".to_owned(),
            |later_s| format!("{:.3} ms later than the board's", later_s * 1e3),
        );
        let same = told.same_from_sample.map_or_else(
            || "never the same to the last bit up to the end".to_owned(),
            |sample| format!("the same to the last bit from sample {sample} to the end"),
        );
        scene.units.text(&format!(
            "{name}: {} samples from sample {} on, {} at {} Hz\n\
             {later}, {same}\n\
             difference to the board's {:.3e} m/s RMS; from sample to sample {:.3e} m/s, the board's {:.3e} m/s",
            told.samples,
            told.first_sample,
            told.estimator,
            told.cutoff_hz,
            told.difference_rms_m_per_s,
            told.change_rms_m_per_s,
            told.board_change_rms_m_per_s
        ))
    })
}
