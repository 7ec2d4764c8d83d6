//! A tracking loop (phase-locked loop) on the position. Two integrators follow the count.
//!
//! ```text
//! e = x[n] - (x^ + v^)        x^ = x^ + v^ + kp e        v^ = v^ + ki e        counts, samples
//! ```
//!
//! The output is the integral `v^` alone, as in ODrive (`Firmware/MotorControl/encoder.cpp`). Another usual output is
//! `v^ + kp e` (moteus, `fw/motor_position.h`). That output has no delay at DC. But in that output every edge of the
//! count appears at once, and its gain falls like that of a single pole.
//!
//! **Gains.** ODrive and moteus set `kp = 2 w T`, `ki = (w T)^2`. With these gains the loop is critically damped only
//! for small w T. For larger w T it soon becomes unstable. ODrive refuses `kp >= 1`. Here both poles are at
//! `p = exp(-w T)`, with `w = 2 pi bandwidth`. The characteristic polynomial
//! `z^2 - (2 - kp - ki) z + (1 - kp) = (z - p)^2` gives
//!
//! ```text
//! kp = 1 - p^2,   ki = (1 - p)^2
//! ```
//!
//! At [`BANDWIDTH_MAX`] kp is 0.957. At higher bandwidths kp would come near 1, and the loop would follow every single
//! count. So they are refused.
//!
//! **Form.** Solved for v^ the loop is
//!
//! ```text
//! V^ = ki / (1 - p z^-1)^2  (1 - z^-1) X
//! ```
//!
//! This is a finite difference and a low-pass with a double pole. So the core computes it with its low-pass. At rest
//! the output ends at exactly 0, and at constant speed nothing is lost. A loop with a rounded-down x^ would need a dead
//! band (`|v| < ki / 2` becomes 0) against jitter. The simulator's twin runs the two integrators, and a test compares
//! the twin with the core.
//!
//! The delay at DC is `1/2 + 2 p / (1 - p)` samples. The -3 dB frequency is 0.644 of the bandwidth (for w T << 1).
//! Above this frequency the gain falls by 12 dB per octave. Like any linear filter of the count the loop trades noise
//! for delay.

use core::ops::RangeInclusive;

use super::biquad::Biquad;
use crate::range::{SettingsError, within};

/// Lowest accepted bandwidth, as a fraction of the sample rate. At this bandwidth `ki` is 52 LSB of 2^-30.
pub const BANDWIDTH_MIN: f64 = 3.5e-5;
/// Highest accepted bandwidth, as a fraction of the sample rate.
pub const BANDWIDTH_MAX: f64 = 0.25;
/// For smoothing, the accepted ratios of the second pole's frequency to the first pole's frequency. With a large ratio
/// the second pole is 1e-8 or less in the z plane, and has no effect.
pub const RATIO: RangeInclusive<f64> = 1.0..=1e6;
/// Below this bandwidth, as a fraction of the sample rate, second-order error feedback leaves less noise than
/// first-order error feedback. At this bandwidth both leave 0.35 LSB RMS. This follows from the squared impulse
/// responses of `(1 - z^-1)^k / (1 - p z^-1)^2`.
const SECOND_ORDER_BELOW: f64 = 0.05;

/// A tracking loop in floating point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackingLoop {
    /// Gain from the error e to the position x^.
    pub kp: f64,
    /// Gain from the error e to the velocity v^, per sample.
    pub ki: f64,
    /// Number of samples by which the output leads. The output is extrapolated from its last change. The lead is 0,
    /// except with [`TrackingLoop::led`].
    pub lead: f64,
    bandwidth_per_rate: f64,
}

impl TrackingLoop {
    /// Designs the loop with two poles at this bandwidth. Bandwidth and sample rate are in Hz.
    ///
    /// # Errors
    /// `bandwidth_hz` is outside [`BANDWIDTH_MIN`] .. [`BANDWIDTH_MAX`] of the rate.
    pub fn new(bandwidth_hz: f64, rate_hz: f64) -> Result<Self, SettingsError> {
        let range = BANDWIDTH_MIN * rate_hz..=BANDWIDTH_MAX * rate_hz;
        within("bandwidth_hz", bandwidth_hz, range)?;
        let bandwidth_per_rate = bandwidth_hz / rate_hz;
        let less = -libm::expm1(-2.0 * core::f64::consts::PI * bandwidth_per_rate); // 1 - p
        Ok(Self { kp: less * (2.0 - less), ki: less * less, lead: 0.0, bandwidth_per_rate })
    }

