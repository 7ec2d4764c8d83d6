//! The supervisor. Only the supervisor can grant a force, and only while armed.
//!
//! ```text
//!            SampleReport: motion, what the guard found                    Status, Record
//! sample ──────────────────────────────────────▶ render ──────────────────────────▶ link
//! (GuardedSampler, every sample)                 (Supervisor, every output)
//!        ◀──────────────────────────────────────        ◀──────────────────────────
//!            GuardCommand: rendered, acknowledged, zeros                 Request
//! ```
//!
//! The supervisor has two halves, which work at two priorities without locks. The halves exchange plain `Copy` records.
//! [`GuardedSampler`] runs for every sample. It finds a count jump, over-speed or a late output. After such a finding
//! it sets [`Step::cut`], and the task `sample` switches the output off by itself. [`Supervisor`] runs for every
//! output. It has the states, the ramps, the sign test and all other checks. It returns an [`OutputCommand`]. Only
//! [`OutputCommand::On`] has a force, and only this module can make one.
//!
//! ```text
//!  ┌─────┐ arm  ┌──────────┐ moved the right way ┌──────────┐ ramp done ┌───────┐
//!  │ Off │─────▶│ SignTest │────────────────────▶│ RampIn   │──────────▶│ Armed │
//!  └─────┘      └──────────┘                     └──────────┘           └───────┘
//!     ▲  disarm from each of them                                           │
//!     │          ┌───────┐  any fault, from every state                     │
//!     └──────────│ Fault │◀─────────────────────────────────────────────────┘
//!       clear    └───────┘
//! ```
//!
//! How soon the force is off: if the guard finds a fault at a sample, the force is off with this sample, or with the
//! output that this sample requests. If that output does not come, the force is off with the next sample. After most
//! other faults the force is off within one output period and one sample. A later fault is noted, but never replaces
//! the first fault.
//!
//! This is not a certified safety system. The emergency stop must also break the amplifier's enable in hardware.

mod blackbox;
mod debug_halt;
mod doubled;
pub mod envelope;
mod fault;
mod gain_fade;
mod guard;
mod memory;
mod noted;
mod output_command;
mod plan;
mod rate;
mod read_back;
mod records;
mod sign;
mod speed;
mod stuck_encoder;
mod sum;
mod supervisor;
mod token;

pub use blackbox::BlackBox;
pub use debug_halt::HaltWatch;
pub use doubled::Doubled;
pub use fault::{Fault, FaultSet};
pub use guard::{GuardCommand, GuardedSampler, Judged, SampleReport, Step};
pub use memory::{FaultRecord, MemoryUpdate, ResetCause, boot_fault};
pub use noted::{Guard, GuardView};
pub use output_command::{GrantedForce, OutputCommand};
pub use plan::{SLEW, SafetyPlan, SafetySettings};
pub use rate::RateWatch;
pub use read_back::{CurrentSettings, CurrentWatch, OutputWatch, Readings, Written};
pub use records::{Inputs, Refusal, Request, Sensed, State, Status};
pub use sum::sum;
pub use supervisor::{Proposal, Rendered, Supervisor};
pub use token::Token;

#[cfg(test)]
mod tests;
