//! What the console asks of the output task, and what the output task reports.

use super::{
    AbortReason, CalibrationEnd, CalibrationPlan, DutyPlan, HitSequencePlan, Promise,
    PulseTrainPlan, RunningVariance, Verdict,
};
use crate::{
    LoopParameters,
    port::Exchanged,
    safety::{Refusal, Request, Status},
    store::Signs,
    telemetry::Record,
    units::Force,
};

/// What goes on besides the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Activity {
    /// Nothing besides the wall.
    #[default]
    None,
    /// A hit of the wall.
    Hit,
    /// The pushes of a quiet hit, which sets them by itself.
    Pushes,
    /// A boundary walk, which sets K and B by itself.
    Walk,
    /// A calibration with a constant force.
    Calibration,
    /// A train of force pulses.
    Pulses,
}

impl Activity {
    /// Name, as replies have it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "idle",
            Self::Hit | Self::Pushes => "hit",
            Self::Walk => "walk",
            Self::Calibration => "calibration",
            Self::Pulses => "pulses",
        }
    }
}

/// Values that depend on the output period, except the loop's parameters, which are ordered after them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeriodPlan {
    /// Thermal limits of the motor.
    pub duty: DutyPlan,
    /// One output in this many goes into the black box.
    pub keep: u32,
}

#[allow(
    clippy::large_enum_variant,
    reason = "there is no allocator; large with some estimators only"
)]
/// One order; answered with the next [`Report`], in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// A request to the supervisor.
    Request(Request),
    /// New settings, and whether their gains are inside the envelope or need it unlocked.
    LoopParameters(LoopParameters, Gains),
    /// Only with the force off: values for the output period of the parameters that come next.
    Period(PeriodPlan),
    /// Run a wall hit.
    Hit(HitSequencePlan),
    /// Run a pulse train.
    Pulses(PulseTrainPlan),
    /// Hold a constant force, or go on with another one.
    Calibrate(CalibrationPlan),
    /// Turn motor and encoder.
    Signs(Signs),
    /// End the experiment that is running.
    Stop,
    /// Send what the black box holds.
    Replay,
    /// The host is there, and promises to send this again.
    Alive(Promise),
}

/// Whether gains lie inside the envelope.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gains {
    /// Inside the envelope of stable walls.
    Inside,
    /// Outside, or unknown to it.
    Outside,
}

/// What a report is about.
#[derive(Clone, Copy, Debug)]
pub enum Event {
    /// Nothing but the output.
    None,
    /// An order was met or refused.
    Answer(Result<(), Refusal>),
    /// A hit is over: its verdict, and the counts of its window.
    HitOver(Verdict, RunningVariance),
    /// The codes of the outputs in that window; comes after the end of the hit.
    HitCodes(RunningVariance),
    /// A hit ended without a verdict.
    HitAborted(AbortReason),
    /// A pulse train is over, or ended before.
    PulsesOver(Result<(), AbortReason>),
    /// The force of a calibration is complete.
    CalibrationHolds,
    /// A calibration is over.
    CalibrationOver(CalibrationEnd),
}

/// One output, as the console sees it.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Record of this very output.
    pub record: Record,
    /// For telemetry: the same record, or one of the black box while that is read out.
    pub streamed: Record,
    /// What an experiment pushed with at this output.
    pub push: Force,
    /// What wall and hand have exchanged up to this output.
    pub port: Exchanged,
    /// The supervisor's state.
    pub status: Status,
    /// What else goes on.
    pub activity: Activity,
    /// Event of this output, if there is one.
    pub event: Event,
}
