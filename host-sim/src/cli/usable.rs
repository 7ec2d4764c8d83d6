//! `compare --usable`: walls that are stable and have an accurate impedance.

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    conditions::Conditions,
    list::{self, List},
    progress,
    shared::{Typed, listed},
};
use crate::{
    analysis::compare::{
        Entry,
        search::Budget,
        usable::{self, PERCENTS, UsableArea, UsableQuestion, UsableStudy},
    },
    error::Error,
    interrupt,
    output::{estimated::print_of, manifest::Manifest, usable as report},
    scene::NamedScene,
};

/// Options of `--usable`.
#[derive(Debug, Args)]
pub struct UsableArgs {
    /// Compare usable areas instead: stable walls whose rendered impedance is accurate. The values are limits of the
    /// largest error from 1 to 30 Hz, in % of the magnitude of K + jwB. A result without a limit is added. Each
    /// estimator is tuned for each limit. A sine moves the handle, so an arm does not change the error. Walls must be
    /// stable with the arm of the scene or of --arm.
    #[arg(long, value_name = "LIST", value_parser = list::parse, num_args = 0..=1, default_missing_value = PERCENTS, conflicts_with_all = ["damping", "peers"])]
    pub usable: Option<List>,
}

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    areas: Vec<UsableArea<'a>>,
}

pub fn run(
    percents: &List,
    entries: Option<Vec<Entry>>,
    conditions: &Conditions,
    budget: Budget,
    scene: &NamedScene,
    common: &Common,
) -> Result<(), Error> {
    let percents = usable::percents(&percents.0, "--usable")?;
    let entries = entries.unwrap_or_else(|| usable::usual(&scene.scene));
    let names: Vec<String> = entries.iter().map(|entry| entry.name()).collect();
    let question = UsableQuestion::of(entries, &percents, budget);
    let mut to = common.fill(scene, "usable", &["usable.csv", "usable"])?;
    let scene = &conditions.ranked(scene, common)?.scene;
    let command = Typed::new("compare", &scene.name)
        .with("usable", listed(&percents).unwrap_or_default())
        .with("estimators", names.join(","))
        .and(&conditions.as_typed())
        .with("budget", budget.tunings)
        .with("repeat", budget.repeats)
        .by(common);
    let bar = progress::bar(question.most_walks());
    let done = |walks| bar.inc(walks);
    let found = usable::usable(common.engine, &scene.scene, &question, interrupt::flag(), done)
        .map_err(|error| error.of(&scene.name))?;
    bar.finish_and_clear();
    let study = UsableStudy { question, found };
    to.add("usable.csv", report::csv(&study))?;
    to.figure("usable", &report::figure(&study, scene)?)?;
    let results = to.finish(&Manifest::new(command, scene))?;
    let json = Json { scene: &scene.name, areas: study.areas() };
    print_of(common.json, &scene.scene, json, || {
        format!("{}: {}\n  {results}", scene.name, report::text(&study, scene.scene.units))
    })
}
