//! Options that replace conditions of a scene: limit, criterion, who pushes, arm on the handle, and times of the
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

/// How a wall is tried, and when it counts as stable.
#[derive(Clone, Copy, Debug, Args)]
pub struct Judged {
    /// Signal whose RMS is judged, if not the scene's. The RMS of counts cannot resolve limits near one count.
    #[arg(long, value_parser = rms_ofs())]
    rms_of: Option<RmsOf>,
    /// Criterion for a stable wall, if not the scene's.
    #[arg(long, value_parser = criteria())]
    criterion: Option<Criterion>,
    /// How a wall is tried, instead of the scene's way. `paper`: a constant push. `press`: the last 2 s of a constant
    /// push that lasts a minute. `taps`: two taps a second; the last half of each contact is judged. `hand`: a push
    /// that sways by 30 %; motion and force above 20 Hz are judged.
    #[arg(long, value_parser = named(&Protocol::ALL.map(|of| (of.name(), "", of))))]
    protocol: Option<Protocol>,
}

impl Judged {
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

/// Options that replace values of the scene.
#[derive(Clone, Debug, Args)]
pub struct Conditions {
    /// Limit instead of the scene's: an RMS in m, or `felt` for wall_hit.felt_limit_db.
    #[arg(long, value_name = "LIMIT", value_parser = one, conflicts_with = "criterion")]
    limit: Option<Limits>,
    /// Signal whose RMS is judged, if not the scene's. The RMS of counts cannot resolve limits near one count.
    #[arg(long, value_parser = rms_ofs())]
    rms_of: Option<RmsOf>,
    /// Criterion for a stable wall. `quiet` has its own grid of K and B, and also gives the area by the scene's own
    /// criterion [default: quiet; with --limit, the criterion of this limit].
    #[arg(long, value_parser = criteria())]
    criterion: Option<Criterion>,
    /// Who pushes, instead of the scene's pusher.
    #[arg(long, value_parser = named(&PushBy::ALL.map(|of| (of.name(), "", of))))]
    push: Option<PushBy>,
    /// The arm that holds the handle: a name in [arms.NAME], or a built-in model (heavy, light).
    #[arg(long, value_name = "NAME")]
    arm: Option<String>,
    /// Samples from a reading to its force, instead of actuator.latency.
    #[arg(long, value_name = "SAMPLES", allow_negative_numbers = true)]
    latency: Option<f64>,
    /// Samples per output, instead of actuator.period.
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
    /// The conditions under which estimators or changes are ranked. Before this call, the options must be
    /// [applied](Self::apply) to the scene.
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

    /// Sets all options except the criterion in the scene.
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

    /// The options, as text of a command line.
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
