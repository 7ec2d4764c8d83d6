//! Many wall hits side by side, one hit in each lane of a vector. Results equal the scalar loop's bit for bit.
//!
//! # What a lane is
//! A lane holds one hit: plant, encoder, controller, commands that have not taken effect yet, and the window's sums.
//! All lanes of a batch share the scene and the clock, so outputs are due in the same samples. Filter, K, B and start
//! position differ from lane to lane. A lane whose hit is over takes the next hit at the next output. A lane runs one
//! walk to its end. `f64` lanes use the operations of the scalar loop in the same order, without contraction.
//! Fixed-point lanes use the same integers.
//!
//! # What is written again
//! The compiler does not vectorise the core's own functions, called per lane in a loop over arrays. They take 8.6 ns
//! a sample with AVX-512 enabled, as slow as one lane at a time. So the stages that take most of the time are written
//! again here: quantiser and difference, low-pass (`estimator/low_pass.rs`, `float.rs`), wall, saturation, output
//! code (`fixed.rs`), plant, sums. Some estimators of the core are generic over the [`Word`](zwidth::velocity::Word),
//! and the lanes run them: `estimator/kalman.rs`. Everything else (settings, gains, coefficients, verdicts, walks) is
//! the core's. Tests with random scenes compare both (`tests.rs`), on every backend of the machine.
//!
//! # Stages
//! Between two events (an output, an arriving command) the plant does not depend on the controller. So a block of up
//! to 16 samples is computed stage by stage: the plant moves, the positions become counts, the counts are filtered. A
//! sample on its own waits about forty cycles for its results. A stage waits ten cycles, which a second vector fills.
//! Controllers are behind a trait object: it is called once per block, and each controller is compiled once per
//! backend, not once per plant.
//!
//! # What runs in lanes
//! See [`lanes_for`]: linear plants (with amplifier, mode, arm), any latency, rounding, resolution and output
//! quantisation, the estimators of `estimator/mod.rs`. Everything else runs in the scalar loop behind the same
//! interface.
//!
//! A hit can come near the ends of the core's number ranges: more than 2^14 counts in a sample, 2^29 counts from
//! zero, half the filter's range, or a window whose sum of squares reaches 2^53. Such a hit leaves its lane, and the
//! scalar loop runs it again, with saturation and errors as in the core. So every outcome that is taken from lanes is
//! exact.
//!
//! # When a hit ends
//! The same as in the scalar loop, for the RMS of counts. `unstable` is certain once the sum of squares about the
//! mean exceeds what the limit allows ([`Hit::certain_verdict`](zwidth::experiment::Hit::certain_verdict)). This is
//! checked every 512 samples. Only [`Depth::Whole`] continues, for the RMS. Other criteria:
//! [`crate::simulation::window`].

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
