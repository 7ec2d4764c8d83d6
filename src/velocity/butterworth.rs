//! Designs and quantises low-passes of first and second order. The Butterworth low-pass is the paper's equation (2),
//! with the exact `2 sqrt(2)` in place of the printed 2.8.
//!
//! ```text
//! H(s) = wc^2 / (s^2 + sqrt(2) wc s + wc^2),   s = (2/T) (z - 1)/(z + 1)      bilinear
//! w  = wc T (not pre-warped)  or  2 tan(wc T / 2) (pre-warped)
//! a0 = 4 + 2 sqrt(2) w + w^2          sqrt(2) is 1/Q; other Q are other dampings
//! b0 = b2 = w^2 / a0,  b1 = 2 b0,  a1 = (2 w^2 - 8) / a0,  a2 = (4 - 2 sqrt(2) w + w^2) / a0
//! ```
//!
//! **Accepted cutoffs**: from [`CUTOFF_MIN`] to [`CUTOFF_MAX`] of the sample rate.
//!
//! | rate   | lowest cutoff | highest |
//! |--------|---------------|---------|
//! | 1 kHz  | 0.035 Hz      | 499 Hz  |
//! | 10 kHz | 0.35 Hz       | 4990 Hz |
//! | 50 kHz | 1.75 Hz       | 24950 Hz |
//!
//! At the lower end quantisation may change the -3 dB frequency by 1 %. This frequency is proportional to the DC sum
//! `S = 2^30 (1 + a1 + a2)`, which is `2^30 w^2` rounded to an integer. The damping stays, so the response tilts as
//! well as shifts. With `S >= 51` the relative error `1 / (2 S)` is below 1 %.
//!
//! Pre-warping reaches half the rate only in a limit in which the coefficients add up to 8. Such a sum would overflow
//! the accumulator. So pre-warped cutoffs end at [`PREWARPED_MAX`] of the rate.

use core::{f64::consts::SQRT_2, ops::RangeInclusive};

use super::biquad::Biquad;
use crate::range::{SettingsError, within};

/// Lowest accepted cutoff, as a fraction of the sample rate.
pub const CUTOFF_MIN: f64 = 3.5e-5;
/// Highest accepted cutoff without pre-warping, as a fraction of the sample rate.
pub const CUTOFF_MAX: f64 = 0.499;
/// Highest accepted cutoff with pre-warping, as a fraction of the sample rate.
pub const PREWARPED_MAX: f64 = 0.38;
/// Accepted quality factors. Up to the highest quality factor, the magnitudes of the coefficients add up to less than 4
/// at every cutoff.
pub const QUALITY: RangeInclusive<f64> = 0.3..=2.0;
/// Below this cutoff, as a fraction of the sample rate, second-order error feedback leaves less noise than first-order
/// error feedback. The exact limit is 0.0655. At the limit both leave 0.36 LSB RMS. This follows from the squared
/// impulse responses of `(1 - z^-1)^k / A(z)`.
const SECOND_ORDER_BELOW: f64 = 0.064;

/// Frequency at which the unquantised digital filter is at -3 dB, in Hz.
///
/// The bilinear transform maps the analog cutoff `fc` to `atan(pi fc T) / (pi T)`. With pre-warping the frequency is
/// `fc` itself.
pub fn true_cutoff_hz(cutoff_hz: f64, rate_hz: f64, prewarp: bool) -> f64 {
    if prewarp {
        cutoff_hz
    } else {
        let pi = core::f64::consts::PI;
        rate_hz / pi * libm::atan(pi * cutoff_hz / rate_hz)
    }
}

/// The same for [`ButterworthDesign::damped`]. The analog filter is at -3 dB at
/// `fc sqrt(d + sqrt(d^2 + 1))`, with `d = 1 - 1 / (2 Q^2)`.
pub fn damped_cutoff_hz(cutoff_hz: f64, quality: f64, rate_hz: f64) -> f64 {
    let d = 1.0 - 0.5 / (quality * quality);
    true_cutoff_hz(cutoff_hz * libm::sqrt(d + libm::sqrt(d * d + 1.0)), rate_hz, false)
}

/// Returns the `w` of the equations, which is `wc T`, or pre-warped `2 tan(wc T / 2)`.
fn digital_frequency(cutoff_hz: f64, rate_hz: f64, prewarp: bool) -> Result<f64, SettingsError> {
    let highest = if prewarp { PREWARPED_MAX } else { CUTOFF_MAX };
    within("cutoff_hz", cutoff_hz, CUTOFF_MIN * rate_hz..=highest * rate_hz)?;
    let angle = 2.0 * core::f64::consts::PI * cutoff_hz / rate_hz;
    Ok(if prewarp { prewarped(angle) } else { angle })
}

