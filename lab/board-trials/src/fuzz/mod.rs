//! Random sessions on the firmware's image, held against the firmware's library without a chip.
//!
//! | file | holds |
//! |------|-------|
//! | `action` | what is done to a board, and scripts of it |
//! | `oracle` | the library beside the image |
//! | `properties` | rules that hold whatever the library says |
//! | `run`, `counts` | a session, and what it came to |
//! | `generate` | sessions at random |
//! | `shrink` | the shortest session that still fails |
//! | `campaign` | many of them |
//! | `instants` | stop, supply and reset at each instant of an output period |
//! | `report` | options, and what is printed |

mod action;
mod campaign;
mod counts;
mod generate;
mod instants;
mod oracle;
mod properties;
pub mod report;
mod run;
mod shrink;

/// What is wrong, unless the rule holds.
fn rule(holds: bool, otherwise: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(otherwise()) }
}

pub use action::Action;
pub use campaign::{Failure, Outcome, replay, script, sessions};
pub use counts::Counts;
pub use instants::{Sweep, Wrong, sweep};
