//! `design`: finds the best velocity filter, and not only the best cutoff.

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    limits::{Asked, Limits, Pair, pair, parse, rms_ofs},
    progress,
    shared::{Typed, listed},
};
use crate::{
    analysis::design::{Condition, Question, design},
    error::Error,
    interrupt,
    output::{
        design::{ConditionRow, Designs, FilterRow, best_scene},
        estimated::print_of,
        manifest::Manifest,
    },
    scene::{Criterion, NamedScene, PushBy, RmsOf, Scene},
    study::{asked, recommended::ranked},
};

/// Designs a velocity filter for a device: one or two biquads after the finite difference, in the core's fixed point.
/// Poles, lead and second zero are chosen for the worst of several pushes, arms and limits.
///
/// A global search comes first. Then the best filters below several gain peaks are walked again. The result gives the
/// areas in the worst condition. This is the condition in which the ratio to the area of a Butterworth low-pass is
/// smallest. The low-pass has its best cutoff of [sweep]. A scene uses the result with estimator = "biquad" or
/// "biquad-2".
#[derive(Debug, Args)]
pub struct DesignArgs {
    /// Built-in scene or scene file. The scene's estimator is not used.
    scene: String,
    /// Largest ratio of the estimated to the true velocity at any frequency, in dB [default: no limit].
    #[arg(long, value_name = "DB", allow_negative_numbers = true)]
    gain_peak_db: Option<f64>,
    /// Largest delay of the velocity for slow motion, in s. With 0, only the delay of the sample is allowed [default:
    /// no limit].
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    delay: Option<f64>,
    /// Sections of second order. 1: estimator = "biquad". 2: "biquad-2", with twice the cycles.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=2))]
    sections: u8,
    /// Largest RMS of the force above 100 Hz, in N. It is measured at the wall that the result names [default: no
    /// limit].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    roughness: Option<f64>,
    /// Smallest part of the area that must remain if frequency or damping is off by a factor of 1.2 [default: no
    /// limit].
    #[arg(long, value_name = "PART", allow_negative_numbers = true)]
    mistuned: Option<f64>,
    /// Who pushes the handle: motor, hand. With several, the worst is used [default: as in the scene].
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = push)]
    push: Option<Vec<PushBy>>,
    /// Arms that hold the handle; the worst is used. Names in [arms.NAME] or of built-in models (heavy, light), `none`
    /// for the free handle, or `all` for all of these [default: the scene's].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    arms: Option<Vec<String>>,
    /// Limits; the worst is used. `quiet`, RMS limits in m, `felt` for wall_hit.felt_limit_db, `felt=DB` for another
    /// level [default: quiet; with --rms-of or --unsaturated the scene's].
    #[arg(long, value_name = "LIST", value_parser = parse)]
    limits: Option<Limits>,
    /// Signal whose RMS is judged, if not the scene's. The RMS of counts cannot resolve limits near one count.
    #[arg(long, value_parser = rms_ofs())]
    rms_of: Option<RmsOf>,
    /// A wall counts as stable only if no output of the window is at the actuator's limit.
    #[arg(long)]
    unsaturated: bool,
    /// Steps of K and B of the walks, in the scene's units. Walks start at one step [default: steps for quiet walls;
    /// with another limit the scene's].
    #[arg(long, value_name = "K,B", value_parser = pair)]
    steps: Option<Pair>,
    /// Number of filters that the search tries, with two walks each in every condition [default: 6000 divided by the
    /// number of conditions, within 1000 to 3000; twice that for two sections].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=1_000_000))]
    budget: Option<u32>,
    /// Walks of a result in each condition, with starts spread over one count. With 1, all walks have the same start,
    /// and the area is partly luck.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
    /// Seed of the search.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

const FILES: &[&str] = &["design.csv", "tried.csv", "conditions.csv", "best.toml", "front"];

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    filters: Vec<FilterRow>,
    conditions: Vec<ConditionRow>,
    /// Stiffness and damping of the wall at which the roughness is measured.
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    tried: usize,
    notes: Vec<String>,
}

fn push(text: &str) -> Result<PushBy, String> {
    let known = PushBy::ALL.into_iter().find(|push| push.name() == text);
    known.ok_or_else(|| format!("`{text}` pushes nothing, allowed motor, hand"))
}

