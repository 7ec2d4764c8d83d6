//! `sweep`: compares cutoffs.

use std::{collections::BTreeSet, fmt::Write as _, path::PathBuf};

use clap::Args;
use serde::Serialize;
use zwidth::VelocitySettings;

use super::{
    Common,
    draws::DrawArgs,
    limits::LimitArgs,
    list::{self, List},
    progress,
    shared::{Typed, check_filters, listed},
};
use crate::{
    error::Error,
    interrupt,
    output::{
        files::{FolderPlace, Outputs},
        in_units::InUnits,
        levers::LeverStudy,
        limits::LimitStudy,
        probability::ProbabilityStudy,
        rates::RateStudy,
        sweep::{self as sweep_files, Study, Summary, VariantResult},
        terminal::print_result,
    },
    scene::{NamedScene, PushBy, STUDY, Units},
    simulation::prepared::PreparedScene,
    study::{
        How,
        asked::no_cutoff,
        envelope::envelopes,
        levers::{Lever, LeverQuestion, levers, walk_levers},
        limits::{Question, limits},
        probability::{Draws, contour, maps, verdicts},
        rates::Rates,
        recommended::recommended,
        sensitivity::{Variant, variants},
        sweep::{Plan, SweepResult, ascending, filters, sweep},
    },
};

/// Compares cutoffs: Z-width, its area and the scatter of the area, the ideal cutoff and its range.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// Built-in scenes or scene files [default: both paper scenes].
    scenes: Vec<String>,
    /// Nominal cutoffs in Hz: A,B,C or FROM:STEP:TO [default: the scene's].
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    cutoffs: Option<List>,
    /// Walks per cutoff, with starts spread over one count.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
    /// Show how the ideal cutoff changes with RMS limit, push-only, latency, output rate and impact speed.
    #[arg(long)]
    sensitivity: bool,
    /// Find what limits the walls first, by limit and cutoff. The same device runs in other loops: with the latency of
    /// each board and an output every 10, 5, 2 or 1 samples, with an amplifier of 1 kHz, with a handle on a
    /// transmission of 150 Hz, or with the true velocity. Limits: those of --limits, else quiet walls and the scene's
    /// limit.
    #[arg(long, conflicts_with = "plain")]
    levers: bool,
    /// Run the same device with these encoder rates in Hz, each with every output rate that divides the encoder rate.
    /// The latency in seconds stays the same. The limits are those of --levers [default with --output-rates: the
    /// scene's own rate].
    #[arg(long, value_name = "LIST", value_parser = list::parse, conflicts_with = "plain", allow_hyphen_values = true)]
    encoder_rates: Option<List>,
    /// Run the same device with these output rates in Hz [default with --encoder-rates: the scene's own rate].
    #[arg(long, value_name = "LIST", value_parser = list::parse, conflicts_with = "plain", allow_hyphen_values = true)]
    output_rates: Option<List>,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    draws: DrawArgs,
    /// Use only the scene's own criterion, limit and push. By default a limit of one count is added, by motor and by
    /// hand.
    #[arg(long, conflicts_with = "limits")]
    plain: bool,
}

impl SweepArgs {
    /// The rates that the user's options give. `None` without these options.
    fn rates(&self) -> Option<Rates> {
        let asked = self.encoder_rates.is_some() || self.output_rates.is_some();
        let of = |list: &Option<List>| list.as_ref().map(|list| list.0.clone()).unwrap_or_default();
        asked.then(|| Rates {
            encoder_hz: of(&self.encoder_rates),
            output_hz: of(&self.output_rates),
        })
    }
}

#[derive(Serialize)]
struct Json {
    scenes: Vec<InUnits<Summary>>,
}

/// One scene, with everything that its walks need.
struct Job {
    scene: NamedScene,
    prepared: PreparedScene,
    cutoffs_hz: Vec<f64>,
    filters: Vec<VelocitySettings>,
    variants: Vec<Variant>,
    question: Option<Question>,
    levers: Option<LeverQuestion>,
    rates: Option<LeverQuestion>,
    draws: Option<Draws>,
    to: FolderPlace,
    folder: PathBuf,
}

