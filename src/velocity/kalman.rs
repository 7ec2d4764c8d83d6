//! Steady-state Kalman filter. The model is a handle that noise moves. A filter with two states has position and
//! velocity. A filter with three states also has the acceleration. An encoder measures the position. The encoder's
//! rounding is modelled as white noise of `resolution / sqrt(12)` RMS (Belanger 1992; Belanger, Dobrovolny, Helmy,
//! Zhang 1998).
//!
//! The equations are in counts and samples. `r` is the count minus the predicted position:
//!
//! ```text
//! predict: x += v + a/2,  v += a
//! correct: x += alpha r,  v += beta r,  a += gamma r          (two states: a = gamma = 0)
//! ```
//!
//! **Gains.** With two states the motion noise is an acceleration that differs from sample to sample. With three states
//! the acceleration changes at every sample by a random amount, its jerk times T. Then the steady gains are closed
//! forms of one number, `L` = motion noise / measurement noise (Kalata, IEEE T-AES 20(2), 1984; Gray and Murray, IEEE
//! T-AES 29(3), 1993). With `u = 1 - sqrt(1 - alpha)`:
//!
//! ```text
//! alpha = u (2 - u),  beta = 2 u^2,  gamma = beta^2 / (2 alpha)
//! two states:   2 u^2 = L (1 - u),            L = acceleration T^2 / (resolution / sqrt(12))
//! three states: 2 u^3 = L (1 - u) (2 - u),    L = jerk T^3 / (resolution / sqrt(12))
//! ```
//!
//! A sample only needs products with the gains. At low frequencies the delay is `alpha / beta - 1/2` samples with two
//! states, and 0 with three states.
//!
//! **Fixed point.** The position is stored as its distance from the count, so that nothing wraps. At a constant speed
//! `r` stays zero, for any rounding of the gains. The part that rounding drops from one output is added to the next
//! output. The rounding of the products leaves the mean velocity within 2^-23 counts per sample, which is 1/128 LSB.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Form, Senses, Word, kept::kept};
use crate::{
    Design, Gain,
    range::{SettingsError, within},
    units::Velocity,
};

/// Gains of the filter in floating point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalmanDesign {
    /// Gain of the position, without a unit.
    pub alpha: f64,
    /// Gain of the velocity, per sample.
    pub beta: f64,
    /// Gain of the acceleration, per sample^2. It is 0 with two states.
    pub gamma: f64,
}

/// The smallest and the largest accepted `u`. At 10 kHz the smallest gives a bandwidth of some 2 Hz. The largest is
/// almost the finite difference.
const U: [f64; 2] = [1e-3, 0.95];

#[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
impl KalmanDesign {
    /// Designs the filter with two states, for motion noise with this RMS acceleration, in m/s^2.
    ///
    /// # Errors
    /// Names the parameter and its range, which follows from rate and resolution.
    pub fn two_states(acceleration: f64, design: &Design) -> Result<Self, SettingsError> {
        let unit = noise_m(design) * design.rate_hz * design.rate_hz;
        let [low, high] = U.map(|u| 2.0 * u * u / (1.0 - u) * unit);
        let l = within("acceleration_rms_m_per_s2", acceleration, low..=high)? / unit;
        Ok(Self { gamma: 0.0, ..Self::of(2.0 * l / (l + libm::sqrt(l * l + 8.0 * l))) })
    }

    /// Designs the filter with three states, for motion noise with this RMS jerk, in m/s^3.
    ///
    /// # Errors
    /// Names the parameter and its range, which follows from rate and resolution.
    pub fn three_states(jerk: f64, design: &Design) -> Result<Self, SettingsError> {
        /// Number of times that the interval is halved. It equals the number of bits of an `f64`.
        const STEPS: u32 = 53;
        let unit = noise_m(design) * design.rate_hz * design.rate_hz * design.rate_hz;
        let [low, high] = U.map(|u| 2.0 * u * u * u / ((1.0 - u) * (2.0 - u)) * unit);
        let l = within("jerk_rms_m_per_s3", jerk, low..=high)? / unit;
        let (mut below, mut above) = (0.0, 1.0);
        for _ in 0..STEPS {
            let u = (below + above) / 2.0;
            if 2.0 * u * u * u < l * (1.0 - u) * (2.0 - u) { below = u } else { above = u }
        }
        Ok(Self::of((below + above) / 2.0))
    }

