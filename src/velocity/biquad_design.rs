//! Designs a biquad that follows the finite difference, from physical quantities. It has two poles and two zeros. The
//! first zero follows from the lead that the velocity must have.
//!
//! ```text
//! poles        p = exp(-w zeta +- w sqrt(zeta^2 - 1)),   w = 2 pi frequency / rate     matched: of s^2 + 2 zeta w s + w^2
//! denominator  1 + a1 z^-1 + a2 z^-2,   S = 1 + a1 + a2 = (1 - p)(1 - p')
//! numerator    S (1 + g (1 - z^-1)) (1 + h (1 - z^-1)),   h = zero / (1 - zero)
//! lead         g + h - P - 1/2 samples,   P = p / (1 - p) + p' / (1 - p') = -(a1 + 2 a2) / S
//! ```
//!
//! A slow motion leads by `g` and `h` samples, and lags by the poles' `P` and the difference's 1/2. With `lead = 0` the
//! velocity is the velocity at the sample itself. The second zero is at `zero` in the z plane. At -1 it suppresses half
//! the sample rate, as both zeros of a Butterworth low-pass do. At 0 it has no effect. Above 0 it gives a lead, like
//! the first zero.
//!
//! A cascade has two biquads. The input of the second biquad is a velocity, not a difference. So its lead does not
//! contain the half sample.
//!
//! **Accepted values.** The first zero may be at -1 or above. The magnitudes of the coefficients add up to less than 4,
//! so that no sum overflows for any counts. This condition limits the lead if the frequency is low.

use core::ops::RangeInclusive;

use super::{Cascade, biquad::Biquad};
use crate::range::{SettingsError, within};

/// Lowest and highest accepted frequency of the poles, as a fraction of the sample rate. At the lowest frequency, `S`
/// has 51 LSB of 2^-30.
pub const FREQUENCY: RangeInclusive<f64> = 3.5e-5..=0.2;
/// Accepted damping ratios of the poles.
pub const DAMPING: RangeInclusive<f64> = 0.02..=4.0;
/// Allowed range of the second zero. If the coefficients would become too large, the upper end is lower.
const ZERO: [f64; 2] = [-1.0, 0.98];
/// The lowest allowed `g`. It puts the first zero at -1.
const LEAST: f64 = -0.5;
/// The largest sum of the coefficients' magnitudes.
const SUM: f64 = 3.999;
/// The largest magnitude of a coefficient.
const COEFFICIENT: f64 = 1.999;
/// Below this frequency of the poles, as a fraction of the sample rate, second-order error feedback leaves less noise
/// than first-order error feedback. The limit is that of the Butterworth low-pass.
const SECOND_ORDER_BELOW: f64 = 0.064;

/// A biquad in floating point, normalised to `a0 = 1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiquadDesign {
    /// Numerator `b0 + b1 z^-1 + b2 z^-2`.
    pub b: [f64; 3],
    /// Denominator `1 + a1 z^-1 + a2 z^-2`.
    pub a: [f64; 2],
    /// Sum of the numerator's coefficients. It equals `1 + a1 + a2`, but is computed without cancellation.
    dc_sum: f64,
    frequency_per_rate: f64,
}

impl BiquadDesign {
    /// Designs the biquad with poles of this frequency and damping, with this lead at low frequencies, and with this
    /// second zero.
    ///
    /// # Errors
    /// Names the parameter that is out of range. The range of the zero follows from the poles. The range of the lead
    /// follows from all other parameters.
    pub fn new(
        frequency_hz: f64,
        damping: f64,
        lead_s: f64,
        zero: f64,
        rate_hz: f64,
    ) -> Result<Self, SettingsError> {
        // The finite difference before the biquad lags by half a sample.
        Self::section(frequency_hz, damping, lead_s, zero, rate_hz, 0.5)
    }

    /// Like [`new`](Self::new), but for a biquad whose input is late by `late` samples. The lead includes this delay.
    fn section(
        frequency_hz: f64,
        damping: f64,
        lead_s: f64,
        zero: f64,
        rate_hz: f64,
        late: f64,
    ) -> Result<Self, SettingsError> {
        let range = FREQUENCY.start() * rate_hz..=FREQUENCY.end() * rate_hz;
        within("frequency_hz", frequency_hz, range)?;
        within("damping", damping, DAMPING)?;
        let frequency_per_rate = frequency_hz / rate_hz;
        let [less, product] = poles(2.0 * core::f64::consts::PI * frequency_per_rate, damping);
        let a = [less - 1.0 - product, product];
        let own = Self { b: [0.0; 3], a, dc_sum: less, frequency_per_rate };
        // With the first zero at -1 the numerator's magnitudes add up to S / (1 - zero), or to S for a second zero
        // below 0.
        let room = SUM - a[0].abs() - a[1].abs();
        within("zero", zero, ZERO[0]..=ZERO[1].min(1.0 - less / room))?;
        let h = zero / (1.0 - zero);
        let delay = late - (a[0] + 2.0 * a[1]) / less;
        let lead_of = |g: f64| (g + h - delay) / rate_hz;
        let most = own.most(h);
        within("lead_s", lead_s, lead_of(LEAST)..=lead_of(most))?;
        Ok(own.with_zeros((lead_s * rate_hz + delay - h).max(LEAST).min(most), h))
    }

