//! Many wall hits side by side, one in each lane of a vector. The results are the same as in the scalar loop, bit for
//! bit.
//!
//! # What a lane is
//! A lane contains one hit: plant, encoder, controller, commands that have not taken effect yet, and sums of the
//! window. All lanes of a batch share the scene and the time, so outputs are due in the same samples. Filter, K, B and
//! start position differ from lane to lane. A lane whose hit is over gets the next hit at the next output. One lane
//! runs all hits of a walk. `f64` lanes use the operations of the scalar loop in the same order, without contraction.
//! Fixed-point lanes use the same integers.
//!
//! # What is written again
//! If a loop over arrays calls the core's own functions once per lane, the compiler does not vectorise them. In such a
//! loop the functions take 8.6 ns per sample with AVX-512 enabled. This is as long as one lane at a time takes. So the
//! slowest stages are written again here:
//! - quantiser, difference, plant and sums;
//! - low-pass (`estimator/low_pass.rs`, `float.rs`);
//! - wall, saturation and output code (`fixed.rs`).
//!
//! Some estimators of the core are generic over the [`Word`](zwidth::velocity::Word). For these estimators, lanes run
//! the core's own code: see `estimator/kalman.rs`. The core's own code also computes settings, gains, coefficients,
//! verdicts and walks. Tests with random scenes compare lanes and scalar loop (`tests.rs`), on every backend of the
//! machine.
//!
//! # Stages
//! Between two events (an output, an arriving command) the plant does not depend on the controller. So a block of up to
//! 16 samples is computed stage by stage: the plant moves, the positions become counts, the counts are filtered. A
//! sample that is computed alone waits about forty cycles for its results. A stage waits only ten cycles, and the
//! processor uses these cycles for a second vector. The controller is a trait object, which is called once per block.
//! So controllers are compiled once per backend.
//!
//! # What runs in lanes
//! See [`lanes_for`]: linear plants (with amplifier, mode, arm), any latency, rounding, resolution and output
//! quantisation, and the estimators of `estimator/mod.rs`. All other hits run in the scalar loop.
//!
//! A hit can come near the ends of the core's number ranges:
//! - more than 2^14 counts in a sample;
//! - 2^29 counts from zero;
//! - half the filter's range;
//! - a sum of squares of 2^53 in the window.
//!
//! A hit near one of these ends is taken out of its lane. The scalar loop runs this hit again, with saturation and
//! errors as in the core. So every outcome from a lane is exact.
//!
//! # When a hit ends
//! A hit ends as in the scalar loop. If the criterion is the RMS of counts, `unstable` is certain once the sum of
//! squares about the mean exceeds the limit ([`Hit::certain_verdict`](zwidth::experiment::Hit::certain_verdict)). The
//! sum is checked every 512 samples. A hit that is certain to be unstable ends, except with [`Depth::Whole`].
//! [`crate::simulation::window`] describes the other criteria.

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
