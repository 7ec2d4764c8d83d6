//! What is flashed, on the virtual board: the release ELF of each board and of its variants, and programs around
//! parts of the core that tell what those cost. One program, so that two of its tests run at any time.

#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "a test fails loudly; small numbers, addresses of 32 bits"
)]

mod boot;
mod code;
mod control;
mod control_path;
mod edge_times;
mod edges;
mod estimator_cost;
mod estimators;
mod faults;
mod filter_cost;
mod firmware;
mod identify_telemetry;
mod mailbox;
mod panics;
mod period;
mod walk;
