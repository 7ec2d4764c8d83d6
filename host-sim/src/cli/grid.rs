//! `grid`: every wall of a grid, hit once.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use serde::Serialize;
use zwidth::experiment::Verdict;

use super::{
    Common, SCHEMA_VERSION, STOP, check_wall, cutoff,
    list::{self, List},
    no_cutoff, print_json, print_text, progress, start_offset,
};
use crate::{
    engine::{Depth, stream},
    error::Error,
    output::files::GrowingFile,
    scene::NamedScene,
    simulation::prepared::{HitError, PreparedScene, WallHit},
};

/// Hits every wall of a grid of cutoffs, dampings and stiffnesses: a map of verdict and RMS.
#[derive(Debug, Args)]
pub struct GridArgs {
    /// Built-in scene or scene file.
    scene: String,
    /// Nominal cutoffs, Hz: A,B,C or FROM:STEP:TO; estimators without a cutoff take none.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    cutoffs: Option<List>,
    /// Stiffnesses K of the wall, N/m: A,B,C or FROM:STEP:TO.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    stiffnesses: List,
    /// Dampings B of the wall, N s/m: A,B,C or FROM:STEP:TO.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    dampings: List,
    /// Start this many counts beyond the scene's start.
    #[arg(long, value_name = "COUNTS", default_value_t = 0.0, allow_negative_numbers = true)]
    start_offset: f64,
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
    schema_version: u32,
    command: &'static str,
    scene: &'a str,
    numeric: &'static str,
    points: u64,
    #[serde(flatten)]
    counts: Counts,
}

const HEADER: &str = "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m,verdict,rms_m\n";
const OUT_OF_RANGE: &str = "out_of_range";

/// The walls, numbered: K runs fastest, then B, then the cutoff.
struct Walls {
    cutoffs_hz: Vec<f64>,
    dampings: Vec<f64>,
    stiffnesses: Vec<f64>,
    start_offset_counts: f64,
}

impl Walls {
    fn count(&self) -> u64 {
        [&self.cutoffs_hz, &self.dampings, &self.stiffnesses]
            .map(|list| list.len() as u64)
            .iter()
            .product()
    }

    #[expect(clippy::cast_possible_truncation, reason = "remainders by lengths")]
    fn wall(&self, number: u64) -> WallHit {
        let (per_cutoff, per_damping) =
            ((self.dampings.len() * self.stiffnesses.len()) as u64, self.stiffnesses.len() as u64);
        WallHit {
            cutoff_hz: self.cutoffs_hz[(number / per_cutoff) as usize],
            damping_n_s_per_m: self.dampings[(number % per_cutoff / per_damping) as usize],
            stiffness_n_per_m: self.stiffnesses[(number % per_damping) as usize],
            start_offset_counts: self.start_offset_counts,
        }
    }
}

pub fn run(args: &GridArgs, common: &Common) -> Result<(), Error> {
    let scene = NamedScene::load(&args.scene)?;
    let walls = prepare(args, &scene)?;
    let rig = PreparedScene::new(&scene.scene)?;
    let mut csv = args.csv.as_ref().map(|path| GrowingFile::new(path, common.force)).transpose()?;
    if let Some(csv) = &mut csv {
        csv.write(HEADER.as_bytes())?;
    }
    let points = walls.count();
    let bar = progress::bar_of(points, "walls");
    let (mut counts, mut row) = (Counts::default(), String::new());
    let (numeric, wall) = (common.numeric.into(), |number| walls.wall(number));
    stream(
        common.engine.into(),
        &rig,
        numeric,
        Depth::Whole,
        points,
        wall,
        &STOP,
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
            let Some(csv) = &mut csv else { return Ok(()) };
            let WallHit { cutoff_hz, damping_n_s_per_m, stiffness_n_per_m, .. } =
                walls.wall(number);
            row.clear();
            let _ = write!(row, "{cutoff_hz},{damping_n_s_per_m},{stiffness_n_per_m},{name},");
            let _ = rms_m.map_or(Ok(()), |rms_m| write!(row, "{rms_m}"));
            row.push('\n');
            csv.write(row.as_bytes())
        },
    )?;
    bar.finish_and_clear();
    csv.map_or(Ok(()), GrowingFile::finish)?;
    let (scene, numeric) = (scene.name.as_str(), common.numeric.name());
    if common.json {
        let (schema_version, command) = (SCHEMA_VERSION, "grid");
        return print_json(&Json { schema_version, command, scene, numeric, points, counts });
    }
    let Counts { stable, unstable, no_contact, out_of_range } = counts;
    print_text(&format!(
        "{scene}: {points} walls, {stable} stable, {unstable} unstable, {no_contact} without contact, \
         {out_of_range} out of range"
    ))
}

/// Every value of every list is checked before the first hit.
fn prepare(args: &GridArgs, scene: &NamedScene) -> Result<Walls, Error> {
    let cutoffs_hz = match &args.cutoffs {
        Some(_) if !scene.scene.velocity.has_cutoff() => return Err(no_cutoff(scene)),
        Some(list) => list.0.clone(),
        None => vec![cutoff(scene, None)?],
    };
    let walls = Walls {
        cutoffs_hz,
        dampings: args.dampings.0.clone(),
        stiffnesses: args.stiffnesses.0.clone(),
        start_offset_counts: start_offset(args.start_offset)?,
    };
    let first = walls.wall(0);
    let cutoffs = walls.cutoffs_hz.iter().map(|&cutoff_hz| WallHit { cutoff_hz, ..first });
    let dampings =
        walls.dampings.iter().map(|&damping_n_s_per_m| WallHit { damping_n_s_per_m, ..first });
    let stiffnesses =
        walls.stiffnesses.iter().map(|&stiffness_n_per_m| WallHit { stiffness_n_per_m, ..first });
    for wall in cutoffs.chain(dampings).chain(stiffnesses) {
        check_wall(scene, &wall, "--cutoffs").map_err(|error| match error {
            Error::Input(text) => Error::Input(
                text.replace("--stiffness ", "--stiffnesses ").replace("--damping ", "--dampings "),
            ),
            other => other,
        })?;
    }
    Ok(walls)
}
