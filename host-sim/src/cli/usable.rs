//! `compare --usable`: walls that are stable and rendered as they were commanded.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use zwidth::velocity::EstimatorName;

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
        usable::{UsableQuestion, usable},
    },
    engine::Engine,
    error::Error,
    interrupt,
    output::{
        estimated::print_of,
        files::{MANIFEST, json as json_bytes},
        in_units,
        manifest::Manifest,
        usable::{UsableArea, UsableStudy},
    },
    range::within,
    scene::NamedScene,
};

/// Every file of a result.
const FILES: [&str; 4] = ["usable.csv", "usable.svg", "usable.png", MANIFEST];
/// Those that are compared where nobody names one: of each kind the usual ones, the slowest first.
const USUAL: [EstimatorName; 10] = [
    EstimatorName::Observer,
    EstimatorName::Butterworth,
    EstimatorName::FirstOrder,
    EstimatorName::LeastSquares2,
    EstimatorName::TrackingLoop,
    EstimatorName::Kalman2,
    EstimatorName::Kalman3,
    EstimatorName::LevantExplicit,
    EstimatorName::FoawEnd,
    EstimatorName::FoawBest,
];

/// Options of `--usable`.
#[derive(Debug, Args)]
pub struct UsableArgs {
    /// Usable areas instead: walls that are stable and whose rendered impedance is off by no more than each of these, % of
    /// the magnitude of K + jwB, the largest error from 1 to 30 Hz, and any error beside them. Each estimator is tuned for each
    /// limit. The handle is moved by a sine, so no arm matters to the error; walls are stable in the scene's or --arm.
    #[arg(long, value_name = "LIST", value_parser = list::parse, num_args = 0..=1, default_missing_value = "5,10,20", conflicts_with_all = ["damping", "peers"])]
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
    areas: Vec<UsableArea>,
}

pub fn run(
    percents: &List,
    asked: Asked<'_>,
    scene: &NamedScene,
    common: &Common,
) -> Result<(), Error> {
    crate::study::asked::prepare(scene)?;
    let mut percents = percents.0.clone();
    for &percent in &percents {
        within("--usable", percent, 0.1..=1000.0).map_err(Error::Input)?;
    }
    percents.sort_by(f64::total_cmp);
    percents.dedup();
    let typed: Vec<String> = percents.iter().map(f64::to_string).collect();
    let limits = percents.iter().map(|percent| percent / 100.0).chain([f64::INFINITY]);
    let all = Entry::all(&scene.scene);
    let usual =
        || USUAL.map(Entry::Tuned).into_iter().filter(|entry| all.contains(entry)).collect();
    let entries = asked.entries.unwrap_or_else(usual);
    let names: Vec<String> = entries.iter().map(|entry| entry.name()).collect();
    let question = UsableQuestion { entries, limits: limits.collect(), budget: asked.budget };
    let default = || PathBuf::from("zwidth-out").join(&scene.name).join("usable");
    let folder = common.out.clone().unwrap_or_else(default);
    let mut outputs = common.outputs(&scene.files)?;
    let to = outputs.folder(&folder, &FILES)?;
    let engine = Engine::from(common.engine);
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
    let found = usable(engine, &scene.scene, &question, interrupt::flag(), |walks| bar.inc(walks))
        .map_err(|error| error.of(&scene.name))?;
    bar.finish_and_clear();
    let study = UsableStudy { question, found };
    let units = scene.scene.units;
    outputs.add(to, "usable.csv", in_units::csv(units, study.csv()).as_bytes())?;
    outputs.add_figure(to, "usable", &study.figure(scene)?)?;
    outputs.add(to, MANIFEST, &json_bytes(&Manifest::new(command, scene))?)?;
    outputs.commit()?;
    let json = Json { scene: &scene.name, areas: study.areas() };
    print_of(common.json, &scene.scene, json, || {
        format!("{}: {}\n  results in {}", scene.name, study.text(), folder.display())
    })
}