pub fn run(args: &DesignArgs, common: &Common) -> Result<(), Error> {
    let named = NamedScene::load(&args.scene)?;
    for (option, value, range) in [
        ("--gain-peak-db", args.gain_peak_db, 0.1..=100.0),
        ("--delay", args.delay, -0.1..=0.1),
        ("--roughness", args.roughness, 0.0..=1e6),
        ("--mistuned", args.mistuned, 0.0..=1.0),
    ] {
        if let Some(value) = value {
            crate::range::within(option, value, range).map_err(Error::Input)?;
        }
    }
    let base = args.base(&named, common)?;
    let conditions = args.conditions(base).map_err(|error| error.of(&named.name))?;
    for condition in &conditions {
        asked::prepare(&NamedScene { scene: condition.scene.clone(), ..named.clone() })?;
    }
    let budget = args.budget.unwrap_or_else(|| {
        let number = u32::try_from(conditions.len()).unwrap_or(u32::MAX).max(1);
        u32::from(args.sections) * (6000 / number).clamp(1000, 3000)
    });
    let question = Question {
        conditions,
        gain_peak_db: args.gain_peak_db,
        delay_s: args.delay,
        roughness_n: args.roughness,
        mistuned_share: args.mistuned,
        sections: args.sections,
        budget,
        repeats: args.repeat,
        seed: args.seed,
        numeric: common.numeric,
    };
    let mut to = common.fill(&named, "design", FILES)?;
    let walks = u64::from(budget) * 2 * question.conditions.len() as u64;
    let bar = progress::bar(walks);
    let study = design(common.engine, question, interrupt::flag(), |_| bar.inc(1))
        .map(Designs)
        .map_err(|error| error.of(&named.name))?;
    bar.finish_and_clear();
    to.add("design.csv", study.csv())?;
    to.add("tried.csv", study.tried_csv())?;
    to.add("conditions.csv", study.conditions_csv())?;
    to.add("best.toml", best_scene(&named.scene, &study).map_err(Error::Internal)?)?;
    to.figure("front", &study.figure(&named.name)?)?;
    let results = to.finish(&Manifest::new(args.typed(&named.name, budget, common), &named))?;
    let json = Json {
        scene: &named.name,
        filters: study.rows(),
        conditions: study.condition_rows(),
        stiffness_n_per_m: study.0.wall.stiffness_n_per_m,
        damping_n_s_per_m: study.0.wall.damping_n_s_per_m,
        tried: study.0.tried.len(),
        notes: study.notes(),
    };
    print_of(common.json, &named.scene, json, || {
        format!("{}: {}\n  {results}", named.name, study.text())
    })
}

impl DesignArgs {
    /// The scene with the settings that all conditions share.
    fn base(&self, named: &NamedScene, common: &Common) -> Result<Scene, Error> {
        if self.limits.is_none() && self.rms_of.is_none() && !self.unsaturated {
            asked::prepare(named)?;
            let ranked = ranked(common.how(), named, Criterion::Quiet, None);
            return Ok(ranked.map_err(|error| error.of(&named.name))?.scene.scene);
        }
        let mut base = named.scene.clone();
        if let Some(rms_of) = self.rms_of {
            base.wall_hit.judge(base.wall_hit.criterion, Some(rms_of));
        }
        if self.unsaturated {
            base.wall_hit.criterion = Criterion::Unsaturated;
        }
        Ok(base)
    }

    /// The conditions: every combination of push, arm and limit.
    fn conditions(&self, mut base: Scene) -> Result<Vec<Condition>, Error> {
        if let Some([k, b]) = self.steps.map(|steps| steps.at_handle(&base)) {
            let walk = &mut base.walk;
            (walk.stiffness_start_n_per_m, walk.stiffness_step_n_per_m) = (k, k);
            (walk.damping_start_n_s_per_m, walk.damping_step_n_s_per_m) = (b, b);
        }
        let pushes = self.push.clone().unwrap_or_else(|| vec![base.wall_hit.push_by]);
        let arms: Vec<Option<String>> = match self.arms.as_deref() {
            None => vec![None],
            Some([all]) if all == "all" => {
                std::iter::once("none".to_owned()).chain(base.arm_names()).map(Some).collect()
            }
            Some(names) => names.iter().cloned().map(Some).collect(),
        };
        let limits: Vec<Option<Asked>> = match &self.limits {
            None => vec![None],
            Some(Limits(limits)) => limits.iter().copied().map(Some).collect(),
        };
        let mut conditions = vec![];
        for limit in &limits {
            for arm in &arms {
                for push in &pushes {
                    let mut scene = base.clone();
                    scene.wall_hit.push_by = *push;
                    let mut name = format!("{} pushes", push.name());
                    match arm.as_deref() {
                        None => {}
                        Some("none") => {
                            scene.arm = None;
                            name += ", free";
                        }
                        Some(arm) => {
                            let arm_of = scene.named_arm(arm);
                            scene.arm = Some(
                                arm_of.map_err(|e| Error::Input(format!("--arms: {e}, none")))?,
                            );
                            name += &format!(", arm {arm}");
                        }
                    }
                    if let Some(limit) = limit {
                        limit.of(&scene).set(&mut scene.wall_hit);
                        name += &match limit {
                            Asked::Felt => ", felt".to_owned(),
                            Asked::FeltAt(level_db) => format!(", felt {level_db} dB"),
                            Asked::Rms(limit_m) => format!(", {limit_m:e} m"),
                            Asked::Quiet => ", quiet".to_owned(),
                        };
                    }
                    scene.check().map_err(Error::Input)?;
                    conditions.push(Condition { name, scene });
                }
            }
        }
        Ok(conditions)
    }

    /// The command, as text of a command line.
    fn typed(&self, scene: &str, budget: u32, common: &Common) -> String {
        let pushes: Option<Vec<&str>> =
            self.push.as_ref().map(|all| all.iter().map(|push| push.name()).collect());
        Typed::new("design", scene)
            .maybe("gain-peak-db", self.gain_peak_db)
            .maybe("delay", self.delay)
            .maybe("roughness", self.roughness)
            .maybe("mistuned", self.mistuned)
            .maybe("push", pushes.and_then(|pushes| listed(&pushes)))
            .maybe("arms", self.arms.as_ref().map(|arms| arms.join(",")))
            .maybe("limits", self.limits.as_ref())
            .maybe("rms-of", self.rms_of.map(RmsOf::name))
            .maybe("steps", self.steps)
            .flag("unsaturated", self.unsaturated)
            .with("sections", self.sections)
            .with("budget", budget)
            .with("repeat", self.repeat)
            .with("seed", self.seed)
            .with("numeric", common.numeric.name())
            .by(common)
    }
}