    fn of(u: f64) -> Self {
        let (alpha, beta) = (u * (2.0 - u), 2.0 * u * u);
        Self { alpha, beta, gamma: beta * beta / (2.0 * alpha) }
    }

    /// Converts the gains to integers, each with a relative error of at most 2^-31.
    pub fn quantise(&self) -> Kalman {
        // By the limits of u, each gain is at least 2^-32, so it can be represented.
        let gain = |value| Gain::from_f64(value).unwrap_or_default();
        Kalman { alpha: gain(self.alpha), beta: gain(self.beta), gamma: gain(self.gamma * GAMMA) }
    }
}

/// RMS of the measurement noise, in m.
#[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
fn noise_m(design: &Design) -> f64 {
    design.resolution_m / libm::sqrt(12.0)
}

/// Fractional bits of position and velocity.
const FRACTION_BITS: u32 = 32;
/// Fractional bits that the output drops.
const DROPPED_BITS: u32 = FRACTION_BITS - Velocity::FRACTION_BITS;
/// Further fractional bits of the acceleration, because small gains change it only a little.
const ACCELERATION_BITS: u32 = 12;
const GAMMA: f64 = (1u32 << ACCELERATION_BITS) as f64;
/// Largest distance from the count. With the smallest gains, the distance after a stop from full speed is smaller.
const DISTANCE_MAX: i64 = 1 << (28 + FRACTION_BITS);
/// Largest velocity of the state. It is twice the largest output, because the state may overshoot.
const VELOCITY_MAX: i64 = 1 << (16 + FRACTION_BITS);
/// Largest acceleration of the state. It covers the largest gain after a reversal at full speed.
const ACCELERATION_MAX: i64 = 1 << (18 + FRACTION_BITS + ACCELERATION_BITS);

/// Gains in integers. Made by [`KalmanDesign::quantise`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kalman<G = Gain> {
    /// Gain of the position.
    pub alpha: G,
    /// Gain of the velocity, per sample.
    pub beta: G,
    /// Gain of the acceleration, per sample^2, times 2^12.
    pub gamma: G,
}

/// Estimates after the last sample.
#[derive(Clone, Copy, Debug)]
pub struct KalmanState<W: Word = i64> {
    /// Position minus the count, in LSB of 2^-32 counts.
    pub distance: W,
    /// Velocity, in 2^-32 counts per sample.
    pub velocity: W,
    /// Acceleration, in 2^-44 counts per sample^2.
    pub acceleration: W,
    /// The part that was dropped when the last output was rounded.
    pub residue: W::Fraction,
}

kept!(KalmanState { distance, velocity, acceleration, residue });

impl Kalman {
    /// The state before the first sample.
    pub const REST: KalmanState =
        KalmanState { distance: 0, velocity: 0, acceleration: 0, residue: 1 << (DROPPED_BITS - 1) };
}

impl<G: Copy> Kalman<G> {
    /// Takes a motion of `moved` counts. Returns the velocity in LSB of [`Velocity`].
    #[inline(always)] // into the code that is compiled for vector instructions
    pub fn update<W: Word<Gain = G>>(&self, state: &mut KalmanState<W>, moved: W) -> W {
        let speed_up = state.acceleration.rounded(ACCELERATION_BITS);
        let ahead = state.velocity + (speed_up >> 1) - (moved << FRACTION_BITS);
        let predicted = (state.distance + ahead).clamped(DISTANCE_MAX);
        state.distance = predicted - predicted.times(self.alpha);
        state.velocity =
            (state.velocity + speed_up - predicted.times(self.beta)).clamped(VELOCITY_MAX);
        state.acceleration =
            (state.acceleration - predicted.times(self.gamma)).clamped(ACCELERATION_MAX);
        // The part that was dropped from the last output is added.
        let (nearest, residue) = state.velocity.plus(state.residue).split();
        state.residue = residue;
        nearest.clamped(Velocity::LIMIT_BITS.into())
    }
}

impl Form for Kalman {
    type State = KalmanState;
    const REST: KalmanState = Self::REST;

    fn at(&self, velocity: Velocity) -> KalmanState {
        KalmanState { velocity: i64::from(velocity.bits()) << DROPPED_BITS, ..Self::REST }
    }

