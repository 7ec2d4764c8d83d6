//! `explain`: finds what limits the walls of a device.

use clap::Args;
use serde::Serialize;

use super::{Common, conditions::Conditions, progress, shared::Typed};
use crate::{
    analysis::{
        compare::search::Budget,
        explain::{explain, most_walks, table::Row},
    },
    error::Error,
    interrupt,
    output::{
        estimated::print_of,
        explain::ExplainReport,
        manifest::Manifest,
        report::{self, ReportFigure},
    },
    scene::{NamedScene, Units},
    study::{
        asked::{check_read_off, prepare},
        recommended::Ranked,
    },
};

/// Finds what limits the walls of this device. Changes one element at a time (encoder, latency, output, estimator,
/// amplifier, motor, friction, cogging, backlash, accelerometer), and tunes each change again. Gives a ranked table
/// with ranges.
#[derive(Debug, Args)]
#[command(after_long_help = COLUMNS)]
pub struct ExplainArgs {
    /// Built-in scene or scene file.
    scene: String,
    /// B at which K is compared, in N s/m [default: 100, at most half of the largest B of the scene].
    #[arg(long, value_name = "N_S_PER_M", allow_negative_numbers = true)]
    damping: Option<f64>,
    /// Number of tunings that the search may try for each change. Each tuning takes two walks. With two parameters,
    /// four times as many are allowed.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(3..=1000))]
    budget: u32,
    /// Walks for the result of each search, with starts spread over one count.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(2..=1000))]
    repeat: u32,
    #[command(flatten)]
    conditions: Conditions,
}

const COLUMNS: &str = "\
Columns:
  rank            1 is best. Rows have the same rank if the start positions cannot tell which is better
  change          the element, and its changed value
  times the area  area divided by the area of the unchanged scene: mean (smallest to largest over the starts).
                  ?: the starts cannot tell it from 1
  area            mean area below the boundary. >: a cap of [walk] cuts it, so it is larger
  by the scene    area of the same tuning by the scene's own criterion; empty if the search used that one
  peak K          largest stable K at any B, mean over the starts
  K at B          largest stable K at the B of --damping, mean over the starts
  noise           RMS noise of the velocity in motion. Multiplied by B it is the noise of the force
  of core %       cycles that the change adds, as a share of a Cortex-M4 at 180 MHz. ?: not measured
  cost            what the change needs
explain.csv has these and more (docs/files.md).";

const FILES: &[&str] = &["explain.csv", "boundary.csv", "explain", "report.html"];

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    damping_n_s_per_m: f64,
    budget: u32,
    repeats: u32,
    changes: Vec<Row<'a>>,
    answers: Vec<String>,
}

pub fn run(args: &ExplainArgs, common: &Common) -> Result<(), Error> {
    let mut scene = NamedScene::load(&args.scene)?;
    args.conditions.apply(&mut scene.scene).map_err(|error| error.of(&scene.name))?;
    common.only_fixed("explain")?;
    prepare(&scene)?;
    let units = scene.scene.units;
    let damping = args.damping.map(|damping| units.damping_n_s_per_m(damping));
    if let Some(damping) = damping {
        check_read_off(&scene, damping, "--damping")?;
    }
    let mut to = common.fill(&scene, "explain", FILES)?;
    let Ranked { scene, beside } = args.conditions.ranked(&scene, common)?;
    let budget = Budget { tunings: args.budget, repeats: args.repeat };
    let bar = progress::bar(most_walks(&scene.scene, budget));
    let (both, done) = ((&scene.scene, beside.as_ref()), |walks| bar.inc(walks));
    let found = explain(common.engine, both, damping, budget, interrupt::flag(), done)
        .map_err(|error| error.of(&scene.name))?;
    bar.finish_and_clear();
    let criterion = scene.scene.wall_hit.criterion.name();
    let report = ExplainReport { scene: &scene.name, criterion, units, found: &found };
    let command = Typed::new("explain", &scene.name)
        .and(&args.conditions.as_typed())
        .with("damping", Units::told(found.damping_n_s_per_m, units.written("N s/m").1))
        .with("budget", args.budget)
        .with("repeat", args.repeat)
        .by(common);
    let manifest = Manifest::new(command, &scene);
    let figure = report.figure()?;
    to.figure("explain", &figure)?;
    to.add("explain.csv", report.csv())?;
    to.add("boundary.csv", found.boundaries().csv())?;
    let figures = [ReportFigure {
        figure,
        caption: "Boundary of the stable walls: the scene as it is, and its best changes.".into(),
    }];
    let answers = found.answers();
    let notes: Vec<String> = answers.iter().cloned().chain(scene.scene.estimated_note()).collect();
    let sections = [
        ("Changes", report.html()),
        ("Answers", report::notes(&notes)),
        ("Scene", report::scene(&scene.text)),
        ("Provenance", report::provenance(&manifest.facts())),
    ];
    let title = format!("{}: what limits the walls", scene.name);
    to.add("report.html", report::page(&title, &answers.join(". "), &figures, &sections))?;
    let results = to.finish(&manifest)?;
    let json = Json {
        scene: &scene.name,
        damping_n_s_per_m: found.damping_n_s_per_m,
        budget: args.budget,
        repeats: args.repeat,
        changes: found.rows(),
        answers,
    };
    print_of(common.json, &scene.scene, json, || format!("{}\n{results}", report.text()))
}
