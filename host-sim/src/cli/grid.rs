//! `grid`: every wall of a grid, hit once.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use serde::Serialize;
use zwidth::experiment::Verdict;

use super::{
    Common,
    list::{self, List},
    progress,
    shared::{AtCutoffs, Grid, Start},
};
use crate::{
    engine::{Depth, stream},
    error::Error,
    interrupt,
    output::{files::Outputs, in_units::Columns, terminal::print_result},
    simulation::prepared::{HitError, WallHit},
    study::asked::prepare,
};

/// Hits every wall of a grid of cutoffs, dampings and stiffnesses: a map of verdict and RMS.
#[derive(Debug, Args)]
pub struct GridArgs {
    #[command(flatten)]
    at: AtCutoffs,
    /// Stiffnesses K of the wall, N/m: A,B,C or FROM:STEP:TO.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    stiffnesses: List,
    #[command(flatten)]
    start: Start,
    /// Write one row per wall.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

/// How many walls came to what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
struct Counts {
    stable: u64,
    unstable: u64,
    no_contact: u64,
    /// The handle left the core's range.
    out_of_range: u64,
}

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    numeric: &'static str,
    points: u64,
    #[serde(flatten)]
    counts: Counts,
}

const HEADER: &str = "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m,verdict,rms_m\n";
const OUT_OF_RANGE: &str = "out_of_range";

pub fn run(args: &GridArgs, common: &Common) -> Result<(), Error> {
    let Grid { scene, walls } = args.at.load(&args.stiffnesses.0, Some(args.start))?;
    let prepared = prepare(&scene)?;
    let mut outputs = Outputs::new(common.force, &scene.files);
    let csv = outputs.option(args.csv.as_ref())?;
    let columns = Columns::new(scene.scene.units, HEADER);
    if let Some(csv) = csv {
        outputs.write(csv, columns.header.as_bytes())?;
    }
    let points = walls.count();
    let bar = progress::bar_of(points, "walls");
    let (mut counts, mut row) = (Counts::default(), String::new());
    let (numeric, wall) = (common.numeric, |number| walls.wall(number));
    stream(
        common.engine.into(),
        &prepared,
        numeric,
        Depth::Whole,
        points,
        wall,
        interrupt::flag(),
        |number, outcome| {
            let (name, rms_m) = match outcome {
                Ok(outcome) => (outcome.verdict.name(), outcome.rms_m),
                Err(HitError::OutOfRange(_)) => (OUT_OF_RANGE, None),
                Err(error) => return Err(error.into()),
            };
            match outcome.map(|outcome| outcome.verdict) {
                Ok(Verdict::Stable) => counts.stable += 1,
                Ok(Verdict::Unstable) => counts.unstable += 1,
                Ok(Verdict::NoContact) => counts.no_contact += 1,
                Err(_) => counts.out_of_range += 1,
            }
            bar.inc(1);
            let Some(csv) = csv else { return Ok(()) };
            let WallHit { cutoff_hz, damping_n_s_per_m, stiffness_n_per_m, .. } =
                walls.wall(number);
            row.clear();
            let _ = write!(row, "{cutoff_hz},{damping_n_s_per_m},{stiffness_n_per_m},{name},");
            let _ = rms_m.map_or(Ok(()), |rms_m| write!(row, "{rms_m}"));
            row.push('\n');
            let is_rotary = scene.scene.units.is_rotary();
            let told = if is_rotary { columns.row(&row) } else { std::mem::take(&mut row) };
            outputs.write(csv, told.as_bytes())
        },
    )?;
    bar.finish_and_clear();
    outputs.commit()?;
    let (scene, numeric) = (scene.name.as_str(), common.numeric.name());
    let Counts { stable, unstable, no_contact, out_of_range } = counts;
    print_result(common.json, Json { scene, numeric, points, counts }, || {
        format!(
            "{scene}: {points} walls, {stable} stable, {unstable} unstable, {no_contact} without contact, \
             {out_of_range} out of range"
        )
    })
}