    #[inline]
    fn step(&self, state: &mut KalmanState, difference: i32, _: &Senses) -> Velocity {
        let moved = difference.clamp(-Velocity::LIMIT, Velocity::LIMIT);
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 31 bits")]
        Velocity::saturating_from_bits(self.update(state, i64::from(moved)) as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Output;

    const DESIGN: Design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 1.0,
        period: 10,
        output: Output::Continuous,
    };

    /// Computes the steady gains with the Riccati recursion, in counts and samples.
    fn riccati(gain: [f64; 3], ratio: f64, order: usize) -> [f64; 3] {
        let step = [[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]];
        let mut p = [[0.0; 3]; 3];
        for (n, row) in p.iter_mut().enumerate().take(order) {
            row[n] = 1.0;
        }
        let mut k = [0.0; 3];
        for _ in 0..if cfg!(miri) { 100 } else { 20_000 } {
            let mut next = [[0.0; 3]; 3];
            for i in 0..order {
                for j in 0..order {
                    for m in 0..order {
                        for n in 0..order {
                            next[i][j] += step[i][m] * p[m][n] * step[j][n];
                        }
                    }
                    next[i][j] += ratio * ratio * gain[i] * gain[j];
                }
            }
            for i in 0..order {
                k[i] = next[i][0] / (next[0][0] + 1.0);
            }
            for i in 0..order {
                for j in 0..order {
                    p[i][j] = next[i][j] - k[i] * next[0][j];
                }
            }
        }
        k
    }

    #[test]
    fn the_gains_are_those_of_the_riccati_recursion() {
        let noise = 1e-6 / 12f64.sqrt();
        // The recursion takes longer for a smaller ratio.
        let ratios: &[f64] = if cfg!(miri) { &[30.0] } else { &[1e-4, 1e-3, 0.03, 0.7, 5.0, 30.0] };
        for &ratio in ratios {
            let two = KalmanDesign::two_states(ratio * noise * 1e8, &DESIGN).unwrap();
            let three = KalmanDesign::three_states(ratio * noise * 1e12, &DESIGN).unwrap();
            let of = |d: &KalmanDesign| [d.alpha, d.beta, d.gamma];
            for (got, want) in [
                (of(&two), riccati([0.5, 1.0, 0.0], ratio, 2)),
                (of(&three), riccati([0.5, 1.0, 1.0], ratio, 3)),
            ] {
                for (got, want) in got.into_iter().zip(want) {
                    assert!((got - want).abs() <= 1e-9 * want, "{ratio}: {got} against {want}");
                }
            }
        }
    }

    /// Every intermediate is monotone in each argument (see [`crate::bounds`]), and each gain is monotone in the
    /// tuning.
    #[test]
    fn no_step_overflows_at_any_corner_of_state_and_input() {
        let gain = |u: f64| KalmanDesign::of(u).quantise();
        let none = Gain::default();
        for filter in [gain(U[0]), gain(0.1), gain(0.5), gain(U[1])] {
            for gamma in [none, filter.gamma] {
                let filter = Kalman { gamma, ..filter };
                let ends = [DISTANCE_MAX, VELOCITY_MAX, ACCELERATION_MAX].map(|max| [-max, max]);
                for [distance, velocity, acceleration] in crate::bounds::corners(ends) {
                    for residue in [0, u16::MAX] {
                        for moved in [i32::MIN, 0, i32::MAX] {
                            let mut state =
                                KalmanState { distance, velocity, acceleration, residue };
                            let speed = filter.step(&mut state, moved, &Senses::NONE);
                            assert!(speed.bits().abs() <= Velocity::LIMIT_BITS);
                            assert!(state.distance.abs() <= DISTANCE_MAX);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn accelerations_and_jerks_out_of_range_are_refused_by_name() {
        for bad in [0.0, -1.0, 1e-9, 1e18, f64::NAN, f64::INFINITY] {
            let two = KalmanDesign::two_states(bad, &DESIGN).unwrap_err();
            assert_eq!(two.parameter, "acceleration_rms_m_per_s2");
            let three = KalmanDesign::three_states(bad, &DESIGN).unwrap_err();
            assert_eq!(three.parameter, "jerk_rms_m_per_s3");
        }
    }
}
