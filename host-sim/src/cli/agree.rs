//! `agree`: compares a measured walk with the predicted walk.

use std::path::PathBuf;

use clap::Args;

use super::{Common, progress};
use crate::{
    analysis::agree::{Told, agree_with_file, most_walks},
    error::Error,
    interrupt,
    output::{agree::AgreeReport, estimated::print_of, table::Kind},
    scene::NamedScene,
};

/// Compares a walk measured on a board with the walk that the scene predicts. Says whether the walks agree, and which
/// change of one number of the scene explains the difference best: mass, damping, stiffness, force per command,
/// latency, amplifier, dry friction, or encoder noise.
#[derive(Debug, Args)]
pub struct AgreeArgs {
    /// Built-in scene or scene file that predicts the walk.
    scene: String,
    /// The measured walk, as written by `cargo board walk --csv`.
    measured: PathBuf,
    /// Write both walks, one row for each B.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw both walks, and the best explanation of the difference. The ending, .svg or .png, selects the format.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

pub fn run(args: &AgreeArgs, common: &Common) -> Result<(), Error> {
    common.only_fixed("agree")?;
    let scene = NamedScene::load(&args.scene)?;
    let units = scene.scene.units;
    let mut inputs = scene.files.clone();
    inputs.push(args.measured.clone());
    let mut outputs = common.outputs(&inputs)?;
    let csv = outputs.table(args.csv.as_ref(), Kind::Rows, Some(&scene))?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let name = args.measured.display().to_string();
    let bar = progress::bar(most_walks(&scene.scene));
    let (engine, stop) = (common.engine, interrupt::flag());
    let done = || bar.inc(1);
    let (measured, found) = agree_with_file(engine, &scene, &args.measured, stop, done)?;
    bar.finish_and_clear();
    let report = AgreeReport { scene: &scene.name, units, measured: &name, found: &found };
    outputs.tell(csv, units, || report.csv())?;
    outputs.draw(plot, || report.figure())?;
    outputs.commit()?;
    let json = Told::new(&scene, &name, &measured, &found);
    print_of(common.json, &scene.scene, json, || report.text())
}
