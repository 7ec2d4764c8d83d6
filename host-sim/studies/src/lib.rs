//! What is asked of the sampled loop of [`sim_loop`].
//!
//! | layer | holds |
//! |-------|-------|
//! | [`analysis`] | linear theory, identification, comparison, trade of formats |
//! | [`study`] | walks, sweeps, sensitivity, envelopes |
#![forbid(unsafe_code)]

pub mod analysis;
pub mod study;

#[cfg(test)]
#[path = "../../../tests/figure.rs"]
mod figure;

use sim_loop::{engine, error, input, notation, numerics, plant, range, scene, simulation};
