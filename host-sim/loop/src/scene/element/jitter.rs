//! Sample jitter: the encoder is read late. The delay varies from sample to sample.
//!
//! Sample n is read at `n T + d`. The delay d has the values 0, peak/256, .., peak with equal probability. The
//! controller assumes a reading at n T. Commands are not delayed, because a timer sets the time of the output. So the
//! peak must not exceed the latency, and must be shorter than a sample.
//!
//! The 256 steps represent the ticks of the timer. Because the delays have fixed steps, the position is computed
//! exactly, from a table. The distribution is uniform because nothing more is known about the delay.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Chain, Checker, STATES_MAX};
use crate::numerics::random;

/// Number of possible delays above 0.
const LEVELS: u64 = 256;
/// A number that is mixed into the seed. It makes the random delays independent of the encoder noise.
const STREAM: u64 = 0x6a69_7474_6572;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Jitter {
    /// Largest delay of a reading, at most the latency and below a sample. The delays are uniform over 257 values.
    pub peak_s: f64,
    /// Seed of the random numbers.
    pub seed: u32,
}

/// Weights that give the position after a delay within a sample. The position is a weighted sum of the state at the
/// sample's beginning and the forces before and after the split.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glimpse {
    state: [f64; STATES_MAX],
    before: f64,
    after: f64,
    /// Displacement that the hand's constant force causes, in m.
    hand_m: f64,
}

impl Glimpse {
    fn new(chain: &Chain, delay_s: f64, split_s: f64) -> Self {
        let (less, gamma) = chain.increment(delay_s);
        let mut state = [0.0; STATES_MAX];
        for (column, weight) in state[..gamma.len()].iter_mut().enumerate() {
            *weight = less[(0, column)] + if column == 0 { 1.0 } else { 0.0 };
        }
        let after = if delay_s > split_s { chain.increment(delay_s - split_s).1[0] } else { 0.0 };
        let hand_m = chain.hand_moves(delay_s)[0];
        Self { state, before: gamma[0] - after, after, hand_m }
    }

    /// Position after the delay, relative to the device's rest position, in m.
    #[inline]
    pub fn offset_m(&self, z: &[f64; STATES_MAX], before_n: f64, after_n: f64) -> f64 {
        let free: f64 = self.state.iter().zip(z).map(|(weight, value)| weight * value).sum();
        free + self.before * before_n + self.after * after_n + self.hand_m
    }
}

impl Jitter {
    /// Index of a sample's delay, from 0 to 256. Each `hit` number has its own delays.
    #[inline]
    pub fn level(&self, hit: u64, sample: u64) -> usize {
        let seed = hit ^ (u64::from(self.seed) << 32) ^ STREAM;
        (random::bits(seed, sample) % (LEVELS + 1)) as usize
    }

    /// The delay with this index, in s.
    #[inline]
    pub fn delay_s(&self, level: usize) -> f64 {
        self.peak_s * (level as f64 / LEVELS as f64)
    }

    /// The weights for each delay. A command takes effect `split_s` after the sample's beginning.
    pub fn glimpses(&self, chain: &Chain, split_s: f64) -> Vec<Glimpse> {
        let levels = usize::try_from(LEVELS).unwrap_or(0);
        (0..=levels).map(|level| Glimpse::new(chain, self.delay_s(level), split_s)).collect()
    }

    pub fn check(&self, latency_s: f64, sample_s: f64) -> Result<(), String> {
        let most = latency_s.min(sample_s.next_down());
        Checker("jitter").within("peak_s", self.peak_s, 0.0..=most)
    }
}
