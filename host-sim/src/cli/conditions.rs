//! Options that replace conditions of a scene: limit, criterion, who pushes, the arm on the handle, time of the
//! outputs.

use clap::{Args, builder::ValueParser};

use super::{
    Common,
    limits::{Limits, parse, rms_ofs},
    named,
    shared::Typed,
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
    #[arg(long, value_parser = rms_ofs())]
    rms_of: Option<RmsOf>,
    /// When a wall counts as stable, in the place of the scene's.
    #[arg(long, value_parser = criteria())]
    criterion: Option<Criterion>,
    /// How it is tried, in the place of the scene's: the paper's constant push; the last 2 s of a minute of it; taps, two a
    /// second, the last half of each contact; a hand's push that sways by 30 %, motion and force above 20 Hz.
    #[arg(long, value_parser = named(&Protocol::ALL.map(|of| (of.name(), "", of))))]
    protocol: Option<Protocol>,
}

impl Judged {
    /// Puts the options into the scene.
    ///
    /// # Errors
    /// The options do not suit the scene.
    pub fn apply(self, named: &mut NamedScene) -> Result<(), Error> {
        let scene = &mut named.scene;
        let hit = &mut scene.wall_hit;
        let criterion = self.criterion.unwrap_or(hit.criterion);
        hit.judge(criterion, self.rms_of.or(hit.rms_of));
        hit.protocol = self.protocol.unwrap_or(hit.protocol);
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
    #[arg(long, value_parser = rms_ofs())]
    rms_of: Option<RmsOf>,
    /// When a wall counts as stable. `quiet` walks on a grid that suits these walls, and the area by the scene's own
    /// criterion stands beside [default: quiet, or the limit's].
    #[arg(long, value_parser = criteria())]
    criterion: Option<Criterion>,
    /// Who pushes, in the place of the scene's.
    #[arg(long, value_parser = named(&PushBy::ALL.map(|of| (of.name(), "", of))))]
    push: Option<PushBy>,
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

fn criteria() -> ValueParser {
    named(&Criterion::ALL.map(|of| (of.name(), "", of)))
}

fn one(text: &str) -> Result<Limits, String> {
    parse(text).and_then(|limits| match limits.0.len() {
        1 => Ok(limits),
        more => Err(format!("{more} limits, allowed one")),
    })
}

impl Conditions {
    /// The conditions for ranking estimators or changes. The options must be [applied](Self::apply) to the scene
    /// before.
    ///
    /// # Errors
    /// The scene does not suit the criterion, or has no quiet wall.
    pub fn ranked(&self, scene: &NamedScene, common: &Common) -> Result<Ranked, Error> {
        let mut scene = scene.clone();
        let limit = self.limit.as_ref().and_then(|limits| limits.0.first());
        let limit = limit.map(|limit| limit.of(&scene.scene));
        let rms_of = self.rms_of;
        let own = &mut scene.scene.wall_hit;
        let (by, rms_of) = match limit {
            Some(limit @ (Limit::Rms(_) | Limit::Felt(_))) => {
                limit.set(own);
                (own.criterion, rms_of.or(own.rms_of))
            }
            _ => match self.criterion.unwrap_or(Criterion::Quiet) {
                Criterion::Quiet => (Criterion::Quiet, rms_of),
                by => (by, rms_of.or(own.rms_of)),
            },
        };
        ranked(common.how(), &scene, by, rms_of).map_err(|error| error.of(&scene.name))
    }

    /// Puts the options into the scene, except the criterion.
    ///
    /// # Errors
    /// There is no such arm, or the options do not suit the scene.
    pub fn apply(&self, scene: &mut Scene) -> Result<(), Error> {
        scene.wall_hit.push_by = self.push.unwrap_or(scene.wall_hit.push_by);
        if let Some(name) = &self.arm {
            let arm = scene.named_arm(name);
            scene.arm = Some(arm.map_err(|error| Error::Input(format!("--arm: {error}")))?);
        }
        let actuator = &mut scene.actuator;
        actuator.latency = self.latency.unwrap_or(actuator.latency);
        actuator.period = self.period.unwrap_or(actuator.period);
        scene.check().map_err(Error::Input)
    }

    /// The options as on the command line.
    pub fn as_typed(&self) -> String {
        Typed(String::new())
            .maybe("limit", self.limit.as_ref())
            .maybe("rms-of", self.rms_of.map(RmsOf::name))
            .maybe("criterion", self.criterion.map(Criterion::name))
            .maybe("push", self.push.map(PushBy::name))
            .maybe("arm", self.arm.as_ref())
            .maybe("latency", self.latency)
            .maybe("period", self.period)
            .0
    }
}
