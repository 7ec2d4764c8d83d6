//! Orders of the console to the task `render`, and the reports of this task.

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

/// What the board is doing, apart from the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Activity {
    /// Nothing besides the wall.
    #[default]
    None,
    /// A hit of the wall.
    Hit,
    /// A hit with the criterion `quiet`, which has several pushes. The hit sets the push by itself.
    Pushes,
    /// A boundary walk. The walk sets K and B by itself.
    Walk,
    /// A calibration with a constant force.
    Calibration,
    /// A train of force pulses.
    Pulses,
}

impl Activity {
    /// Name of the activity in replies.
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

/// The values that depend on the output period, except the loop's parameters. The console orders the parameters after
/// these values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeriodPlan {
    /// Thermal limits of the motor.
    pub duty: DutyPlan,
    /// The black box records one of `keep` outputs.
    pub keep: u32,
}

#[allow(
    clippy::large_enum_variant,
    reason = "there is no allocator; large with some estimators only"
)]
/// One order. The next [`Report`] has the answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// A request to the supervisor.
    Request(Request),
    /// New settings, and whether their gains are inside the envelope. Gains outside the envelope are allowed only if
    /// the envelope is unlocked.
    LoopParameters(LoopParameters, Gains),
    /// The values for a new output period. The loop's parameters for this period follow in the next order. A new period
    /// is allowed only with the force off.
    Period(PeriodPlan),
    /// Run a wall hit.
    Hit(HitSequencePlan),
    /// Run a pulse train.
    Pulses(PulseTrainPlan),
    /// Hold a constant force, or continue with another one.
    Calibrate(CalibrationPlan),
    /// Set the directions of motor and encoder.
    Signs(Signs),
    /// End the experiment that is running.
    Stop,
    /// Send the content of the black box.
    Replay,
    /// The host is present, and states the time within which it will send `alive` again.
    Alive(Promise),
}

/// Whether gains lie inside the envelope.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gains {
    /// Inside the envelope of stable walls.
    Inside,
    /// Outside the envelope, or not in its tables.
    Outside,
}

/// The event that a report is about.
#[derive(Clone, Copy, Debug)]
pub enum Event {
    /// No event: only the output.
    None,
    /// An order was accepted or refused.
    Answer(Result<(), Refusal>),
    /// A hit is over. The fields are its verdict, and mean and variance of the position over its window.
    HitOver(Verdict, RunningVariance),
    /// Mean and variance of the output codes in the window of the hit. It comes after [`HitOver`](Event::HitOver).
    HitCodes(RunningVariance),
    /// A hit ended without a verdict.
    HitAborted(AbortReason),
    /// A pulse train is complete, or ended early.
    PulsesOver(Result<(), AbortReason>),
    /// The force of a calibration has reached its target.
    CalibrationHolds,
    /// A calibration is over.
    CalibrationOver(CalibrationEnd),
}

/// Report of one output to the console.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Record of this output.
    pub record: Record,
    /// Record for telemetry. It is `record`, or a record of the black box while the black box is sent.
    pub streamed: Record,
    /// Push of the experiment at this output.
    pub push: Force,
    /// Energy that wall and hand have exchanged up to this output.
    pub port: Exchanged,
    /// The supervisor's state.
    pub status: Status,
    /// The running activity.
    pub activity: Activity,
    /// Event of this output.
    pub event: Event,
}
