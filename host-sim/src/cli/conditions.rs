//! Options that put other conditions in the place of a scene's: limit, criterion, who pushes, in whose hand, when the loop
//! acts.

use clap::{Args, ValueEnum};

use super::limits::{Limits, RmsOfArg, parse};
use crate::{
    error::Error,
    scene::{Criterion, PushBy, Scene},
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
}

impl Judged {
    /// Puts it into the scene.
    ///
    /// # Errors
    /// The scene cannot have it.
    pub fn apply(self, scene: &mut Scene) -> Result<(), Error> {
        let hit = &mut scene.wall_hit;
        let criterion = self.criterion.map_or(hit.criterion, |criterion| match criterion {
            CriterionArg::Rms => Criterion::Rms,
            CriterionArg::Unsaturated => Criterion::Unsaturated,
            CriterionArg::Felt => Criterion::Felt,
            CriterionArg::Quiet => Criterion::Quiet,
        });
        hit.judge(criterion, self.rms_of.map(Into::into).or(hit.rms_of));
        scene.check().map_err(Error::Input)
    }
}

/// In the place of what the scene says.
#[derive(Clone, Debug, Args)]
pub struct Conditions {
    /// Limit in the place of the scene's: an RMS in m, or `felt` for wall_hit.felt_limit_db.
    #[arg(long, value_name = "LIMIT", value_parser = one, conflicts_with = "criterion")]
    limit: Option<Limits>,
    #[command(flatten)]
    judged: Judged,
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
    /// Puts them into the scene.
    ///
    /// # Errors
    /// There is no such arm, or the scene cannot have them.
    pub fn apply(&self, scene: &mut Scene) -> Result<(), Error> {
        if let Some(limit) = self.limit.as_ref().and_then(|limits| limits.0.first()) {
            limit.of(scene).set(&mut scene.wall_hit);
        }
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
        self.judged.apply(scene)
    }

    /// As on the command line.
    pub fn as_typed(&self) -> String {
        let name =
            |value: Option<clap::builder::PossibleValue>| value.map(|v| v.get_name().to_owned());
        let Judged { rms_of, criterion } = self.judged;
        let typed = [
            ("limit", self.limit.as_ref().map(Limits::as_typed)),
            ("rms-of", name(rms_of.and_then(|value| value.to_possible_value()))),
            ("criterion", name(criterion.and_then(|value| value.to_possible_value()))),
            ("push", name(self.push.and_then(|value| value.to_possible_value()))),
            ("arm", self.arm.clone()),
            ("latency", self.latency.map(|latency| latency.to_string())),
            ("period", self.period.map(|period| period.to_string())),
        ];
        let option =
            |(option, value): (&str, Option<String>)| value.map(|v| format!(" --{option} {v}"));
        typed.into_iter().filter_map(option).collect()
    }
}
