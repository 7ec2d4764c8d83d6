//! Many wall hits side by side, a lane of a vector each, bit for bit as the scalar loop runs them.
//!
//! # What a lane is
//! A lane holds one hit: plant, encoder, controller, commands on their way, the window's sums. All lanes of a
//! batch share the scene and the clock (outputs are due in the same samples); filter, K, B and start differ
//! from lane to lane. A lane whose hit is over takes the next hit at the next output; a walk keeps its lane to
//! its end, so lanes hold different walks. `f64` lanes do the very operations of the scalar loop in the same
//! order (nothing is contracted), fixed-point lanes the same integers.
//!
//! # One arithmetic or two
//! The core's own functions, called per lane in a loop over arrays, are not vectorised by the compiler (8.6 ns a sample
//! with AVX-512 enabled, as slow as one lane at a time). So the hot stages are here: quantiser and difference, low-pass
//! (`estimator/low_pass.rs`, `float.rs`), wall, saturation, output code (`fixed.rs`), plant, sums. Where the core's text
//! of an estimator is generic over the [`Word`](zwidth::velocity::Word), the lanes run that text: `estimator/kalman.rs`.
//! Everything else (settings, gains, coefficients, verdicts, walks) is the core's. Random scenes hold the two together
//! (`tests.rs`), on every backend that the machine has.
//!
//! # Stages
//! Between two events (an output, an arriving command) the plant needs nothing of the controller. So a block of
//! up to 16 samples is taken stage by stage: the plant moves on, the positions become counts, the counts are
//! filtered. A whole sample waits for its own results some forty cycles; a stage waits ten, and two vectors side
//! by side fill them. Controllers are behind a trait object: one call for a block, and a machine has each of them
//! compiled once, not once for each plant.
//!
//! # What is taken
//! See [`lanes_for`]: linear plants (with amplifier, mode, arm), any latency, rounding, resolution and output
//! quantisation, the estimators of `estimator/mod.rs`. What is not taken runs in the scalar loop behind the same
//! interface. A hit that comes near the ends of the core's number ranges (more than
//! 2^14 counts in a sample, 2^29 counts from zero, half the filter's range, a window whose sum of squares reaches
//! 2^53) leaves its lane and is run anew by the scalar loop, which saturates and refuses as the core does. So
//! lanes are exact wherever their outcome is used.
//!
//! # When a hit ends
//! As in the scalar loop, for the RMS of counts: `unstable` is certain once the sum of squares about the mean exceeds what the limit
//! allows ([`Hit::certain_verdict`](zwidth::experiment::Hit::certain_verdict)), and is looked for every 512
//! samples; only [`Depth::Whole`] runs on for the RMS. Other criteria: [`crate::simulation::window`].

mod backend;
mod estimator;
mod fixed;
mod float;
mod gain;
mod lanes;
mod scheduler;
mod simd_ops;
mod stream;
mod work;

pub use backend::{Backend, Engine, lanes_for, run};
pub use stream::stream;
pub use work::{Depth, Outcome, Tally, Work};

#[cfg(test)]
mod tests;
