//! Simulator of a one-degree-of-freedom haptic device around the very control core that the
//! firmware runs. It answers: which velocity-filter cutoff gives this device the largest Z-width,
//! the range of walls that stay stable?
//!
//! A [`scene::Scene`] describes device and experiment. A [`rig::Rig`] prepares it and runs wall
//! hits in a [`simulation::Simulation`]; [`walk`] follows the boundary of the stable walls;
//! [`sweep`] compares cutoffs. [`controller::Fixed`] is the core, [`twin::Twin`] the same
//! controller in `f64`, to show what fixed point costs.
#![forbid(unsafe_code)]

pub mod batch;
pub mod cli;
pub mod compare;
pub mod controller;
pub mod element;
pub mod envelope;
pub mod error;
pub mod exact;
pub mod figure;
pub mod identify;
pub mod integrator;
pub mod linear;
pub mod manifest;
pub mod output;
pub mod overview;
pub mod plant;
pub mod report;
pub mod rig;
pub mod scene;
pub mod sensing;
pub mod sensitivity;
pub mod simulation;
pub mod statistics;
pub mod study;
pub mod sweep;
pub mod telemetry;
pub mod trace;
pub mod trade;
pub mod twin;
pub mod velocity;
pub mod walk;