    /// The lowest frequency at which the gain is at -3 dB, in Hz. `None` if the gain is above -3 dB up to half the sample
    /// rate.
    ///
    /// With `x = 1 - cos w`, the square of each polynomial's magnitude is quadratic in `x`. The gain is at -3 dB where
    /// twice the numerator's square equals the denominator's.
    pub fn half_power_hz(&self, rate_hz: f64) -> Option<f64> {
        let square = |[c0, c1, c2]: [f64; 3]| {
            let sum = self.dc_sum; // of both polynomials
            [sum * sum, -2.0 * (c1 * (c0 + c2) + 4.0 * c0 * c2), 4.0 * c0 * c2]
        };
        let (n, d) = (square(self.b), square([1.0, self.a[0], self.a[1]]));
        let [p0, p1, p2] = [0, 1, 2].map(|power| 2.0 * n[power] - d[power]);
        let root = libm::sqrt((p1 * p1 - 4.0 * p0 * p2).max(0.0));
        let q = -0.5 * (p1 + if p1 < 0.0 { -root } else { root });
        let in_range = |x: &f64| (0.0..=2.0).contains(x);
        let real = p1 * p1 >= 4.0 * p0 * p2;
        let x = [q / p2, p0 / q].into_iter().filter(|_| real).filter(in_range).reduce(f64::min)?;
        Some(rate_hz / core::f64::consts::PI * libm::asin(libm::sqrt(0.5 * x)))
    }

    fn with_zeros(self, g: f64, h: f64) -> Self {
        let s = self.dc_sum;
        let b = [s * (1.0 + g) * (1.0 + h), -s * (g + h + 2.0 * g * h), s * g * h];
        Self { b, ..self }
    }

    /// Returns the largest `g` with which the coefficients stay within their limits.
    fn most(&self, h: f64) -> f64 {
        let fits = |g: f64| {
            let Self { b: [b0, b1, b2], a: [a1, a2], .. } = self.with_zeros(g, h);
            let largest = b0.abs().max(b1.abs()).max(b2.abs());
            b0.abs() + b1.abs() + b2.abs() + a1.abs() + a2.abs() < SUM && largest < COEFFICIENT
        };
        let (mut good, mut bad) = (LEAST, 1e9);
        for _ in 0..80 {
            let middle = 0.5 * (good + bad);
            if fits(middle) { good = middle } else { bad = middle }
        }
        good
    }

    /// Returns the coefficients in LSB of 2^-30, with a DC gain of exactly one. The rounding error is at most two LSB
    /// for `b1`, and at most one LSB for every other coefficient.
    pub fn quantise(&self) -> Biquad {
        let one = 1i32 << Biquad::FRACTION_BITS;
        #[expect(clippy::cast_possible_truncation, reason = "below 2 in magnitude, so below 2^31")]
        let to_bits = |value: f64| libm::round(value * f64::from(one)) as i32;
        let [b0, _, b2] = self.b.map(to_bits);
        let (a2, dc_sum) = (to_bits(self.a[1]), to_bits(self.dc_sum));
        // Both are within i32, because their values are below 2. An intermediate sum may be outside i32.
        let a1 = dc_sum.wrapping_sub(one).wrapping_sub(a2);
        let b1 = dc_sum.wrapping_sub(b0).wrapping_sub(b2);
        Biquad::new([b0, b1, b2], [a1, a2], self.frequency_per_rate < SECOND_ORDER_BELOW)
    }
}

/// Two biquads in series. The lead of the cascade is the sum of both leads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CascadeDesign {
    /// The sections in their order.
    pub sections: [BiquadDesign; 2],
}

