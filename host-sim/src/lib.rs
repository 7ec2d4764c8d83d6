//! Simulator of a one-degree-of-freedom haptic device with the control core of the firmware. The simulator answers this
//! question: which filter cutoff gives a device the largest Z-width? The Z-width is the range of walls that stay
//! stable.
//!
//! Each layer uses only the layers below it:
//!
//! | layer | holds |
//! |-------|-------|
//! | [`cli`] | one file per command |
//! | [`output`] | files, figures, reports, manifests |
//! | [`analysis`] | linear theory, identification, comparison, trade of formats |
//! | [`study`] | walks, sweeps, sensitivity, envelopes |
//! | [`engine`] | many wall hits, by the core itself or side by side in vector lanes |
//! | [`simulation`] | the sampled loop: plant, encoder, controller, latency |
//! | [`plant`] | the device over one sample |
//! | [`scene`] | scene files: devices, elements, experiments, and their allowed values |
//! | [`numerics`] | mathematics that is independent of the device |
//! | [`input`], [`interrupt`], [`error`] | reading files, Ctrl-C, errors |
//!
//! A [`scene::Scene`] describes device and experiment. A [`simulation::prepared::PreparedScene`] prepares the scene and
//! runs wall hits. Each hit is a [`simulation::Simulation`] with the core ([`Fixed`](simulation::controller::Fixed)) or
//! with its `f64` twin ([`simulation::twin`]).
//!
//! [`study`] passes the hits of a walk to an [`engine::Engine`]: the core itself, or lanes (the default). Lanes
//! implement the core's arithmetic again, for speed. Tests check that core and lanes give the same bits.
#![forbid(unsafe_code)]

pub mod cli;
pub mod output;

pub use sim_loop::{
    engine, error, input, interrupt, notation, numerics, plant, range, scene, simulation,
};
pub use sim_studies::{analysis, study};
