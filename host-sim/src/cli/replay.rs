//! `replay`: runs another estimator over a board's capture, or ranks all estimators on a log.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use zwidth::contract::RATE_HZ;

use super::Common;
use crate::{
    analysis::replay::{Ranking, Told, rank, read_log, replay, velocity},
    error::Error,
    interrupt,
    notation::number,
    output::{in_units::InUnits, table::Kind, telemetry::replay_figure, terminal::print_result},
    range::within,
    scene::NamedScene,
};

/// Runs an estimator over the counts of all samples of a capture, and compares its velocity with that of the board's
/// estimator.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// File with the unchanged bytes of RTT up channel 1; with --rank, a log for `identify`.
    capture: PathBuf,
    /// Estimator [default: the scene's].
    #[arg(long, value_name = "NAME")]
    estimator: Option<String>,
    /// Nominal cutoff in Hz [default: `velocity.cutoff_hz` of the scene, else 1500]. Other parameters are the scene's,
    /// or defaults.
    #[arg(long, value_name = "HZ")]
    cutoff: Option<f64>,
    /// The scene of the board.
    #[arg(long, default_value = "nucleo-f446re")]
    scene: String,
    /// Rank all estimators that need only the count, each tuned. The reference is the velocity of the positions,
    /// low-passed at HZ forwards and backwards.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true, conflicts_with_all = ["estimator", "cutoff", "plot"])]
    rank: Option<f64>,
    /// With --rank: size of a count, m or rad [default: the scene's].
    #[arg(long, value_name = "M", allow_negative_numbers = true, requires = "rank")]
    resolution: Option<f64>,
    /// Write sample, count and both velocities, in integers of the control core; with --rank, write the ranks.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw position and both velocities over time. The ending, .svg or .png, selects the format.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// The cutoff that is used without `--cutoff` and without `velocity.cutoff_hz`, in Hz.
const CUTOFF_HZ: f64 = 1500.0;

fn ranked(args: &ReplayArgs, reference_hz: f64, common: &Common) -> Result<(), Error> {
    let named = NamedScene::load(&args.scene)?;
    let scene = &named.scene;
    let mut inputs = vec![args.capture.clone()];
    inputs.extend(named.files.iter().cloned());
    let mut outputs = common.outputs(&inputs)?;
    let csv = outputs.table(args.csv.as_ref(), Kind::Rows, Some(&named))?;
    let mut resolution_m = scene.encoder.resolution_m;
    if let Some(resolution) = args.resolution {
        within("--resolution", resolution, 1e-12..=1.0).map_err(Error::Input)?;
        resolution_m = resolution / scene.units.key("_m").map_or(1.0, |(_, per_m)| per_m);
    }
    let record = read_log(&args.capture, scene, resolution_m)?;
    let ranking = rank(&record, resolution_m, reference_hz, scene, interrupt::flag())?;
    outputs.tell(csv, scene.units, || ranks_csv(&ranking))?;
    outputs.commit()?;
    print_result(common.json, InUnits(scene.units, &ranking), || {
        let (unit, factor) = scene.units.written("mm/s");
        let told = |speed_m_per_s: f64| number(1e3 * speed_m_per_s * factor, 3);
        let mut text = format!(
            "{}: {} samples at {:.0} Hz, {} {unit} RMS; counts {:.2} RMS off the low-pass of {reference_hz} Hz, ideal 0.29\n\n\
             {:<16} {:>10} {:>12} {:>16}\n",
            args.capture.display(),
            ranking.samples,
            ranking.rate_hz,
            told(ranking.speed_rms_m_per_s),
            ranking.residual_counts,
            "estimator",
            "-3 dB, Hz",
            format!("error, {unit}"),
            "by ideal counts",
        );
        for row in &ranking.estimators {
            let hz = row.bandwidth_hz.map_or_else(String::new, |hz| number(hz, 1));
            let [real, ideal] = [row.error_m_per_s, row.simulated_error_m_per_s].map(told);
            let _ = writeln!(text, "{:<16} {hz:>10} {real:>12} {ideal:>16}", row.estimator);
        }
        format!("{text}\nrank correlation of both errors {:.2}", ranking.spearman)
    })
}

fn ranks_csv(ranking: &Ranking) -> String {
    let mut text = "estimator,bandwidth_hz,error_m_per_s,simulated_error_m_per_s\n".to_owned();
    for row in &ranking.estimators {
        let hz = row.bandwidth_hz.map_or_else(String::new, |hz| hz.to_string());
        let [real, ideal] = [row.error_m_per_s, row.simulated_error_m_per_s];
        let _ = writeln!(text, "{},{hz},{real},{ideal}", row.estimator);
    }
    text
}

pub fn run(args: &ReplayArgs, common: &Common) -> Result<(), Error> {
    if let Some(reference_hz) = args.rank {
        return ranked(args, reference_hz, common);
    }
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