impl CascadeDesign {
    /// Designs a cascade of two sections. Each section is given by frequency, damping, lead in s, and second zero. The
    /// first frequency is in Hz. The second is a multiple of the first.
    ///
    /// # Errors
    /// Names the parameter that is out of range.
    pub fn new(first: [f64; 4], second: [f64; 4], rate_hz: f64) -> Result<Self, SettingsError> {
        let [frequency_hz, damping, lead_s, zero] = first;
        let first = BiquadDesign::new(frequency_hz, damping, lead_s, zero, rate_hz)?;
        let [ratio, damping, lead_s, zero] = second;
        let [low, high] = [FREQUENCY.start(), FREQUENCY.end()].map(|part| part * rate_hz);
        within("second_ratio", ratio, low / frequency_hz..=high / frequency_hz)?;
        let hz = (ratio * frequency_hz).max(low).min(high);
        let second = BiquadDesign::section(hz, damping, lead_s, zero, rate_hz, 0.0);
        let second = second.map_err(|error| SettingsError {
            parameter: match error.parameter {
                "damping" => "second_damping",
                "lead_s" => "second_lead_s",
                "zero" => "second_zero",
                other => other,
            },
            ..error
        })?;
        Ok(Self { sections: [first, second] })
    }

    /// Quantises both sections. Each has a DC gain of exactly one.
    pub fn quantise(&self) -> Cascade {
        let [first, second] = &self.sections;
        Cascade { sections: [first.quantise(), second.quantise()] }
    }
}