/// Pre-warps an angle. This function is not inlined, so that cutoffs without pre-warping do not need the stack of
/// `tan`.
#[inline(never)]
fn prewarped(angle: f64) -> f64 {
    2.0 * libm::tan(angle / 2.0)
}

/// Coefficients of the low-pass in floating point, normalised to `a0 = 1`. The others are `b1 = 2 b0` and `b2 = b0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ButterworthDesign {
    /// Gain of the numerator `b0 (1 + z^-1)^2`.
    pub b0: f64,
    /// Coefficient a1 of the denominator `1 + a1 z^-1 + a2 z^-2`.
    pub a1: f64,
    /// Coefficient a2 of the denominator `1 + a1 z^-1 + a2 z^-2`.
    pub a2: f64,
    cutoff_per_rate: f64,
}

impl ButterworthDesign {
    /// Designs the filter of equation (2) for this cutoff and sample rate, both in Hz.
    ///
    /// # Errors
    ///
    /// `cutoff_hz` is outside [`CUTOFF_MIN`] .. [`CUTOFF_MAX`] of the rate. With `prewarp` the upper end is
    /// [`PREWARPED_MAX`].
    pub fn new(cutoff_hz: f64, rate_hz: f64, prewarp: bool) -> Result<Self, SettingsError> {
        Ok(Self::of(digital_frequency(cutoff_hz, rate_hz, prewarp)?, SQRT_2, cutoff_hz / rate_hz))
    }

    /// Like [`new`](Self::new), but with any quality factor, and without pre-warping.
    ///
    /// # Errors
    /// `cutoff_hz` is out of range as in [`new`](Self::new), or `quality` is outside [`QUALITY`].
    pub fn damped(cutoff_hz: f64, quality: f64, rate_hz: f64) -> Result<Self, SettingsError> {
        within("quality", quality, QUALITY)?;
        let w = digital_frequency(cutoff_hz, rate_hz, false)?;
        Ok(Self::of(w, 1.0 / quality, cutoff_hz / rate_hz))
    }

    fn of(w: f64, inverse_quality: f64, cutoff_per_rate: f64) -> Self {
        let damping = 2.0 * inverse_quality * w;
        let a0 = 4.0 + damping + w * w;
        Self {
            b0: w * w / a0,
            a1: (2.0 * w * w - 8.0) / a0,
            a2: (4.0 - damping + w * w) / a0,
            cutoff_per_rate,
        }
    }

    /// The coefficients in LSB of 2^-30, with a DC gain of exactly one.
    ///
    /// `a2` is rounded. The DC sum `S` is rounded from `4 b0`, because nothing cancels in this product. `a1` follows
    /// from `S` and `a2`. The numerator is split so that its coefficients add up to `S`. So the rounding error is at
    /// most half an LSB for `a2`, one LSB for `a1` and `b0`, and two LSB for `b1`.
    pub fn quantise(&self) -> Biquad {
        const ONE: i32 = 1 << Biquad::FRACTION_BITS;
        let scale = f64::from(ONE);
        #[expect(clippy::cast_possible_truncation, reason = "|coefficient| < 2, so below 2^31")]
        let to_bits = |value: f64| libm::round(value * scale) as i32;
        let a2 = to_bits(self.a2);
        let b0 = to_bits(self.b0);
        #[expect(clippy::cast_possible_truncation, reason = "4 b0 < 4 - |a1| - |a2| < 2")]
        let dc_sum = libm::round(4.0 * self.b0 * scale) as i64;
        #[expect(clippy::cast_possible_truncation, reason = "both are below 2 in magnitude")]
        let (a1, b1) =
            ((dc_sum - i64::from(ONE) - i64::from(a2)) as i32, (dc_sum - 2 * i64::from(b0)) as i32);
        Biquad::new([b0, b1, b0], [a1, a2], self.cutoff_per_rate < SECOND_ORDER_BELOW)
    }
}

/// First-order low-pass `wc / (s + wc)` in floating point, by the bilinear transform. Its coefficients are
/// `b0 = b1 = w / (2 + w)` and `a1 = (w - 2) / (2 + w)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstOrder {
    /// Gain of the numerator `b0 (1 + z^-1)`.
    pub b0: f64,
    /// Denominator `1 + a1 z^-1`.
    pub a1: f64,
}

