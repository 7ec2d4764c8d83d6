//! Runs random sessions on the firmware's image, and compares it with the firmware's library without a chip.
//!
//! | file | holds |
//! |------|-------|
//! | `action` | an action on a board, and scripts of actions |
//! | `oracle` | the library, compared with the image |
//! | `properties` | rules that do not depend on the library |
//! | `run`, `counts` | a session and its counts |
//! | `generate` | random sessions |
//! | `shrink` | the shortest session with the same failure |
//! | `campaign` | many sessions |
//! | `bursts` | up to 2,000 lines at once, checked by the rules alone |
//! | `instants` | stop, supply and reset at each instant of an output period |
//! | `report` | options and printed results |

mod action;
mod bursts;
mod campaign;
mod counts;
mod generate;
mod instants;
mod oracle;
mod properties;
pub mod report;
mod run;
mod shrink;

/// Returns the error `otherwise` unless the rule holds.
fn rule(holds: bool, otherwise: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(otherwise()) }
}

pub use action::Action;
pub use bursts::{Row, bursts};
pub use campaign::{Failure, Outcome, replay, script, sessions};
pub use counts::Counts;
pub use instants::{Sweep, Wrong, sweep};
