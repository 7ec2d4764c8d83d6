//! Encoder noise: a white Gaussian error of every reading, before quantisation.
//!
//! The noise is a function of seed, start of the hit and sample number. So the noise does not depend on the number of
//! threads. All walls of a comparison get the same noise. Each repeat of a sweep gets another noise.
//!
//! The model is the white measurement noise of Kalman filters. Quantisation is a separate step.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;
use crate::numerics::random;

/// White noise on the encoder's reading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EncoderNoise {
    /// Standard deviation of the noise.
    pub rms_m: f64,
    /// Seed of the random numbers.
    pub seed: u32,
}

impl EncoderNoise {
    /// Error of the reading at a sample, in m. Each `hit` number has its own noise.
    #[inline]
    pub fn error_m(&self, hit: u64, sample: u64) -> f64 {
        self.rms_m * random::gaussian(hit ^ (u64::from(self.seed) << 32), sample)
    }

    pub fn check(&self) -> Result<(), String> {
        Checker("encoder_noise").within("rms_m", self.rms_m, 0.0..=1.0)
    }
}
