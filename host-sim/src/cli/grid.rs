//! `grid`: hits every wall of a grid once.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use zwidth::VelocitySettings;

use super::{
    Common,
    conditions::Judged,
    draws::DrawArgs,
    list::{self, List},
    progress,
    shared::{AtCutoffs, Start},
};
use crate::{
    analysis::rendered::Rendered,
    engine::{Depth, stream},
    error::Error,
    interrupt,
    output::{
        SCHEMA_VERSION,
        estimated::print_of,
        grid::{self, Counts},
        table::Kind,
    },
    scene::NamedScene,
    simulation::prepared::WallHit,
    study::{
        How,
        asked::{Walls, prepare},
        probability::{Draws, at_walls},
    },
};

/// Hits every wall of a grid of cutoffs, dampings and stiffnesses. Gives a map of verdict and RMS.
#[derive(Debug, Args)]
pub struct GridArgs {
    #[command(flatten)]
    at: AtCutoffs,
    #[command(flatten)]
    judged: Judged,
    /// Stiffnesses K of the wall in N/m: A,B,C or FROM:STEP:TO.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    stiffnesses: List,
    #[command(flatten)]
    start: Start,
    /// Add the impedance error: the largest error of the rendered impedance from 1 to 30 Hz, relative to K + jwB. A
    /// sine moves the handle inside the wall. The number of stable walls with an error below 5, 10 and 20 % is added
    /// too.
    #[arg(long, conflicts_with = "probability")]
    impedance: bool,
    #[command(flatten)]
    draws: DrawArgs,
    /// Write a table with one row per wall.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    numeric: &'static str,
    points: u64,
    #[serde(flatten)]
    counts: Counts,
    /// Number of stable walls whose impedance error is below 5, 10 and 20 %. Only with `--impedance`.
    #[serde(skip_serializing_if = "Option::is_none")]
    usable: Option<[u64; 3]>,
    /// Protocol of the hits. It is left out if it is the paper's protocol.
    #[serde(skip_serializing_if = "Option::is_none")]
    protocol: Option<&'static str>,
}

/// Limits of the impedance error. For each limit, the walls with a smaller error are counted.
const WITHIN: [f64; 3] = [0.05, 0.1, 0.2];

pub fn run(args: &GridArgs, common: &Common) -> Result<(), Error> {
    let (mut scene, walls) = args.at.load(&args.stiffnesses.0, Some(args.start))?;
    args.judged.apply(&mut scene)?;
    let prepared = prepare(&scene)?;
    let mut outputs = common.outputs(&scene.files)?;
    let csv = outputs.table(args.csv.as_ref(), Kind::Rows, Some(&scene))?;
    if let Some(draws) = args.draws.of(&scene)? {
        let (json, table) = probable(&draws, &scene, &walls, common)?;
        let units = scene.scene.units;
        outputs.tell(csv, units, || table)?;
        outputs.commit()?;
        return print_of(common.json, &scene.scene, &json, || json.text());
    }
    let mut table = grid::Grid::new(scene.scene.units, args.impedance);
    if let Some(csv) = csv {
        outputs.write(csv, table.header().as_bytes())?;
    }
    let rendered: Vec<Rendered> = match args.impedance {
        false => vec![],
        true => {
            let of = |&filter: &VelocitySettings| Rendered::of(&scene.scene, filter);
            walls.filters.par_iter().map(of).collect::<Result<_, _>>()?
        }
    };
    let error_of = |wall: &WallHit| {
        let place = walls.filters.iter().position(|filter| *filter == wall.velocity)?;
        Some(rendered.get(place)?.error(wall.stiffness_n_per_m, wall.damping_n_s_per_m))
    };
    let mut usable = [0u64; 3];
    let points = walls.count();
    let bar = progress::bar_of(points, "walls");
    let (numeric, wall) = (common.numeric, |number| walls.wall(number));
    stream(
        common.engine,
        &prepared,
        numeric,
        Depth::Whole,
        points,
        wall,
        interrupt::flag(),
        |number, outcome| {
            bar.inc(1);
            let wall = walls.wall(number);
            let error = error_of(&wall);
            let stable = table.counts.stable;
            let row = table.row(&wall, outcome, error)?;
            let is_stable = table.counts.stable > stable;
            for (count, limit) in usable.iter_mut().zip(WITHIN) {
                *count += u64::from(is_stable && error.is_some_and(|error| error <= limit));
            }
            let Some(csv) = csv else { return Ok(()) };
            outputs.write(csv, row.as_bytes())
        },
    )?;
    bar.finish_and_clear();
    outputs.commit()?;
    let (name, numeric) = (scene.name.as_str(), common.numeric.name());
    let counts = table.counts;
    let Counts { stable, unstable, no_contact, out_of_range } = counts;
    let usable = args.impedance.then_some(usable);
    let protocol = scene.scene.wall_hit.protocol.named();
    let by = protocol.map_or_else(String::new, |protocol| format!(", by {protocol}"));
    let json = Json { scene: name, numeric, points, counts, usable, protocol };
    print_of(common.json, &scene.scene, json, || {
        let within = usable.map_or(String::new(), |[five, ten, twenty]| {
            format!(
                "; {five}, {ten} and {twenty} stable ones rendered within 5, 10 and 20 % of K + jwB"
            )
        });
        format!(
            "{name}: {points} walls, {stable} stable, {unstable} unstable, {no_contact} without contact, \
             {out_of_range} out of range{by}{within}"
        )
    })
}

