//! Options of `sweep` that ask for several limits at once.

use clap::{Args, ValueEnum};

use crate::{
    error::Error,
    scene::{PushBy, RmsOf, Scene, Walk},
    study::limits::{Limit, Question, Situation},
};

/// Sensation levels that `felt` stands for, dB over `wall_hit.felt_limit_db`.
const LEVELS_DB: [f64; 4] = [0.0, 10.0, 20.0, 30.0];
/// What a sweep shows without `--limits`: nearer to what a hand feels than the paper's limit, and quick.
const DEFAULT: Limit = Limit::Rms(1e-6);
/// The walks' own steps: the scene's K over this, and its B over half of it.
const FINER: f64 = 4.0;

/// Limits side by side.
#[derive(Clone, Debug, Args)]
pub struct LimitArgs {
    /// Areas and ideal cutoff for each limit, by motor and by hand, and with the true velocity in place of an estimate: RMS
    /// limits in m at the handle, `felt` for sensation levels of 0, 10, 20 and 30 dB over wall_hit.felt_limit_db, and `felt=DB` for one
    /// level over the threshold, which is the threshold curve moved by as much.
    #[arg(long, value_name = "LIST", value_parser = parse)]
    limits: Option<Limits>,
    /// With --limits: also in these arms, and the worst of all: names of [arms.NAME] or of built-in models (heavy, light),
    /// or `all` [default: the scene's].
    #[arg(long, value_name = "NAMES", requires = "limits", value_delimiter = ',')]
    arms: Option<Vec<String>>,
    /// With --limits: what the RMS is taken of.
    #[arg(long, value_enum, default_value_t, requires = "limits")]
    rms_of: RmsOfArg,
    /// With --limits: steps of K and B of the walks, in the scene's units [default: a quarter of the scene's K, half of its B].
    #[arg(long, value_name = "K,B", value_parser = pair, requires = "limits")]
    steps: Option<Pair>,
    /// With --limits: first K and B of the walks, in the scene's units [default: one step].
    #[arg(long, value_name = "K,B", value_parser = pair, requires = "limits")]
    starts: Option<Pair>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(super) enum RmsOfArg {
    /// The true position.
    #[default]
    Motion,
    /// The counts, which resolve no limit near one of them.
    Counts,
}

impl From<RmsOfArg> for RmsOf {
    fn from(rms_of: RmsOfArg) -> Self {
        match rms_of {
            RmsOfArg::Motion => Self::Motion,
            RmsOfArg::Counts => Self::Counts,
        }
    }
}

/// A limit as typed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Asked {
    /// Of the RMS, m.
    Rms(f64),
    /// The scene's level, or several over it.
    Felt,
    /// A level over the threshold, dB: the threshold curve moved by as much.
    FeltAt(f64),
}

/// Limits as typed.
#[derive(Clone, Debug)]
pub(super) struct Limits(pub Vec<Asked>);

impl Limits {
    /// As on the command line.
    pub fn as_typed(&self) -> String {
        let limit = |limit: &Asked| match limit {
            Asked::Rms(limit_m) => format!("{limit_m:e}"),
            Asked::Felt => "felt".into(),
            Asked::FeltAt(level_db) => format!("felt={level_db}"),
        };
        self.0.iter().map(limit).collect::<Vec<String>>().join(",")
    }
}

/// K and B.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair(pub [f64; 2]);

impl Pair {
    /// In N/m and N s/m, typed in the scene's units.
    pub fn at_handle(self, scene: &Scene) -> [f64; 2] {
        let (Self([k, b]), units) = (self, scene.units);
        [units.stiffness_n_per_m(k), units.damping_n_s_per_m(b)]
    }
}

pub(super) fn parse(text: &str) -> Result<Limits, String> {
    let limit = |one: &str| {
        let one = one.trim();
        let (level, number) =
            one.strip_prefix("felt=").map_or((false, one), |number| (true, number));
        match number.parse::<f64>() {
            _ if one == "felt" => Ok(Asked::Felt),
            Ok(level_db) if level && level_db.is_finite() => Ok(Asked::FeltAt(level_db)),
            Ok(limit_m) if !level && limit_m.is_finite() && limit_m > 0.0 => {
                Ok(Asked::Rms(limit_m))
            }
            _ => Err(format!(
                "`{one}` is no limit, allowed an RMS in m above 0, felt, or felt=DB over the threshold"
            )),
        }
    };
    text.split(',').map(limit).collect::<Result<_, _>>().map(Limits)
}

pub(super) fn pair(text: &str) -> Result<Pair, String> {
    let values: Vec<f64> = text.split(',').map_while(|one| one.trim().parse().ok()).collect();
    match values[..] {
        [k, b] if text.split(',').count() == 2 => Ok(Pair([k, b])),
        _ => Err(format!("`{text}` is not two numbers K,B")),
    }
}

