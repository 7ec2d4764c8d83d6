//! `study` and `study-plan`: many points, divided into units of work.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::{Common, progress};
use crate::{
    error::Error,
    interrupt,
    output::{
        study::{Folder, Part},
        terminal::print_result,
    },
    study::planned::{Study, StudyFile, trial::Estimate},
};

/// Computes every point of a study and writes a file for each unit of work. --resume continues after an interruption.
#[derive(Debug, Args)]
pub struct StudyArgs {
    /// The study: a TOML file.
    study: PathBuf,
    /// Continue with this folder: compute the missing units.
    #[arg(long)]
    resume: bool,
}

/// Estimates what a study would take, from a trial of some of its points. Writes nothing.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// The study: a TOML file.
    study: PathBuf,
}

#[derive(Serialize)]
struct Subject {
    study: String,
    measure: &'static str,
    numeric: &'static str,
    points: u64,
    units: u64,
}

#[derive(Serialize)]
struct Json<'a> {
    #[serde(flatten)]
    subject: Subject,
    /// Number of units that this run has computed. The other units were already in the folder.
    units_made: u64,
    rows: u64,
    hits: u64,
    bytes: u64,
    out: &'a Path,
}

#[derive(Serialize)]
struct PlanJson {
    #[serde(flatten)]
    subject: Subject,
    scenes: u64,
    points_per_unit: u64,
    trial_points: u64,
    threads: usize,
    hits: f64,
    hits_uncertainty: f64,
    time_s: f64,
    time_uncertainty_s: f64,
    bytes: f64,
    bytes_uncertainty: f64,
}

fn load(path: &Path, common: &Common) -> Result<(Study, Subject), Error> {
    let study = Study::new(StudyFile::load(path)?)?;
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    let subject = Subject {
        study: stem.to_string_lossy().into_owned(),
        measure: study.file.keys.measure.name(),
        numeric: common.numeric.name(),
        points: study.points,
        units: study.units,
    };
    Ok((study, subject))
}

pub fn run(args: &StudyArgs, common: &Common) -> Result<(), Error> {
    if common.force {
        return Err(Error::Input(
            "--force is not of study: --resume goes on with a folder, --out writes elsewhere"
                .into(),
        ));
    }
    let (study, subject) = load(&args.study, common)?;
    let default = || Path::new("zwidth-out").join(&subject.study);
    let out = common.out.clone().unwrap_or_else(default);
    let numeric = common.numeric;
    let mut inputs = vec![args.study.clone()];
    inputs.extend(study.files.iter().cloned());
    let mut folder = Folder::open(&out, &study, numeric, args.resume, &inputs)?;
    let bar = progress::bar_of(study.units, "units");
    bar.inc(folder.done().len() as u64);
    let mut units_made = 0;
    for unit in 0..study.units {
        if folder.done().contains_key(&unit) {
            continue;
        }
        interrupt::check()?;
        let made = study.run(unit, common.how())?;
        folder.add(unit, study.unit_key(unit, numeric), &Part::from(&made))?;
        units_made += 1;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let done = folder.finish()?;
    let [rows, hits, bytes] = done.values().fold([0; 3], |[rows, hits, bytes], entry| {
        [rows + entry.rows, hits + entry.hits, bytes + entry.bytes]
    });
    let json = Json { subject, units_made, rows, hits, bytes, out: &out };
    print_result(common.json, &json, || {
        let Subject { study, measure, points, units, .. } = &json.subject;
        format!(
            "{study}: {points} points, {units} units, {units_made} of them made now; {hits} hits of `{measure}`, \
             {rows} rows in {}",
            out.display()
        )
    })
}

pub fn plan(args: &PlanArgs, common: &Common) -> Result<(), Error> {
    let (study, subject) = load(&args.study, common)?;
    let trial = study.trial(common.how())?;
    let json = PlanJson {
        subject,
        scenes: study.blocks.len() as u64 * study.file.variants(),
        points_per_unit: study.blocks.iter().map(|block| block.points_per_unit).max().unwrap_or(0),
        trial_points: trial.points,
        threads: rayon::current_num_threads(),
        hits: trial.hits.value,
        hits_uncertainty: trial.hits.uncertainty,
        time_s: trial.time_s.value,
        time_uncertainty_s: trial.time_s.uncertainty,
        bytes: trial.bytes.value,
        bytes_uncertainty: trial.bytes.uncertainty,
    };
    print_result(common.json, &json, || {
        let PlanJson { scenes, points_per_unit, trial_points, threads, .. } = json;
        let Subject { study, measure, points, units, .. } = &json.subject;
        let told = |of: Estimate| format!("{:.3e} +- {:.1e}", of.value, of.uncertainty);
        format!(
            "{study}: {points} points of `{measure}` in {scenes} scenes, {units} units of up to {points_per_unit} points\n\
             from a trial of {trial_points} points on {threads} threads, with the interval of 95 %:\n\
             hits     {}\n\
             time     {} s\n\
             bytes    {}",
            told(trial.hits),
            told(trial.time_s),
            told(trial.bytes)
        )
    })
}
