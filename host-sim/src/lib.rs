//! Simulator of a one-degree-of-freedom haptic device around the control core that the firmware
//! runs, or, where many hits are asked for, around a second text of it with the same bits. It answers: which velocity-filter cutoff gives this device the largest Z-width, the range
//! of walls that stay stable?
//!
//! Each layer uses those below it only:
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
//! | [`scene`] | scene files: devices, elements, experiments, and what they may hold |
//! | [`numerics`] | mathematics that knows no device |
//! | [`input`], [`interrupt`], [`error`] | reading files, Ctrl-C, what can go wrong |
//!
//! A [`scene::Scene`] describes device and experiment. A [`simulation::prepared::PreparedScene`] prepares it and
//! runs wall hits in a [`simulation::Simulation`] around the core
//! ([`Fixed`](simulation::controller::Fixed)) or around its `f64` twin ([`simulation::twin`]).
//! [`study`] leaves the hits of a walk to an [`engine::Engine`]: the core itself, or (by default) lanes, a second
//! text of the core's arithmetic for speed that tests hold to the same bits.
#![forbid(unsafe_code)]

pub mod cli;
pub mod output;

pub use sim_loop::{
    engine, error, input, interrupt, notation, numerics, plant, range, scene, simulation,
};
pub use sim_studies::{analysis, study};
