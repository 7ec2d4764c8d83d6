//! Relations between runs of the simulator that hold for all numbers. The relations cover scaled, shifted and mirrored
//! scenes, and neutral elements. Further relations compare commands with other commands, and with a second, independent
//! implementation.
//!
//! `cargo test` runs a few random cases of each relation, always the same. `METAMORPHIC_CASES=100` runs a hundred times
//! as many, and `METAMORPHIC_SEED=7` runs other cases. A failure names its case.

#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "a test fails loudly; small numbers"
)]

mod commands;
mod compare;
mod dice;
mod identify;
mod independent;
mod linear;
mod scaling;
mod symmetry;
