//! Random sessions on the firmware's image, held against a model of its pages.
//!
//! | file | holds |
//! |------|-------|
//! | `action` | what is done to a board, and scripts of it |
//! | `command`, `settings`, `envelope`, `answer`, `model` | what each line has to be answered with |
//! | `frames` | telemetry, worked out once more |
//! | `run`, `check`, `mind`, `push`, `compare` | a session, and what it says against all that |
//! | `flood` | lines without a pause, at each output period, held against rules alone |
//! | `generate` | sessions at random |
//! | `shrink` | the shortest session that still fails |
//! | `campaign` | many of them |
//! | `instants` | stop, supply and reset at each instant of an output period |
//! | `report` | options, and what is printed |

mod action;
mod answer;
mod campaign;
mod check;
mod command;
mod compare;
pub mod envelope;
mod flood;
mod frames;
mod generate;
mod instants;
mod mind;
mod model;
mod push;
pub mod report;
mod run;
mod settings;
mod shrink;

pub use action::Action;
pub use campaign::{Failure, Outcome, replay, script, sessions};
pub(crate) use generate::Random;
pub use instants::{Sweep, Wrong, sweep};
pub use run::Counts;
