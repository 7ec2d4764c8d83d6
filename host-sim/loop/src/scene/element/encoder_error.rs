//! Encoder phase error: the error of interpolation between the lines of a scale, once and twice per cycle.
//!
//! ```text
//! reading = x + first sin(p) + second sin(2 p),   p = 2 pi x / cycle + phase
//! ```
//! An offset of the encoder's two signals causes an error once per cycle. An error twice per cycle has two possible
//! causes: unequal amplitudes, or a phase other than 90 degrees between the signals. The reading is then quantised.
//!
//! The two sines are the first two terms of the error's Fourier series. The arctangent has no other terms of first
//! order.

use core::f64::consts::TAU;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Checker;

/// Periodic error of the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EncoderError {
    /// Travel per cycle of the signals.
    pub cycle_m: f64,
    /// Amplitude of the error with one period per cycle.
    pub first_m: f64,
    /// Amplitude of the error with two periods per cycle.
    pub second_m: f64,
    /// Phase at position 0.
    pub phase_rad: f64,
}

impl EncoderError {
    #[inline]
    pub fn error_m(&self, position_m: f64) -> f64 {
        let phase = TAU * position_m / self.cycle_m + self.phase_rad;
        self.first_m * libm::sin(phase) + self.second_m * libm::sin(2.0 * phase)
    }

    /// Relative error of a speed: the derivative of the error with respect to the position.
    pub fn slope(&self, position_m: f64) -> f64 {
        let phase = TAU * position_m / self.cycle_m + self.phase_rad;
        let sum = self.first_m * libm::cos(phase) + 2.0 * self.second_m * libm::cos(2.0 * phase);
        TAU / self.cycle_m * sum
    }

    pub fn check(&self) -> Result<(), String> {
        let keys = Checker("encoder_error");
        keys.within("cycle_m", self.cycle_m, 1e-8..=1.0)?;
        keys.within("first_m", self.first_m, 0.0..=self.cycle_m)?;
        keys.within("second_m", self.second_m, 0.0..=self.cycle_m)?;
        keys.within("phase_rad", self.phase_rad, -TAU..=TAU)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_is_that_of_the_error() {
        let error = EncoderError { cycle_m: 2e-5, first_m: 3e-7, second_m: 1e-7, phase_rad: 0.4 };
        for x in (0..50).map(|n| f64::from(n) * 1e-6) {
            let difference = (error.error_m(x + 1e-9) - error.error_m(x - 1e-9)) / 2e-9;
            assert!((difference - error.slope(x)).abs() < 1e-6, "{x}");
        }
    }

    #[test]
    fn repeats_with_the_cycle_and_has_its_amplitudes() {
        let error = EncoderError { cycle_m: 2e-5, first_m: 3e-7, second_m: 1e-7, phase_rad: 0.4 };
        let at: Vec<f64> = (0..1000).map(|i| error.error_m(f64::from(i) * 2e-8)).collect();
        assert!((error.error_m(3e-6) - error.error_m(3e-6 + 7.0 * 2e-5)).abs() < 1e-18);
        let harmonic = |order: f64| {
            let part = |shift: f64| {
                let sum: f64 = (0..1000)
                    .zip(&at)
                    .map(|(i, e)| e * (TAU * order * f64::from(i) / 1000.0 + shift).sin())
                    .sum();
                sum / 500.0
            };
            part(0.0).hypot(part(0.25 * TAU))
        };
        for (order, amplitude) in [(1.0, 3e-7), (2.0, 1e-7), (3.0, 0.0)] {
            assert!((harmonic(order) - amplitude).abs() < 1e-18, "{order}: {}", harmonic(order));
        }
    }
}
