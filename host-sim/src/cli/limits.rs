//! Options of `sweep` for several limits at once.

use std::fmt;

use clap::{Args, builder::ValueParser};
use zwidth::VelocitySettings;

use super::{
    named,
    shared::{Typed, listed},
};

use crate::{
    error::Error,
    scene::{PushBy, RmsOf, Scene},
    study::{
        limits::{Limit, Question, Situation},
        limits_asked::{Names, check, finer},
    },
};

pub(super) use crate::study::limits_asked::LimitAsked as Asked;

/// Sensation levels that the word `felt` stands for, in dB above `wall_hit.felt_limit_db`.
const LEVELS_DB: [f64; 4] = [0.0, 10.0, 20.0, 30.0];
const NAMES: Names = Names { limits: "--limits", steps: "--steps, --starts" };

/// Options for several limits that are studied side by side.
#[derive(Clone, Debug, Args)]
pub struct LimitArgs {
    /// Limits, with commas between them. For each limit: areas and ideal cutoff, pushed by the motor and by a hand, and
    /// area with the true velocity. A limit is an RMS in m at the handle, `quiet`, `felt` for sensation levels of 0, 10,
    /// 20 and 30 dB over wall_hit.felt_limit_db, or `felt=DB` for DB over the threshold curve.
    #[arg(long, value_name = "LIST", value_parser = parse)]
    limits: Option<Limits>,
    /// With --limits: arms that hold the handle, beside the scene's own; also gives the worst of all. Names of
    /// [arms.NAME] or of built-in models (heavy, light), or `all` [default: those of the scene].
    #[arg(long, value_name = "NAMES", requires = "limits", value_delimiter = ',')]
    arms: Option<Vec<String>>,
    /// With --limits: signal whose RMS is compared with the limit.
    #[arg(long, value_parser = rms_ofs(), default_value = "motion", requires = "limits")]
    rms_of: RmsOf,
    /// With --limits: steps of K and B, in the scene's units [default: a quarter of the scene's K, half of its B].
    #[arg(long, value_name = "K,B", value_parser = pair, requires = "limits")]
    steps: Option<Pair>,
    /// With --limits: first K and B of the walks, in the scene's units [default: one step].
    #[arg(long, value_name = "K,B", value_parser = pair, requires = "limits")]
    starts: Option<Pair>,
}

/// Parser for the signal of the RMS.
pub(super) fn rms_ofs() -> ValueParser {
    named(&[
        ("motion", "The true position", RmsOf::Motion),
        (
            "counts",
            "The encoder's counts. They cannot resolve a limit near one count",
            RmsOf::Counts,
        ),
    ])
}

#[derive(Clone, Debug)]
pub(super) struct Limits(pub Vec<Asked>);

/// Writes the limits as text of a command line.
impl fmt::Display for Limits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&listed(&self.0).unwrap_or_default())
    }
}

/// K and B, in the scene's units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair(pub [f64; 2]);

/// Writes the pair as text of a command line.
impl fmt::Display for Pair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self([k, b]) = self;
        write!(f, "{k},{b}")
    }
}

impl Pair {
    /// The pair in N/m and N s/m, converted from the scene's units.
    pub fn at_handle(self, scene: &Scene) -> [f64; 2] {
        let (Self([k, b]), units) = (self, scene.units);
        [units.stiffness_n_per_m(k), units.damping_n_s_per_m(b)]
    }
}

pub(super) fn parse(text: &str) -> Result<Limits, String> {
    text.split(',').map(Asked::parse).collect::<Result<_, _>>().map(Limits)
}

pub(super) fn pair(text: &str) -> Result<Pair, String> {
    let values: Vec<f64> = text.split(',').map_while(|one| one.trim().parse().ok()).collect();
    match values[..] {
        [k, b] if text.split(',').count() == 2 => Ok(Pair([k, b])),
        _ => Err(format!("`{text}`: two numbers K,B are needed, for example 500,5")),
    }
}

impl LimitArgs {
    /// The question that these options ask about a scene. `None` without `--limits`.
    fn question(
        &self,
        scene: &Scene,
        filters: &[VelocitySettings],
        repeats: u32,
    ) -> Result<Option<Question>, Error> {
        let Some(Limits(asked)) = &self.limits else { return Ok(None) };
        let felt_db = scene.wall_hit.felt_limit_db;
        let limits: Vec<Limit> = asked
            .iter()
            .flat_map(|limit| match limit {
                Asked::Rms(limit_m) => vec![Limit::Rms(*limit_m)],
                Asked::Felt => LEVELS_DB.iter().map(|db| Limit::Felt(felt_db + db)).collect(),
                Asked::FeltAt(_) | Asked::Quiet => vec![limit.of(scene)],
            })
            .collect();
        let at_handle = |pair: Option<Pair>| pair.map(|pair| pair.at_handle(scene));
        let walk = finer(scene, at_handle(self.steps), at_handle(self.starts));
        check(scene, &limits, walk, NAMES)?;
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
            rms_of: self.rms_of,
            filters: filters.to_vec(),
            repeats,
            walk,
            situations: situations.collect(),
            told: true,
        }))
    }

    /// The question that a sweep asks in addition to its own walks. Without `--limits`, the limit is one count. Motor
    /// and hand then push in one walk each, with the scene's steps. The result is `None` if `plain` is set and
    /// `--limits` is not given.
    pub fn or_default(
        &self,
        scene: &Scene,
        filters: &[VelocitySettings],
        repeats: u32,
        plain: bool,
    ) -> Result<Option<Question>, Error> {
        if self.limits.is_some() {
            return self.question(scene, filters, repeats);
        }
        Ok((!plain).then(|| Question {
            limits: vec![Limit::Rms(scene.encoder.resolution_m)],
            rms_of: RmsOf::Motion,
            filters: filters.to_vec(),
            repeats: 1,
            walk: scene.walk,
            situations: PushBy::ALL.map(|push| Situation { push, arm: None }).to_vec(),
            told: true,
        }))
    }

    /// The limits of `--levers`: the user's limits. If the user gave no limits, quiet walls and the scene's limit are
    /// used.
    pub fn of_levers(&self, scene: &Scene) -> Result<Vec<Limit>, Error> {
        let asked = self.question(scene, &[], 1)?.map(|question| question.limits);
        let quiet = Asked::Quiet.of(scene);
        Ok(asked.unwrap_or_else(|| vec![quiet, Limit::Rms(scene.wall_hit.rms_limit_m)]))
    }

    /// Whether the user gave limits.
    pub fn are_asked(&self) -> bool {
        self.limits.is_some()
    }

    /// The options, as text of a command line.
    pub fn as_typed(&self) -> String {
        let counts = (self.rms_of == RmsOf::Counts).then_some("counts");
        Typed(String::new())
            .maybe("limits", self.limits.as_ref())
            .maybe("arms", self.arms.as_ref().map(|arms| arms.join(",")))
            .maybe("rms-of", counts)
            .maybe("steps", self.steps)
            .maybe("starts", self.starts)
            .0
    }
}