    /// Designs exponential smoothing, twice in series. The poles are at `exp(-w T)`, one for this cutoff and one for
    /// `ratio` * cutoff. As a loop this need not be critically damped. `1 - kp` is the product of the poles. `ki` is
    /// the product of their distances from 1.
    ///
    /// # Errors
    /// `cutoff_hz` is outside [`BANDWIDTH_MIN`] .. [`BANDWIDTH_MAX`] of the rate, or `ratio` is outside [`RATIO`].
    pub fn smoothing(cutoff_hz: f64, ratio: f64, rate_hz: f64) -> Result<Self, SettingsError> {
        within("cutoff_hz", cutoff_hz, BANDWIDTH_MIN * rate_hz..=BANDWIDTH_MAX * rate_hz)?;
        within("ratio", ratio, RATIO)?;
        let bandwidth_per_rate = cutoff_hz / rate_hz;
        let less = [1.0, ratio]
            .map(|times| -libm::expm1(-2.0 * core::f64::consts::PI * bandwidth_per_rate * times));
        let ki = less[0] * less[1];
        Ok(Self { kp: less[0] + less[1] - ki, ki, lead: 0.0, bandwidth_per_rate })
    }

    /// Designs the loop with this bandwidth and the output `v^ + lead (v^[n] - v^[n-1])`. A lead of -1 is a lag of one
    /// sample. With a lead of `kp / ki` the output includes the loop's proportional part, and has no delay at DC.
    ///
    /// # Errors
    /// `bandwidth_hz` is out of range as in [`new`](Self::new). Or `lead` is outside -1 .. `kp / ki + 1`. The upper end
    /// is the lead without delay, plus the sample that an explicit loop's proportional part gives. `lead` is also
    /// refused if a coefficient would reach 2, or if the magnitudes of the coefficients would add up to 4.
    pub fn led(bandwidth_hz: f64, lead: f64, rate_hz: f64) -> Result<Self, SettingsError> {
        let own = Self::new(bandwidth_hz, rate_hz)?;
        let (kp, ki) = (own.kp, own.ki);
        let sum = 0.5 * ((3.999 - (3.0 - 2.0 * kp - ki)) / ki - 1.0);
        // The limit has room for rounding, 1 part in 10^12, because callers may compute it in another way.
        let most = (kp / ki + 1.0) * (1.0 + 1e-12);
        within("lead", lead, -1.0..=most.min(1.999 / ki - 1.0).min(sum))?;
        Ok(Self { lead, ..own })
    }

    /// Delay of a slow motion, in samples.
    pub fn delay_samples(&self) -> f64 {
        // The difference delays by 1/2 sample, and each pole p by p / (1 - p).
        0.5 + (self.kp - self.ki) / self.ki - self.lead
    }

    /// Returns the low-pass that follows the finite difference. Its DC gain is exactly one, and its coefficients are
    /// exact to one LSB of 2^-30.
    pub fn quantise(&self) -> Biquad {
        let one = 1i32 << Biquad::FRACTION_BITS;
        #[expect(clippy::cast_possible_truncation, reason = "below 1, so below 2^30")]
        let [square, sum] =
            [1.0 - self.kp, self.ki].map(|value| libm::round(value * f64::from(one)) as i32);
        // a1 is ki - 1 - p^2, which is above -2 and so within i32.
        let a1 = sum.wrapping_sub(one).wrapping_sub(square);
        #[expect(clippy::cast_possible_truncation, reason = "below 1, so below 2^30")]
        let back = libm::round(self.ki * self.lead * f64::from(one)) as i32;
        let b = [sum.wrapping_add(back), back.wrapping_neg(), 0];
        Biquad::new(b, [a1, square], self.bandwidth_per_rate < SECOND_ORDER_BELOW)
    }
}
