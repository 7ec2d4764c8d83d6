//! The paper's experiments as state machines that take one sample, or one verdict, at a time:
//! the same code on the board and in the simulator.

mod hit;
mod rms;
mod walk;

pub use hit::{Hit, HitPlan, Verdict};
pub use rms::{RmsLimit, Scatter};
pub use walk::{Cell, Ended, Step, Walk, WalkError, WalkPlan};
