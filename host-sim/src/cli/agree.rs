//! `agree`: a measured walk beside the predicted one.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{Common, progress};
use crate::{
    analysis::agree::{Measured, agree, most_walks},
    error::Error,
    input, interrupt,
    output::{
        agree::{AgreeReport, SuspectRow, WallRow},
        estimated::print_of,
        in_units,
        table::Kind,
    },
    scene::NamedScene,
    simulation::prepared::Numeric,
};

/// Puts a walk that a board measured beside the one that the scene predicts, says whether they agree, and which number of the
/// scene would explain the difference best: mass, damping, stiffness, force per command, latency, amplifier, dry
/// friction, or noise of the encoder, one at a time.
#[derive(Debug, Args)]
pub struct AgreeArgs {
    /// Built-in scene or scene file: the one that predicts.
    scene: String,
    /// The measured walk, as `cargo board walk --csv` writes it.
    measured: PathBuf,
    /// Write both walks by B.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw both walks, and what explains the difference best; the ending, .svg or .png, says the format.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    measured: String,
    cutoff_hz: Option<f64>,
    agrees: bool,
    stiffness_step_n_per_m: f64,
    distance_n_per_m: f64,
    scatter_n_per_m: f64,
    walls: Vec<WallRow>,
    suspects: Vec<SuspectRow>,
    answers: Vec<String>,
}

pub fn run(args: &AgreeArgs, common: &Common) -> Result<(), Error> {
    if common.numeric != Numeric::Fixed {
        return Err(Error::input("--numeric: agree runs the fixed-point core only, allowed fixed"));
    }
    let scene = NamedScene::load(&args.scene)?;
    let units = scene.scene.units;
    let mut inputs = scene.files.clone();
    inputs.push(args.measured.clone());
    let mut outputs = common.outputs(&inputs)?;
    let csv = outputs.table(args.csv.as_ref(), Kind::Rows, Some(&scene))?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let name = args.measured.display().to_string();
    let text = input::read_text(&args.measured, input::RECORD)?;
    let measured = Measured::parse(&name, &text, &scene)?;
    let bar = progress::bar(most_walks(&scene.scene));
    let found = agree(common.engine.into(), &scene, &measured, interrupt::flag(), || bar.inc(1))
        .map_err(|error| match error {
            Error::Input(why) if why.starts_with("cutoff_hz") => {
                Error::Input(format!("{name}: {why}"))
            }
            other => other,
        })?;
    bar.finish_and_clear();
    let report = AgreeReport { scene: &scene.name, units, measured: &name, found: &found };
    if let Some(csv) = csv {
        outputs.write(csv, in_units::csv(units, report.csv()).as_bytes())?;
    }
    if let Some(plot) = plot {
        outputs.draw(plot, &report.figure()?)?;
    }
    outputs.commit()?;
    let json = Json {
        scene: &scene.name,
        measured: name.clone(),
        cutoff_hz: scene.scene.velocity.has_cutoff().then_some(measured.cutoff_hz),
        agrees: found.agrees(),
        stiffness_step_n_per_m: found.step,
        distance_n_per_m: found.distance,
        scatter_n_per_m: found.scatter,
        walls: report.walls(),
        suspects: report.suspects(),
        answers: report.answers(),
    };
    print_of(common.json, &scene.scene, json, || report.text())
}
