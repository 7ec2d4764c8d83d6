//! Tests the simulator's commands as a user runs them.

#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "a test fails loudly; small numbers"
)]

mod agree;
mod cli;
mod compare;
mod design;
mod elements;
mod engine;
mod explain;
mod grid;
#[cfg(unix)]
mod hostile;
mod identify_command;
mod identify_rotary;
mod levers;
mod limits;
mod page;
mod passivity;
mod prepare;
mod read;
mod ready;
mod rotary;
mod schema;
#[cfg(unix)]
mod study;
mod sure;
mod telemetry;
mod trade;
mod walls;
