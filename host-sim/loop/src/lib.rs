//! The sampled loop: a device's motion under the firmware's control core. The loop runs one wall hit, or many hits side
//! by side.
//!
//! Each layer uses only the layers below it:
//!
//! | layer | holds |
//! |-------|-------|
//! | [`engine`] | many wall hits, by the core itself or side by side in vector lanes |
//! | [`simulation`] | the sampled loop: plant, encoder, controller, latency |
//! | [`plant`] | the device over one sample |
//! | [`scene`] | scene files: devices, elements, experiments, and their allowed values |
//! | [`numerics`] | mathematics that is independent of the device |
//! | [`input`], [`interrupt`], [`error`] | reading files, Ctrl-C, errors |
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