impl FirstOrder {
    /// Designs the filter for this cutoff and sample rate, both in Hz.
    ///
    /// # Errors
    ///
    /// `cutoff_hz` is outside [`CUTOFF_MIN`] .. [`CUTOFF_MAX`] of the rate. With `prewarp` the upper end is
    /// [`PREWARPED_MAX`].
    pub fn new(cutoff_hz: f64, rate_hz: f64, prewarp: bool) -> Result<Self, SettingsError> {
        Ok(Self::of(digital_frequency(cutoff_hz, rate_hz, prewarp)?))
    }

    fn of(w: f64) -> Self {
        Self { b0: w / (2.0 + w), a1: (w - 2.0) / (2.0 + w) }
    }

    /// Returns the coefficients in LSB of 2^-30, with a DC gain of exactly one. The rounding error of each coefficient
    /// is at most one LSB. The single pole needs no second order of error feedback at any cutoff.
    pub fn quantise(&self) -> Biquad {
        const ONE: i32 = 1 << Biquad::FRACTION_BITS;
        #[expect(clippy::cast_possible_truncation, reason = "2 b0 < 2")]
        let dc_sum = libm::round(2.0 * self.b0 * f64::from(ONE)) as i64;
        #[expect(clippy::cast_possible_truncation, reason = "all are below 2 in magnitude")]
        let [b0, b1, a1] =
            [dc_sum / 2, dc_sum - dc_sum / 2, dc_sum - i64::from(ONE)].map(|bits| bits as i32);
        Biquad::new([b0, b1, 0], [a1, 0], false)
    }
}

impl Biquad {
    /// Makes the low-pass of first or second order in integers. All rows of the table with a low-pass use it.
    #[inline(never)] // once in the image
    pub(super) fn low_pass(
        order: u32,
        cutoff_hz: f64,
        rate_hz: f64,
        prewarp: bool,
    ) -> Result<Self, SettingsError> {
        let w = digital_frequency(cutoff_hz, rate_hz, prewarp)?;
        Ok(match order {
            1 => FirstOrder::of(w).quantise(),
            _ => ButterworthDesign::of(w, SQRT_2, cutoff_hz / rate_hz).quantise(),
        })
    }

    /// Makes the low-pass of second order with a quality factor, in integers.
    #[cfg(feature = "estimators")]
    pub(super) fn second_order(
        cutoff_hz: f64,
        quality: f64,
        rate_hz: f64,
    ) -> Result<Self, SettingsError> {
        Ok(ButterworthDesign::damped(cutoff_hz, quality, rate_hz)?.quantise())
    }

    /// Frequency at which the filter with its quantised coefficients is at -3 dB, in Hz.
    ///
    /// With `s = sin^2(w/2)` the squared magnitudes of numerator N and denominator D are polynomials in `s`. Their
    /// coefficients are exact integers, so nothing cancels at low cutoffs. The polynomials are `|N|^2 = (S - 4 b0 s)^2`
    /// and `|D|^2 = S^2 - 4 P s + 16 Q s^2`, with `P = a1 (1 + a2) + 4 a2` and `Q = a2`. The condition
    /// `2 |N|^2 = |D|^2` is a quadratic equation.
    pub fn cutoff_hz(&self, rate_hz: f64) -> f64 {
        let [b0, b1, b2, a1, a2] = self.bits().map(i128::from);
        let one = 1i128 << Biquad::FRACTION_BITS;
        let dc_sum = b0 + b1 + b2;
        let p = a1 * (one + a2) + 4 * one * a2;
        let quadratic = to_f64(32 * b0 * b0 - 16 * one * a2);
        let linear = to_f64(4 * p - 16 * dc_sum * b0);
        let constant = to_f64(dc_sum * dc_sum);
        // The smaller positive root. This form of the solution has no cancellation, because linear < 0 < constant.
        let root = libm::sqrt((linear * linear - 4.0 * quadratic * constant).max(0.0));
        let s = 2.0 * constant / (root - linear);
        rate_hz / core::f64::consts::PI * libm::asin(libm::sqrt(s.clamp(0.0, 1.0)))
    }
}

#[expect(clippy::cast_precision_loss, reason = "the relative error of 2^-53 is what is wanted")]
fn to_f64(value: i128) -> f64 {
    value as f64
}
