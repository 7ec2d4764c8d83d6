//! The measured frequency response of a running filter.

use std::f64::consts::{FRAC_1_SQRT_2, PI, SQRT_2};

use filter_forms::{Filter, Prototype};
use nalgebra::Complex;

use super::{Bench, LSB_PER_COUNT, larger, tone::Tone};

/// The measured frequencies, as multiples of the -3 dB frequency.
pub const PLACES: [f64; 6] = [0.25, 0.5, 0.7, 1.0, 1.4, 2.0];
/// The highest measured frequency, as a share of the sample rate.
pub const HIGHEST: f64 = 0.45;
/// Number of periods of the cutoff after which the transient of the exact filter is below 10^-15.
pub const SETTLE_PERIODS: f64 = 8.0;
/// Largest relative error of the gain of 0.707 in the search for the -3 dB frequency. With a larger error the search
/// has no result.
const FOUND: f64 = 1e-3;

/// The exact response at a frequency in cycles per sample.
pub fn exact(p: &Prototype, frequency: f64) -> Complex<f64> {
    let ratio = 2.0 * (PI * frequency).tan() / p.w;
    Complex::new(1.0 - ratio * ratio, SQRT_2 * ratio).inv()
}

/// The inputs for one cutoff. All variants use the same inputs.
#[derive(Clone, Debug)]
pub struct Tones {
    prototype: Prototype,
    settle: u32,
    amplitude: f64,
    tones: Vec<Tone>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Largest `abs(H - H_exact)` over the measured frequencies.
    pub error: f64,
    /// Relative error of the -3 dB frequency. `None` if no gain is near 0.707.
    pub cutoff_error: Option<f64>,
}

impl Tones {
    pub fn new(bench: &Bench, cutoff_hz: f64) -> Self {
        let prototype = Prototype::new(cutoff_hz, bench.rate_hz);
        let amplitude = 0.5 * bench.q15_full_scale_counts() * LSB_PER_COUNT;
        let frequencies = PLACES.map(|place| place * prototype.true_cutoff());
        let used = frequencies.into_iter().filter(|f| *f <= HIGHEST);
        let tones = used.map(|f| Tone::near(f, amplitude)).collect();
        let settle = bench.samples(SETTLE_PERIODS, cutoff_hz) + 200;
        Self { prototype, settle, amplitude, tones }
    }

    /// The response of `filter` to one tone. At the start the filter is at rest.
    pub fn response(&self, filter: &Filter, tone: &Tone) -> Complex<f64> {
        let mut filter = *filter;
        let mut sum = Complex::ZERO;
        filter.run(
            self.settle + tone.window(),
            |n| tone.input(n),
            |n, out| {
                if n >= self.settle {
                    sum += tone.phasor(n) * out;
                }
            },
        );
        tone.response(sum * LSB_PER_COUNT)
    }

    /// Measures a filter that is at rest at the start.
    pub fn measure(&self, filter: &Filter) -> Response {
        let errors = self.tones.iter().map(|tone| {
            (self.response(filter, tone) - exact(&self.prototype, tone.frequency)).norm()
        });
        Response { error: errors.fold(0.0, larger), cutoff_error: self.cutoff_error(filter) }
    }

    /// Searches the frequency with the gain 0.707. Each step assumes the response of a Butterworth filter.
    fn cutoff_error(&self, filter: &Filter) -> Option<f64> {
        let wanted = self.prototype.true_cutoff();
        let mut estimate = wanted;
        let mut off = f64::INFINITY;
        for _ in 0..4 {
            if !(1e-3 * wanted..HIGHEST.max(wanted) * 1.001).contains(&estimate) {
                return None;
            }
            let tone = Tone::near(estimate, self.amplitude);
            let gain = self.response(filter, &tone).norm();
            off = gain / FRAC_1_SQRT_2 - 1.0;
            if !(gain > 0.0 && gain < 1.0) {
                return None;
            }
            // 1 / gain^2 = 1 + (W / Wc)^4 at the analog frequency W = 2 tan(pi f)
            let analog = (PI * tone.frequency).tan();
            let ratio = (1.0 / (gain * gain) - 1.0).sqrt().sqrt();
            estimate = (analog / ratio).atan() / PI;
            if off.abs() < 1e-9 {
                break;
            }
        }
        (off.abs() < FOUND).then_some(estimate / wanted - 1.0)
    }
}
