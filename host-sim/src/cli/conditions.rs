//! Options that put other conditions in the place of a scene's: limit, criterion, who pushes, in whose hand, when the loop
//! acts.

use clap::{Args, ValueEnum};

use super::{
    Common,
    limits::{Limits, RmsOfArg, parse},
};
use crate::{
    error::Error,
    scene::{Criterion, NamedScene, Protocol, PushBy, RmsOf, Scene},
    study::{
        limits::Limit,
        recommended::{Ranked, ranked},
    },
};

/// When a wall counts as stable.
#[derive(Clone, Copy, Debug, Args)]
pub struct Judged {
    /// What the RMS is taken of, in the place of the scene's; counts resolve no limit near one of them.
    #[arg(long, value_enum)]
    rms_of: Option<RmsOfArg>,
    /// When a wall counts as stable, in the place of the scene's.
    #[arg(long, value_enum)]
    criterion: Option<CriterionArg>,
    /// How it is tried, in the place of the scene's: the paper's constant push; the last 2 s of a minute of it; taps, two a
    /// second, the last half of each contact; a hand's push that sways by 30 %, motion and force above 20 Hz.
    #[arg(long, value_enum)]
    protocol: Option<ProtocolArg>,
}

impl Judged {
    /// Puts it into the scene.
    ///
    /// # Errors
    /// The scene cannot have it.
    pub fn apply(self, named: &mut NamedScene) -> Result<(), Error> {
        let scene = &mut named.scene;
        let hit = &mut scene.wall_hit;
        let criterion = self.criterion.map_or(hit.criterion, Into::into);
        hit.judge(criterion, self.rms_of.map(Into::into).or(hit.rms_of));
        hit.protocol = self.protocol.map_or(hit.protocol, Into::into);
        let checked = scene.check().map_err(|why| scene.units.text(&why));
        checked.map_err(|why| Error::Input(why).of(&named.name))
    }
}

/// In the place of what the scene says.
#[derive(Clone, Debug, Args)]
pub struct Conditions {
    /// Limit in the place of the scene's: an RMS in m, or `felt` for wall_hit.felt_limit_db.
    #[arg(long, value_name = "LIMIT", value_parser = one, conflicts_with = "criterion")]
    limit: Option<Limits>,
    /// What the RMS is taken of, in the place of the scene's; counts resolve no limit near one of them.
    #[arg(long, value_enum)]
    rms_of: Option<RmsOfArg>,
    /// When a wall counts as stable. `quiet` walks on a grid that suits these walls, and the area by the scene's own
    /// criterion stands beside [default: quiet, or the limit's].
    #[arg(long, value_enum)]
    criterion: Option<CriterionArg>,
    /// Who pushes, in the place of the scene's.
    #[arg(long, value_enum)]
    push: Option<PushArg>,
    /// The arm that holds the handle: a name of [arms.NAME] or of a built-in model (heavy, light).
    #[arg(long, value_name = "NAME")]
    arm: Option<String>,
    /// Samples from a reading to its force, in the place of actuator.latency.
    #[arg(long, value_name = "SAMPLES", allow_negative_numbers = true)]
    latency: Option<f64>,
    /// Samples per output, in the place of actuator.period.
    #[arg(long, value_name = "SAMPLES")]
    period: Option<u32>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum CriterionArg {
    Rms,
    Unsaturated,
    Felt,
    Quiet,
}

impl From<CriterionArg> for Criterion {
    fn from(arg: CriterionArg) -> Self {
        match arg {
            CriterionArg::Rms => Self::Rms,
            CriterionArg::Unsaturated => Self::Unsaturated,
            CriterionArg::Felt => Self::Felt,
            CriterionArg::Quiet => Self::Quiet,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ProtocolArg {
    Paper,
    Press,
    Taps,
    Hand,
}

impl From<ProtocolArg> for Protocol {
    fn from(arg: ProtocolArg) -> Self {
        match arg {
            ProtocolArg::Paper => Self::Paper,
            ProtocolArg::Press => Self::Press,
            ProtocolArg::Taps => Self::Taps,
            ProtocolArg::Hand => Self::Hand,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PushArg {
    Motor,
    Hand,
}

fn one(text: &str) -> Result<Limits, String> {
    parse(text).and_then(|limits| match limits.0.len() {
        1 => Ok(limits),
        more => Err(format!("{more} limits, allowed one")),
    })
}

impl Conditions {
    /// A scene to which they were [applied](Self::apply), as its estimators or changes are ranked.
    ///
    /// # Errors
    /// The scene cannot have the criterion, or it has no quiet wall.
    pub fn ranked(&self, scene: &NamedScene, common: &Common) -> Result<Ranked, Error> {
        let mut scene = scene.clone();
        let limit = self.limit.as_ref().and_then(|limits| limits.0.first());
        let limit = limit.map(|limit| limit.of(&scene.scene));
        let rms_of = self.rms_of.map(RmsOf::from);
        let own = &mut scene.scene.wall_hit;
        let (by, rms_of) = match limit {
            Some(limit @ (Limit::Rms(_) | Limit::Felt(_))) => {
                limit.set(own);
                (own.criterion, rms_of.or(own.rms_of))
            }
            _ => match self.criterion.map_or(Criterion::Quiet, Into::into) {
                Criterion::Quiet => (Criterion::Quiet, rms_of),
                by => (by, rms_of.or(own.rms_of)),
            },
        };
        ranked(common.how(), &scene, by, rms_of).map_err(|error| error.of(&scene.name))
    }

    /// Puts them into the scene, but for the criterion.
    ///
    /// # Errors
    /// There is no such arm, or the scene cannot have them.
    pub fn apply(&self, scene: &mut Scene) -> Result<(), Error> {
        if let Some(push) = self.push {
            scene.wall_hit.push_by = match push {
                PushArg::Motor => PushBy::Motor,
                PushArg::Hand => PushBy::Hand,
            };
        }
        if let Some(name) = &self.arm {
            let arm = scene.named_arm(name);
            scene.arm = Some(arm.map_err(|error| Error::Input(format!("--arm: {error}")))?);
        }
        if let Some(latency) = self.latency {
            scene.actuator.latency = latency;
        }
        if let Some(period) = self.period {
            scene.actuator.period = period;
        }
        scene.check().map_err(Error::Input)
    }

    /// As on the command line.
    pub fn as_typed(&self) -> String {
        let name =
            |value: Option<clap::builder::PossibleValue>| value.map(|v| v.get_name().to_owned());
        let Self { rms_of, criterion, .. } = self;
        let typed = [
            ("limit", self.limit.as_ref().map(Limits::as_typed)),
            ("rms-of", name(rms_of.as_ref().and_then(|value| value.to_possible_value()))),
            ("criterion", name(criterion.as_ref().and_then(|value| value.to_possible_value()))),
            ("push", name(self.push.as_ref().and_then(|value| value.to_possible_value()))),
            ("arm", self.arm.clone()),
            ("latency", self.latency.map(|latency| latency.to_string())),
            ("period", self.period.map(|period| period.to_string())),
        ];
        let option =
            |(option, value): (&str, Option<String>)| value.map(|v| format!(" --{option} {v}"));
        typed.into_iter().filter_map(option).collect()
    }
}
