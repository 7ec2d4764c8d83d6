//! `compare --usable`: walls that are stable and rendered as they were commanded.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    conditions::Conditions,
    list::{self, List},
    progress,
};
use crate::{
    analysis::compare::{
        Entry,
        search::Budget,
        usable::{self, PERCENTS, UsableArea, UsableQuestion, UsableStudy},
    },
    engine::Engine,
    error::Error,
    interrupt,
    output::{
        estimated::print_of,
        files::{MANIFEST, json as json_bytes},
        in_units,
        manifest::Manifest,
        usable::UsableReport,
    },
    scene::NamedScene,
};

/// Every file of a result.
const FILES: [&str; 4] = ["usable.csv", "usable.svg", "usable.png", MANIFEST];

/// Options of `--usable`.
#[derive(Debug, Args)]
pub struct UsableArgs {
    /// Usable areas instead: walls that are stable and whose rendered impedance is off by no more than each of these, % of
    /// the magnitude of K + jwB, the largest error from 1 to 30 Hz, and any error beside them. Each estimator is tuned for each
    /// limit. The handle is moved by a sine, so no arm matters to the error; walls are stable in the scene's or --arm.
    #[arg(long, value_name = "LIST", value_parser = list::parse, num_args = 0..=1, default_missing_value = PERCENTS, conflicts_with_all = ["damping", "peers"])]
    pub usable: Option<List>,
}

/// Which walls are asked about: all of it but the scene.
pub struct Asked<'a> {
    pub entries: Option<Vec<Entry>>,
    pub conditions: &'a Conditions,
    pub budget: Budget,
}

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    areas: Vec<UsableArea<'a>>,
}

pub fn run(
    percents: &List,
    asked: Asked<'_>,
    scene: &NamedScene,
    common: &Common,
) -> Result<(), Error> {
    let percents = usable::percents(&percents.0, "--usable")?;
    let typed: Vec<String> = percents.iter().map(f64::to_string).collect();
    let entries = asked.entries.unwrap_or_else(|| usable::usual(&scene.scene));
    let names: Vec<String> = entries.iter().map(|entry| entry.name()).collect();
    let question = UsableQuestion::of(entries, &percents, asked.budget);
    let default = || PathBuf::from("zwidth-out").join(&scene.name).join("usable");
    let folder = common.out.clone().unwrap_or_else(default);
    let mut outputs = common.outputs(&scene.files)?;
    let to = outputs.folder(&folder, &FILES)?;
    let engine = Engine::from(common.engine);
    let scene = &asked.conditions.ranked(scene, common)?.scene;
    let command = format!(
        "compare {} --usable {} --estimators {}{} --budget {} --repeat {} --engine {}",
        scene.name,
        typed.join(","),
        names.join(","),
        asked.conditions.as_typed(),
        asked.budget.tunings,
        asked.budget.repeats,
        engine.name()
    );
    let bar = progress::bar(question.most_walks());
    let done = |walks| bar.inc(walks);
    let found = usable::usable(engine, &scene.scene, &question, interrupt::flag(), done)
        .map_err(|error| error.of(&scene.name))?;
    bar.finish_and_clear();
    let study = UsableReport(UsableStudy { question, found });
    let units = scene.scene.units;
    outputs.add(to, "usable.csv", in_units::csv(units, study.csv()).as_bytes())?;
    outputs.add_figure(to, "usable", &study.figure(scene)?)?;
    outputs.add(to, MANIFEST, &json_bytes(&Manifest::new(command, scene))?)?;
    outputs.commit()?;
    let json = Json { scene: &scene.name, areas: study.0.areas() };
    print_of(common.json, &scene.scene, json, || {
        format!("{}: {}\n  results in {}", scene.name, study.text(), folder.display())
    })
}
