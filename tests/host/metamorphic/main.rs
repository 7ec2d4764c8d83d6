//! What must hold between runs of the simulator, whatever the numbers are: scaled, shifted and mirrored scenes,
//! neutral elements, commands against each other, and against a second, independent text.
//!
//! A few random cases of each relation run in `cargo test`, the same every time. `METAMORPHIC_CASES=100` makes that
//! many times more, `METAMORPHIC_SEED=7` makes others; a failure names its case.

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