/// Probabilities of a grid's walls.
#[derive(Serialize)]
struct ProbableJson<'a> {
    scene: &'a str,
    numeric: &'static str,
    points: u64,
    draws: u32,
    /// Number of walls that are stable in at least 95 % of the draws.
    held_by_95_percent: u64,
    held_by_50_percent: u64,
    held_by_5_percent: u64,
    /// Share of the draws in which a wall is stable. It is the mean over the walls.
    share: f64,
}

/// Largest number of verdicts. All verdicts are kept in memory until the end.
const VERDICTS_MAX: u64 = 100_000_000;

fn probable<'a>(
    draws: &Draws,
    scene: &'a NamedScene,
    walls: &Walls,
    common: &Common,
) -> Result<(ProbableJson<'a>, String), Error> {
    let (points, count) = (walls.count(), draws.count());
    let verdicts = points.saturating_mul(count.into());
    if verdicts > VERDICTS_MAX {
        return Err(Error::Input(format!(
            "walls and draws make {verdicts} hits, allowed {VERDICTS_MAX}"
        )));
    }
    let (engine, numeric, stop) = (common.engine, common.numeric, interrupt::flag());
    let how = How { engine, numeric, stop };
    let mut csv = String::from(
        "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m,held,draws,share,schema_version\n",
    );
    let mut shares: Vec<f64> = vec![];
    let bar = progress::bar_of(points, "walls");
    let of_filter = points / walls.filters.len() as u64;
    for (n, &filter) in (0u64..).zip(&walls.filters) {
        let cutoff_hz = filter.cutoff_hz().unwrap_or_default();
        let numbers = n * of_filter..(n + 1) * of_filter;
        let hits: Vec<WallHit> = numbers.map(|number| walls.wall(number)).collect();
        let wall = |hit: &WallHit| [hit.stiffness_n_per_m, hit.damping_n_s_per_m];
        let held = at_walls(how, draws, filter, &hits.iter().map(wall).collect::<Vec<_>>())?;
        for (hit, holds) in hits.iter().zip(held) {
            let held = holds.iter().filter(|holds| **holds).count();
            let share = held as f64 / f64::from(count);
            let (b, k) = (hit.damping_n_s_per_m, hit.stiffness_n_per_m);
            let _ = writeln!(csv, "{cutoff_hz},{b},{k},{held},{count},{share},{SCHEMA_VERSION}");
            shares.push(share);
        }
        bar.inc(of_filter);
    }
    bar.finish_and_clear();
    let at_least = |least: f64| shares.iter().filter(|share| **share >= least).count() as u64;
    let share = shares.iter().sum::<f64>() / points.max(1) as f64;
    let json = ProbableJson {
        scene: &scene.name,
        numeric: numeric.name(),
        points,
        draws: count,
        held_by_95_percent: at_least(0.95),
        held_by_50_percent: at_least(0.5),
        held_by_5_percent: at_least(0.05),
        share,
    };
    Ok((json, csv))
}

impl ProbableJson<'_> {
    fn text(&self) -> String {
        let j = self;
        format!(
            "{}: {} walls, {} draws each; 95 % of them hold {}, half {}, 5 % {}; mean share {:.3}",
            j.scene,
            j.points,
            j.draws,
            j.held_by_95_percent,
            j.held_by_50_percent,
            j.held_by_5_percent,
            j.share
        )
    }
}
