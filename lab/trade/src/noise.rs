//! Difference between the outputs of a filter and of the exact filter for the same counts. Wrong coefficients, rounding
//! and dead zones all contribute to this difference.

use filter_forms::Filter;

use super::{Bench, larger, reference::Reference};

/// Speed of the ramp, in counts per sample. The number is no simple fraction, as with the speed of a real hand.
pub const RAMP_COUNTS: f64 = 0.123_606_797_749_978_97;
/// Smallest number of samples of a measurement. It also has at least `PERIODS` periods of the cutoff.
const SAMPLES_MIN: u32 = 100_000;
const PERIODS: f64 = 8.0;

/// Motions for one cutoff, each with the output of the exact filter. All variants use the same motions.
#[derive(Clone, Debug)]
pub struct Motions {
    /// The differences of the count, and the exact filter's outputs in counts per sample.
    rest: (Vec<i8>, Vec<f64>),
    ramp: (Vec<i8>, Vec<f64>),
    /// RMS that the encoder causes in the exact output, in counts per sample. At rest it comes from the flicker of the
    /// count, in motion from the steps of the count.
    pub encoder: Noise,
}

/// RMS of a noise at rest and in motion, in counts per sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// RMS while the count flickers between two values.
    pub at_rest: f64,
    /// RMS while the count follows a ramp.
    pub in_motion: f64,
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    (sum / f64::max(count, 1.0)).sqrt()
}

impl Motions {
    pub fn new(bench: &Bench, cutoff_hz: f64) -> Self {
        let samples = bench.samples(PERIODS, cutoff_hz).max(SAMPLES_MIN);
        let mut state = 0x2545_f491_4f6c_dd1du64;
        let mut before = 0i8;
        let rest: Vec<i8> = (0..samples)
            .map(|_| {
                // xorshift64 (Marsaglia 2003): the same flicker in every run and on every machine.
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                let count = i8::from(state >> 40 & 1 == 1);
                count - std::mem::replace(&mut before, count)
            })
            .collect();
        let place = |n: u32| (RAMP_COUNTS * f64::from(n)).floor();
        #[expect(clippy::cast_possible_truncation, reason = "0 or 1")]
        let ramp: Vec<i8> = (0..samples).map(|n| (place(n + 1) - place(n)) as i8).collect();
        let exactly = |moved: &[i8]| -> Vec<f64> {
            let mut reference = Reference::new(cutoff_hz, bench.rate_hz);
            moved.iter().map(|&x| reference.step(x.into())).collect()
        };
        let (rest_out, ramp_out) = (exactly(&rest), exactly(&ramp));
        let settled = ramp_out.len() / 2; // at least four periods of the cutoff
        let encoder = Noise {
            at_rest: rms(rest_out[settled..].iter().copied()),
            in_motion: rms(ramp_out[settled..].iter().map(|v| v - RAMP_COUNTS)),
        };
        Self { rest: (rest, rest_out), ramp: (ramp, ramp_out), encoder }
    }

    /// Measures a filter that is at rest at the start.
    pub fn measure(&self, filter: &Filter) -> Noise {
        let distance = |(moved, exact): &(Vec<i8>, Vec<f64>)| {
            let mut filter = *filter;
            let mut sum = 0.0;
            let samples = u32::try_from(moved.len()).unwrap_or(u32::MAX);
            filter.run(
                samples,
                |n| i32::from(moved[n as usize]) << 16,
                |n, out| sum += (out - exact[n as usize]).powi(2),
            );
            larger(0.0, (sum / f64::from(samples)).sqrt())
        };
        Noise { at_rest: distance(&self.rest), in_motion: distance(&self.ramp) }
    }
}