/// Returns `(1 - p)(1 - p')` and `p p'` for the two poles.
fn poles(w: f64, damping: f64) -> [f64; 2] {
    let decay = libm::exp(-damping * w);
    let lost = -libm::expm1(-damping * w);
    let square = damping * damping - 1.0;
    let less = if square < 0.0 {
        // |1 - r e^(j t)|^2 = (1 - r)^2 + 4 r sin^2(t / 2)
        let sine = libm::sin(0.5 * w * libm::sqrt(-square));
        lost * lost + 4.0 * decay * sine * sine
    } else {
        let apart = w * libm::sqrt(square);
        libm::expm1(-damping * w + apart) * libm::expm1(-damping * w - apart)
    };
    [less, decay * decay]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::velocity::VelocitySettings;
    use std::vec::Vec;

    const RATE_HZ: f64 = 1e4;

    /// Returns the range that a refusal states.
    fn range(result: Result<BiquadDesign, SettingsError>, key: &str) -> [f64; 2] {
        let error = result.unwrap_err();
        assert_eq!(error.parameter, key);
        [*error.range.start(), *error.range.end()]
    }

    /// Designs over the whole accepted range.
    fn designs() -> Vec<BiquadDesign> {
        let mut all = Vec::new();
        for frequency_hz in [0.35, 2.0, 30.0, 150.0, 430.0, 900.0, 2000.0] {
            for damping in [0.02, 0.1, 0.5, 0.999_999, 1.0, 1.3, 4.0] {
                let of =
                    |lead_s, zero| BiquadDesign::new(frequency_hz, damping, lead_s, zero, RATE_HZ);
                let [low, high] = range(of(0.0, -2.0), "zero");
                for zero in [low, -0.3, 0.0, 0.5 * high, high] {
                    let [low, high] = range(of(f64::NAN, zero), "lead_s");
                    for part in [0.0, 0.01, 0.3, 1.0] {
                        all.push(of((low + part * (high - low)).min(high), zero).unwrap());
                    }
                }
            }
        }
        all
    }

    #[test]
    fn every_accepted_one_is_stable_and_has_room_in_the_sum_and_a_gain_of_exactly_one() {
        let mut widest = 0.0f64;
        for design in designs() {
            let biquad = design.quantise();
            let [b0, b1, b2, a1, a2] = biquad.bits().map(i64::from);
            let one = 1i64 << Biquad::FRACTION_BITS;
            assert_eq!(b0 + b1 + b2, one + a1 + a2, "{design:?}");
            // The filter is stable if `a1` and `a2` lie in this triangle.
            assert!(a2 < one && a1 < one + a2 && -a1 < one + a2, "{design:?}");
            let all = [b0, b1, b2, a1, a2].map(i64::abs).into_iter().sum::<i64>();
            assert!(all < 4 * one, "{design:?}");
            widest = widest.max(all as f64 / one as f64);
            let exact = design.b.into_iter().chain(design.a);
            for (bits, exact) in biquad.bits().into_iter().zip(exact) {
                let off = f64::from(bits) - exact * one as f64;
                assert!(off.abs() <= 2.0, "{design:?}: {off} LSB");
            }
        }
        assert!(widest > 3.99, "{widest}");
    }

    #[test]
    fn at_the_half_power_frequency_the_gain_is_at_minus_3_db_and_not_before() {
        let mut crossing = 0;
        for design in designs() {
            let square = |[c0, c1, c2]: [f64; 3], hz: f64| {
                let w = 2.0 * core::f64::consts::PI * hz / RATE_HZ;
                let re = c0 + c1 * libm::cos(w) + c2 * libm::cos(2.0 * w);
                let im = c1 * libm::sin(w) + c2 * libm::sin(2.0 * w);
                re * re + im * im
            };
            let [a1, a2] = design.a;
            let gain = |hz| square(design.b, hz) / square([1.0, a1, a2], hz);
            let end = design.half_power_hz(RATE_HZ);
            crossing += u32::from(end.is_some());
            if let Some(hz) = end {
                assert!((gain(hz) - 0.5).abs() < 1e-3, "{design:?}: {} at {hz}", gain(hz));
            }
            let end = end.unwrap_or(0.5 * RATE_HZ);
            for part in 1..500 {
                let hz = end * f64::from(part) / 500.0;
                assert!(gain(hz) > 0.499, "{design:?}: {} at {hz} before {end}", gain(hz));
            }
        }
        assert!(crossing > 100, "{crossing}");
    }

    /// Poles and second zero are compared with the roots of the polynomials. The delay is the mean time of the impulse
    /// response, weighted by its values.
    #[test]
    fn poles_zeros_and_lead_are_where_they_were_asked_for() {
        for (f, damping, lead_s, zero) in [
            (430.0, 0.04, 3e-4, -0.97),
            (560.0, 1.0, 1e-4, -0.7),
            (400.0, 1.5, -1e-4, 0.3),
            (700.0, 0.25, 0.0, 0.0),
        ] {
            let BiquadDesign { b: [b0, b1, b2], a: [a1, a2], .. } =
                BiquadDesign::new(f, damping, lead_s, zero, RATE_HZ).unwrap();
            let w = 2.0 * core::f64::consts::PI * f / RATE_HZ;
            assert!((a2 - (-2.0 * damping * w).exp()).abs() < 1e-12);
            let sum = match damping < 1.0 {
                true => 2.0 * (-damping * w).exp() * (w * (1.0 - damping * damping).sqrt()).cos(),
                false => {
                    let apart = w * (damping * damping - 1.0).sqrt();
                    (-damping * w + apart).exp() + (-damping * w - apart).exp()
                }
            };
            assert!((a1 + sum).abs() < 1e-12, "{a1} {sum}");
            assert!((b0 * zero * zero + b1 * zero + b2).abs() < 1e-12);
            // The delay is computed from the derivatives of ln N and ln A at z^-1 = 1. The difference adds half a
            // sample.
            let s = b0 + b1 + b2;
            let delay = 0.5 + ((b1 + 2.0 * b2) - (a1 + 2.0 * a2)) / s;
            assert!((delay / RATE_HZ + lead_s).abs() < 1e-12, "{delay}");
        }
    }

    #[test]
    fn a_butterworth_low_pass_is_nearly_one_of_them() {
        let design = crate::design::tests::DESIGN;
        let low_pass = VelocitySettings::Butterworth { cutoff_hz: 100.0 }.build(&design).unwrap();
        let crate::velocity::Estimator::LowPass(low_pass) = low_pass else { panic!() };
        let delay = 0.5 + core::f64::consts::SQRT_2 * RATE_HZ / (200.0 * core::f64::consts::PI);
        let same =
            BiquadDesign::new(100.0, 0.5f64.sqrt(), -delay / RATE_HZ, -1.0, RATE_HZ).unwrap();
        for (ours, theirs) in same.quantise().bits().into_iter().zip(low_pass.bits()) {
            assert!((ours - theirs).abs() < 1 << 17, "{ours} {theirs}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_range() {
        let of = |f, damping, lead_s, zero| BiquadDesign::new(f, damping, lead_s, zero, RATE_HZ);
        assert_eq!(range(of(0.1, 0.5, 0.0, 0.0), "frequency_hz"), [0.35, 2000.0]);
        assert_eq!(range(of(f64::NAN, 0.5, 0.0, 0.0), "frequency_hz"), [0.35, 2000.0]);
        assert_eq!(range(of(500.0, 5.0, 0.0, 0.0), "damping"), [0.02, 4.0]);
        let [low, high] = range(of(500.0, 0.5, 1.0, 0.0), "lead_s");
        assert!(low < -1e-4 && high > 3e-4 && high < 1e-3, "{low} {high}");
        // A lower frequency of the poles allows a larger lead.
        let [_, slower] = range(of(100.0, 0.5, 1.0, 0.0), "lead_s");
        assert!(slower > high);
        let [_, high] = range(of(2000.0, 0.02, 0.0, 1.0), "zero");
        assert!((0.1..0.9).contains(&high), "{high}");
    }
}
