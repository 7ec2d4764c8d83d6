//! The paper's experiments as state machines. Each state machine takes one sample, one output or one verdict at a time.
//! [`Hit`] and [`Walk`] are the same code on the board and in the simulator. A real handle also needs [`HitSequence`]:
//! it has the return move, and protects the motor from overheating.

mod approach;
mod calibration;
mod duty;
mod experiments;
mod hit;
mod hit_sequence;
mod orders;
mod promise;
pub mod pulse_train;
pub mod quiet;
pub(crate) mod return_move;
mod rms;
mod walk;

pub use approach::{AbortReason, ApproachPlan};
pub use calibration::{Calibration, CalibrationEnd, CalibrationPlan, CalibrationSettings};
pub use duty::{Duty, DutyPlan, DutySettings};
#[cfg(test)]
pub(crate) use experiments::Experiment;
pub use experiments::Experiments;
pub use hit::{Hit, HitPlan, HitSettings, Verdict};
pub use hit_sequence::{HitSequence, HitSequencePlan};
pub use orders::{Activity, Event, Gains, Order, PeriodPlan, Report};
pub use promise::{Host, Promise};
pub use pulse_train::{PulseTrain, PulseTrainPlan};
pub use quiet::Criterion;
pub use return_move::{Return, ReturnPlan, ReturnSettings, ReturnStep};
pub use rms::{RmsLimit, RunningVariance};
pub use walk::{Cell, Ended, Step, Walk, WalkError, WalkSettings, WalkTotals};
