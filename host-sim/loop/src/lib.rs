//! The sampled loop: what a device does under the control core that the firmware runs, for one wall hit or for many
//! side by side.
//!
//! Each layer uses those below it only:
//!
//! | layer | holds |
//! |-------|-------|
//! | [`engine`] | many wall hits, by the core itself or side by side in vector lanes |
//! | [`simulation`] | the sampled loop: plant, encoder, controller, latency |
//! | [`plant`] | the device over one sample |
//! | [`scene`] | scene files: devices, elements, experiments, and what they may hold |
//! | [`numerics`] | mathematics that knows no device |
//! | [`input`], [`interrupt`], [`error`] | reading files, Ctrl-C, what can go wrong |
#![forbid(unsafe_code)]

pub mod engine;
pub mod error;
pub mod input;
pub mod interrupt;
pub mod notation;
pub mod numerics;
pub mod plant;
pub mod range;
pub mod scene;
pub mod simulation;

#[cfg(test)]
#[path = "../../../tests/figure.rs"]
mod figure;