impl LimitArgs {
    /// What they ask of a scene; `None` without `--limits`.
    fn question(
        &self,
        scene: &Scene,
        cutoffs_hz: &[f64],
        repeats: u32,
    ) -> Result<Option<Question>, Error> {
        let Some(Limits(asked)) = &self.limits else { return Ok(None) };
        let felt_db = scene.wall_hit.felt_limit_db;
        let limits: Vec<Limit> = asked
            .iter()
            .flat_map(|limit| match limit {
                Asked::Rms(limit_m) => vec![Limit::Rms(*limit_m)],
                Asked::Felt => LEVELS_DB.iter().map(|db| Limit::Felt(felt_db + db)).collect(),
                Asked::FeltAt(level_db) => vec![Limit::Felt(*level_db)],
            })
            .collect();
        let walk = finer(scene, self.steps, self.starts);
        check(scene, &limits, walk)?;
        let arms: Vec<String> = match self.arms.as_deref() {
            None => scene.arms.keys().cloned().collect(),
            Some([all]) if all == "all" => scene.arm_names(),
            Some(names) => names.to_vec(),
        };
        for name in &arms {
            scene.named_arm(name).map_err(|error| Error::Input(format!("--arms: {error}")))?;
        }
        let hands = std::iter::once(None).chain(arms.into_iter().map(Some));
        let situations =
            hands.flat_map(|arm| PushBy::ALL.map(|push| Situation { push, arm: arm.clone() }));
        Ok(Some(Question {
            limits,
            rms_of: self.rms_of.into(),
            cutoffs_hz: cutoffs_hz.to_vec(),
            repeats,
            walk,
            situations: situations.collect(),
            told: true,
        }))
    }

    /// What a sweep asks beside its own walks: as `--limits`, else one limit by motor and by hand, one walk each, with
    /// the scene's steps; `None` with `plain`.
    pub fn or_default(
        &self,
        scene: &Scene,
        cutoffs_hz: &[f64],
        repeats: u32,
        plain: bool,
    ) -> Result<Option<Question>, Error> {
        if self.limits.is_some() {
            return self.question(scene, cutoffs_hz, repeats);
        }
        Ok((!plain).then(|| Question {
            limits: vec![DEFAULT],
            rms_of: RmsOf::Motion,
            cutoffs_hz: cutoffs_hz.to_vec(),
            repeats: 1,
            walk: scene.walk,
            situations: PushBy::ALL.map(|push| Situation { push, arm: None }).to_vec(),
            told: true,
        }))
    }

    /// The limits of `--levers`: those that were asked for, else the scene's and the one of a plain sweep.
    pub fn of_levers(&self, scene: &Scene, cutoffs_hz: &[f64]) -> Result<Vec<Limit>, Error> {
        let asked = self.question(scene, cutoffs_hz, 1)?.map(|question| question.limits);
        Ok(asked.unwrap_or_else(|| {
            let own = Limit::Rms(scene.wall_hit.rms_limit_m);
            if own == DEFAULT { vec![own] } else { vec![own, DEFAULT] }
        }))
    }

    /// Whether the limits were asked for.
    pub fn are_asked(&self) -> bool {
        self.limits.is_some()
    }

    /// As on the command line.
    pub fn as_typed(&self) -> String {
        let Some(limits) = &self.limits else { return String::new() };
        let mut text = format!(" --limits {}", limits.as_typed());
        if let Some(arms) = &self.arms {
            text += &format!(" --arms {}", arms.join(","));
        }
        if self.rms_of == RmsOfArg::Counts {
            text += " --rms-of counts";
        }
        for (option, pair) in [("steps", self.steps), ("starts", self.starts)] {
            if let Some(Pair([k, b])) = pair {
                text += &format!(" --{option} {k},{b}");
            }
        }
        text
    }
}

/// The walks' own grid: those steps, from those starts.
pub(super) fn finer(scene: &Scene, steps: Option<Pair>, starts: Option<Pair>) -> Walk {
    let own = &scene.walk;
    let [steps, starts] = [steps, starts].map(|pair| pair.map(|pair| pair.at_handle(scene)));
    let default = [own.stiffness_step_n_per_m / FINER, own.damping_step_n_s_per_m / FINER * 2.0];
    let [k_step, b_step] = steps.unwrap_or(default);
    let [k_start, b_start] = starts.unwrap_or([k_step, b_step]);
    Walk {
        stiffness_start_n_per_m: k_start,
        stiffness_step_n_per_m: k_step,
        damping_start_n_s_per_m: b_start,
        damping_step_n_s_per_m: b_step,
        ..*own
    }
}

/// Every limit and the grid, before the first walk.
pub(super) fn check(scene: &Scene, limits: &[Limit], walk: Walk) -> Result<(), Error> {
    let refused = |option: &str, error: String| Error::Input(format!("{option}: {error}"));
    let mut changed = Scene { walk, ..scene.clone() };
    changed.check().map_err(|error| refused("--steps, --starts", error))?;
    for limit in limits {
        match limit {
            Limit::Rms(limit_m) => changed.wall_hit.rms_limit_m = *limit_m,
            Limit::Felt(limit_db) => {
                changed.wall_hit.criterion = crate::scene::Criterion::Felt;
                changed.wall_hit.felt_limit_db = *limit_db;
            }
        }
        changed.check().map_err(|error| refused("--limits", error))?;
    }
    Ok(())
}
