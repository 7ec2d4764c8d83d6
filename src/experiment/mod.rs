//! The paper's experiments as state machines that take one sample, one output or one verdict at a
//! time. [`Hit`] and [`Walk`] are the same code on the board and in the simulator; [`Trial`] puts
//! around a hit what only a real handle needs, the way back and a motor that must not overheat.

mod back;
mod calibration;
mod duty;
mod hit;
mod rms;
mod trial;
mod walk;

pub use back::{Return, ReturnPlan, ReturnSettings, ReturnStep};
pub use calibration::{Calibration, CalibrationEnd, CalibrationPlan, CalibrationSettings};
pub use duty::{Duty, DutyPlan, DutySettings};
pub use hit::{Hit, HitPlan, Verdict};
pub use rms::{RmsLimit, Scatter};
pub use trial::{Broken, Trial, TrialPlan};
pub use walk::{Cell, Ended, Step, Walk, WalkError, WalkPlan, WalkTotals};