pub fn run(args: &SweepArgs, common: &Common) -> Result<(), Error> {
    let (mut outputs, jobs) = prepare(args, common)?;
    let mut plans = vec![];
    for job in &jobs {
        let variants = job.variants.iter().map(|variant| &variant.prepared);
        for prepared in std::iter::once(&job.prepared).chain(variants) {
            plans.push(Plan { name: &job.scene.name, prepared, filters: &job.filters });
        }
    }
    let walks: usize = plans.iter().map(|plan| plan.filters.len()).sum();
    let bar = progress::bar(walks as u64 * u64::from(args.repeat));
    let numeric = common.numeric;
    let engine = common.engine;
    let results = sweep(engine, &plans, numeric, args.repeat, interrupt::flag(), |_| bar.inc(1))?;
    bar.finish_and_clear();
    let mut results = results.into_iter();
    let (mut summaries, mut tables) = (vec![], vec![]);
    for job in jobs {
        let Job { scene, prepared, cutoffs_hz, variants, question, draws, to, folder, .. } = job;
        let Some(result) = results.next() else {
            return Err(Error::Internal("a scene has no result".into()));
        };
        let variants = variants.into_iter().zip(results.by_ref());
        let variants = variants.map(|(Variant { name, change, .. }, result)| VariantResult {
            name,
            change,
            result,
        });
        let envelopes = envelopes(common.how(), &prepared, &result)?;
        let limits = question.map(|question| {
            let bar = progress::bar(question.walks() as u64);
            let results = limits(common.how(), &scene.scene, &question, || bar.inc(1));
            bar.finish_and_clear();
            results.map(|results| LimitStudy { question, results })
        });
        let (limits, limits_left_out) = match limits.transpose() {
            // if the hand of a scene does not reach the wall, only the scene's own sweep is run
            Err(Error::Input(why)) if !args.limits.are_asked() => (None, Some(why)),
            limits => (limits.map_err(|error| error.of(&scene.name))?, None),
        };
        let walked = |question: Option<LeverQuestion>| {
            let walked = question.map(|question| {
                let bar = progress::bar(question.tasks() as u64);
                let results = walk_levers(common.how(), &question, || bar.inc(1));
                bar.finish_and_clear();
                results.map(|results| LeverStudy { question, results })
            });
            walked.transpose().map_err(|error| error.of(&scene.name))
        };
        let (levers, rates) = (walked(job.levers)?, walked(job.rates)?.map(RateStudy));
        let how = common.how();
        let probability = draws.map(|draws| probability(how, &draws, &result)).transpose();
        let probability = probability.map_err(|error| error.of(&scene.name))?;
        let bar = progress::bar(cutoffs_hz.len() as u64);
        let goes_on = args.cutoffs.is_none();
        let quiet =
            (!args.plain).then(|| recommended(how, &scene, &cutoffs_hz, goes_on, |_| bar.inc(1)));
        let quiet = quiet.transpose().map_err(|error| error.of(&scene.name))?;
        bar.finish_and_clear();
        let study = Study {
            envelopes,
            levers,
            rates,
            probability,
            limits,
            limits_left_out,
            quiet,
            numeric,
            repeats: args.repeat,
            variants: variants.collect(),
            command: command_line(args, common, &scene, &cutoffs_hz),
            scene,
            prepared,
            result,
        };
        study.write(&mut outputs, to)?;
        summaries.push(InUnits(study.scene.scene.units, study.summary()));
        tables.push(table(&study, &folder.display().to_string()));
    }
    outputs.commit()?;
    print_result(common.json, Json { scenes: summaries }, || tables.join("\n"))
}

/// The maps of all cutoffs. Also tries the firmware's contour at the cutoff whose area in the worst draws is largest.
fn probability(
    how: How<'_>,
    draws: &Draws,
    result: &SweepResult,
) -> Result<ProbabilityStudy, Error> {
    let bar = progress::bar_of(result.cutoffs.len() as u64, "maps");
    let maps = maps(how, draws, result, || bar.inc(1))?;
    bar.finish_and_clear();
    let verdicts = verdicts(&maps);
    let leading = verdicts.leading.and_then(|place| maps.get(place));
    let tried = leading.map(|map| contour::fitted(how, draws, map)).transpose()?.flatten();
    Ok(ProbabilityStudy { maps, verdicts, tried })
}

/// Largest number of walks in a sweep. All points of all boundaries are kept in memory: about 100 MB for this number.
const WALKS_MAX: usize = 100_000;

