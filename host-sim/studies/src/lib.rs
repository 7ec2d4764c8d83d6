//! Studies and analyses of the sampled loop of [`sim_loop`].
//!
//! | layer | holds |
//! |-------|-------|
//! | [`analysis`] | linear theory, identification, comparison |
//! | [`study`] | walks, sweeps, sensitivity, envelopes |
//! | [`table`] | results as rows under named columns |
#![forbid(unsafe_code)]

pub mod analysis;
pub mod study;
pub mod table;

#[cfg(test)]
#[path = "../../../tests/figure.rs"]
mod figure;

use sim_loop::{
    engine, error, input, interrupt, notation, numerics, plant, range, scene, simulation,
};