/// Makes all checks that can fail before the first walk.
fn prepare(args: &SweepArgs, common: &Common) -> Result<(Outputs, Vec<Job>), Error> {
    let names: Vec<String> = if args.scenes.is_empty() {
        STUDY.map(str::to_owned).to_vec()
    } else {
        args.scenes.clone()
    };
    let scenes = names.iter().map(|name| NamedScene::load(name)).collect::<Result<Vec<_>, _>>()?;
    let distinct: BTreeSet<&str> = scenes.iter().map(|scene| scene.name.as_str()).collect();
    if distinct.len() < scenes.len() {
        return Err(Error::input("two scenes have the same name; their results would collide"));
    }
    let many = scenes.len() > 1;
    let mut jobs = vec![];
    let inputs: Vec<PathBuf> = scenes.iter().flat_map(|scene| scene.files.clone()).collect();
    let mut outputs = common.outputs(&inputs)?;
    for scene in scenes {
        let asked = args.cutoffs.as_ref().map_or(&scene.scene.sweep.cutoffs_hz, |list| &list.0);
        if !scene.scene.velocity.has_cutoff() {
            return Err(no_cutoff(&scene));
        }
        let cutoffs_hz = ascending(asked);
        let filters = filters(&scene.scene.velocity, &cutoffs_hz);
        check_filters(&scene, &filters)?;
        let folder = match &common.out {
            None => PathBuf::from("zwidth-out").join(&scene.name),
            Some(out) if many => out.join(&scene.name),
            Some(out) => out.clone(),
        };
        let variants = if args.sensitivity { variants(&scene.scene)? } else { vec![] };
        let prepared = crate::study::asked::prepare(&scene)?;
        let question = args.limits.or_default(&scene.scene, &filters, args.repeat, args.plain)?;
        let question_of = |levers: Vec<Lever>| {
            Ok::<_, Error>(LeverQuestion {
                levers,
                limits: args.limits.of_levers(&scene.scene)?,
                pushes: PushBy::ALL.to_vec(),
                cutoffs_hz: cutoffs_hz.clone(),
                repeats: 1,
            })
        };
        let levers = args.levers.then(|| question_of(levers(&scene)?)).transpose()?;
        let rates = args.rates().map(|rates| question_of(rates.loops(&scene)?)).transpose();
        let rates = rates.map_err(|error| error.of(&scene.name))?;
        let draws = args.draws.of(&scene)?;
        let to = outputs.folder(&folder, scene.scene.units, sweep_files::FILES)?;
        let job = Job {
            scene,
            prepared,
            cutoffs_hz,
            filters,
            variants,
            question,
            levers,
            rates,
            draws,
            to,
            folder,
        };
        jobs.push(job);
    }
    let walks_of = |job: &Job| {
        let own = job.filters.len() * (1 + job.variants.len()) * args.repeat as usize;
        let asked = job.question.as_ref().filter(|_| args.limits.are_asked());
        let others = [&job.levers, &job.rates].into_iter().flatten();
        let others = others.map(LeverQuestion::walks).sum::<usize>();
        own + asked.map_or(0, Question::walks) + others
    };
    let walks = jobs.iter().map(walks_of).sum::<usize>();
    if walks > WALKS_MAX {
        return Err(Error::Input(format!(
            "cutoffs and --repeat make {walks} walks, allowed {WALKS_MAX}"
        )));
    }
    Ok((outputs, jobs))
}

fn command_line(
    args: &SweepArgs,
    common: &Common,
    scene: &NamedScene,
    cutoffs_hz: &[f64],
) -> String {
    let rates = |rates: &Option<List>| rates.as_ref().and_then(|rates| listed(&rates.0));
    Typed::new("sweep", &scene.name)
        .maybe("cutoffs", listed(cutoffs_hz))
        .with("repeat", args.repeat)
        .flag("sensitivity", args.sensitivity)
        .flag("plain", args.plain)
        .flag("levers", args.levers)
        .maybe("encoder-rates", rates(&args.encoder_rates))
        .maybe("output-rates", rates(&args.output_rates))
        .and(&args.limits.as_typed())
        .and(&args.draws.as_typed())
        .with("numeric", common.numeric.name())
        .by(common)
}

const HEAD: &str = concat!(
    "     cutoff     -3 dB        area         low        high    peak K     max B\n",
    "         Hz        Hz   N^2 s/m^2                               N/m     N s/m\n",
);

/// The table for people: first the ideal range, then one line per cutoff.
fn table(study: &Study, folder: &str) -> String {
    let units = study.scene.scene.units;
    let [area, stiffness, damping] = ["N^2 s/m^2", "N/m", "N s/m"].map(|unit| units.written(unit));
    let ideal = &study.result.ideal;
    let mut text = String::new();
    let name = &study.scene.name;
    match ideal {
        _ if study.quiet.is_some() => {
            let _ = writeln!(text, "{name}: walls by the scene's own criterion");
        }
        None => {
            let _ = writeln!(text, "{name}: no stable wall at any cutoff");
        }
        Some(ideal) => {
            let [low, high] = ideal.range_hz;
            let true_hz = study.scene.scene.true_cutoff_hz(ideal.cutoff_hz);
            let _ = writeln!(
                text,
                "{name}: ideal cutoff range {low} to {high} Hz, ideal cutoff {} Hz nominal (-3 dB at {true_hz:.1} Hz)",
                ideal.cutoff_hz
            );
        }
    }
    if units.is_rotary() {
        let _ = writeln!(
            text,
            "     cutoff     -3 dB        area         low        high    peak K     max B, in {}, {} and {}",
            area.0, stiffness.0, damping.0
        );
    } else {
        text.push_str(HEAD);
    }
    for row in sweep_files::areas(&study.result) {
        let _ = writeln!(
            text,
            "  {:>9} {:>9.1} {:>11.4e} {:>11.4e} {:>11.4e} {:>9} {:>9}",
            row.cutoff_hz,
            row.true_cutoff_hz,
            row.area * area.1,
            row.area_low * area.1,
            row.area_high * area.1,
            Units::told(row.stiffness_peak_n_per_m, stiffness.1),
            Units::told(row.damping_max_n_s_per_m, damping.1)
        );
    }
    for variant in &study.variants {
        let _ = writeln!(text, "  {}", variant.sentence());
    }
    for (_, told) in study.texts() {
        let _ = writeln!(text, "  {told}");
    }
    for note in study.notes() {
        let _ = writeln!(text, "  note: {note}");
    }
    let _ = writeln!(text, "  report: {folder}/report.html");
    text.push_str(&study.answers().join("\n"));
    text.trim_end().to_owned()
}
