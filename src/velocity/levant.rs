//! Levant's robust exact differentiator (Automatica 34(3), 1998). A position `x` follows the count `p`. The velocity of
//! `x` has two terms: a square root and an integrated sign.
//!
//! ```text
//! x' = u,   u = u1 - lambda sqrt(|e|) sign(e),   u1' = -alpha sign(e),   e = x - p
//! ```
//!
//! With `alpha > C >= |p''|` and without noise the differentiator is exact after a finite time. Usual values are
//! `alpha = 1.1 C` and `lambda = sqrt(C)`. In counts and samples C becomes `c = C T^2 / resolution`.
//!
//! **Explicit Euler** uses the right sides at the sample:
//!
//! ```text
//! e = x - p,   u = u1 - lambda sqrt(|e|) sign(e),   x += u,   u1 -= alpha sign(e);   the estimate is u
//! ```
//!
//! This form never comes to rest: `e` and the estimate jump about zero (chattering).
//!
//! **Implicit Euler** uses the right sides at the next sample, when `b = x + u1 - p` is known:
//!
//! ```text
//! e + lambda sqrt(|e|) sign(e) + alpha sign(e) contains b,   sign(0) = -1 .. 1
//! |b| <= alpha: e = 0,  u1 -= b
//! else:         sqrt(|e|) = sqrt(lambda^2 / 4 + |b| - alpha) - lambda / 2,   u1 -= alpha sign(b)
//! the estimate is u1
//! ```
//!
//! The two cases are the solution of the first line, which is a quadratic equation in sqrt(|e|) if `|b| > alpha`.
//! Implicit forms are known (arXiv 1911.09232, 2008.09863). Seeber (arXiv 2404.02770) shows that the earlier published
//! forms are biased or chatter. He proposes a form without bias and chattering. The outputs of his form are linear
//! combinations of the states. The form here was not compared with an implementation of Seeber's form. Instead the
//! behaviour of the form here is measured. Once `e` is zero, it stays zero as long as the speed changes by at most
//! alpha per sample. So the form does not chatter, and is exact at rest and at constant speed. The delay of this form
//! is half a sample, as for any backward difference.
//!
//! **Fixed point.** Only `u1` and `e` (one step ahead) are stored, with 32 fractional bits each. `e` is relative to the
//! count, so that nothing wraps, and limited to 2^24 counts. The root is the integer root of 64 bits.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Form, Senses, kept::kept};
use crate::{
    Design, Gain,
    range::{SettingsError, within},
    units::Velocity,
};

/// Magnitudes of the two terms in counts and samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevantDesign {
    /// Magnitude of the sign term, in counts per sample^2.
    pub alpha: f64,
    /// Factor of the root term, in sqrt(counts) per sample.
    pub lambda: f64,
}

/// Smallest and largest accepted C, in counts per sample^2.
const C: [f64; 2] = [1e-6, 1e4];

#[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
impl LevantDesign {
    /// Designs the differentiator for a largest acceleration, in m/s^2. `lambda_ratio` is `lambda / sqrt(C)`, from 0.5
    /// to 3.
    ///
    /// # Errors
    /// Names the parameter and its range. The acceleration's range follows from rate and resolution.
    pub fn new(
        acceleration_max: f64,
        lambda_ratio: f64,
        design: &Design,
    ) -> Result<Self, SettingsError> {
        let unit = design.resolution_m * design.rate_hz * design.rate_hz;
        let [low, high] = C.map(|c| c * unit);
        let c = within("acceleration_max_m_per_s2", acceleration_max, low..=high)? / unit;
        let ratio = within("lambda_ratio", lambda_ratio, 0.5..=3.0)?;
        Ok(Self { alpha: 1.1 * c, lambda: ratio * libm::sqrt(c) })
    }

    /// Converts the design to integers.
    pub fn quantise(&self, implicit: bool) -> Levant {
        let one = libm::scalbn(1.0, FRACTION_BITS.cast_signed());
        #[expect(clippy::cast_possible_truncation, reason = "below 2^14 by the range of C")]
        let bits = |value: f64| libm::round(value * one) as i64;
        Levant {
            implicit,
            alpha: bits(self.alpha),
            lambda: Gain::from_f64(self.lambda).unwrap_or_default(), // 2^-11 .. 2^9
            half: bits(self.lambda / 2.0),
            square: bits(self.lambda * self.lambda / 4.0),
        }
    }
}

const FRACTION_BITS: u32 = 32;
/// Largest distance from the count, in LSB of 2^-32 counts.
const DISTANCE_MAX: i64 = 1 << (24 + FRACTION_BITS);
/// Largest velocity of the state. It is twice the largest velocity of the output.
const VELOCITY_MAX: i64 = 1 << (16 + FRACTION_BITS);

/// Magnitudes of the two terms in integers. Made by [`LevantDesign::quantise`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levant {
    implicit: bool,
    alpha: i64,
    lambda: Gain,
    /// Half of lambda, with 32 fractional bits.
    half: i64,
    /// Square of half of lambda, with 32 fractional bits.
    square: i64,
}

/// Position and velocity after the last sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct LevantState {
    /// Predicted position at the next sample, minus the last count.
    ahead: i64,
    velocity: i64,
}

kept!(LevantState { ahead, velocity });

impl Form for Levant {
    type State = LevantState;
    const REST: LevantState = LevantState { ahead: 0, velocity: 0 };

    fn at(&self, velocity: Velocity) -> LevantState {
        let bits = i64::from(velocity.bits()) << (FRACTION_BITS - Velocity::FRACTION_BITS);
        LevantState { ahead: bits, velocity: bits }
    }

    #[inline]
    fn step(&self, state: &mut LevantState, difference: i32, _: &Senses) -> Velocity {
        let moved = i64::from(difference.clamp(-Velocity::LIMIT, Velocity::LIMIT));
        let moved = moved << FRACTION_BITS;
        if self.implicit { self.implicit(state, moved) } else { self.explicit(state, moved) }
    }
}

impl Levant {
    /// Factor of the root term, in sqrt(counts) per sample.
    pub const fn lambda(&self) -> Gain {
        self.lambda
    }

    /// Returns alpha, half of lambda, and the square of this half. All have 32 fractional bits.
    pub const fn sizes(&self) -> [i64; 3] {
        [self.alpha, self.half, self.square]
    }

    fn explicit(&self, state: &mut LevantState, moved: i64) -> Velocity {
        let e = (state.ahead - moved).clamp(-DISTANCE_MAX, DISTANCE_MAX);
        let pull = self.lambda.apply_wide(root(e.unsigned_abs()));
        let u = state.velocity - e.signum() * pull;
        state.ahead = e + u;
        state.velocity = limited(state.velocity - e.signum() * self.alpha);
        velocity(u)
    }

    fn implicit(&self, state: &mut LevantState, moved: i64) -> Velocity {
        let b = (state.ahead - moved).clamp(-DISTANCE_MAX, DISTANCE_MAX);
        let beyond = b.abs() - self.alpha;
        let e = if beyond <= 0 {
            state.velocity = limited(state.velocity - b);
            0
        } else {
            state.velocity = limited(state.velocity - self.alpha * b.signum());
            let root = root((self.square + beyond).unsigned_abs()) - self.half;
            (beyond - self.lambda.apply_wide(root)).max(0) * b.signum()
        };
        state.ahead = e + state.velocity;
        velocity(state.velocity)
    }
}

#[inline]
fn limited(velocity: i64) -> i64 {
    velocity.clamp(-VELOCITY_MAX, VELOCITY_MAX)
}

#[inline]
fn velocity(bits: i64) -> Velocity {
    const DROPPED: u32 = FRACTION_BITS - Velocity::FRACTION_BITS;
    let limit = i64::from(Velocity::LIMIT_BITS);
    let nearest = ((bits + (1 << (DROPPED - 1))) >> DROPPED).clamp(-limit, limit);
    #[expect(clippy::cast_possible_truncation, reason = "clamped to 31 bits")]
    Velocity::saturating_from_bits(nearest as i32)
}

/// Computes a square root. Operand and result have 32 fractional bits. 31 bits of the result are exact. `square` must
/// be below 2^60.
///
/// The integer root of `square * 2^(2 n)` is the root times `2^n`. `n` is chosen so that the operand uses its full 64
/// bits.
#[inline]
fn root(square: u64) -> i64 {
    let twice = square.leading_zeros() & !1;
    let bits = (square << twice.min(62)).isqrt(); // root * 2^(16 + n)
    let n = twice.min(62) / 2;
    let wanted = FRACTION_BITS / 2;
    let shifted = if n > wanted { bits >> (n - wanted) } else { bits << (wanted - n) };
    shifted.cast_signed()
}

#[cfg(test)]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "a test fails loudly"
)]
mod tests {
    use super::*;
    use crate::Output;
    use proptest::prelude::*;

    const DESIGN: Design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 1.0,
        period: 10,
        output: Output::Continuous,
    };
    /// LSB of the state, 2^-32.
    const LSB: f64 = 1.0 / (1u64 << 32) as f64;

    proptest! {
        #[test]
        fn the_root_has_31_bits(bits in 0u64..(1 << 60), narrower in 0u32..60) {
            let square = bits >> narrower;
            let exact = (square as f64 * LSB).sqrt();
            let off = root(square) as f64 * LSB - exact;
            prop_assert!(off.abs() <= LSB + exact / (1u64 << 30) as f64, "{off}");
        }

        /// From any state, one step agrees with the equations.
        #[test]
        fn a_step_is_that_of_the_equations(
            implicit in any::<bool>(),
            acceleration in -3.0..3.0,
            ahead in -1e6..1e6,
            nearer in -9.0..0.0,
            speed in -3e4..3e4,
            difference in -32_767i32..=32_767,
            at_count in any::<bool>(),
        ) {
            /// Largest allowed error. The root has 31 exact bits, and its error is multiplied by the largest lambda of
            /// this test.
            const ERROR_MAX: f64 = 1e-5;
            let acceleration = 20.0 * 10f64.powf(acceleration);
            let design = LevantDesign::new(acceleration, 1.0, &DESIGN).unwrap();
            let bits = |value: f64| (value / LSB).round() as i64;
            // The state is often near the count, because there the two forms differ.
            let b = if at_count { 0.0 } else { ahead * 10f64.powf(nearer) };
            let mut state = LevantState {
                ahead: bits(b) + (i64::from(difference) << FRACTION_BITS),
                velocity: bits(speed),
            };
            let velocity = design.quantise(implicit).step(&mut state, difference, &Senses::NONE);
            let LevantDesign { alpha, lambda } = design;
            let sign = if bits(b) == 0 { 0.0 } else { b.signum() };
            let (u, u1, e) = if !implicit {
                let u = speed - lambda * b.abs().sqrt() * sign;
                (u, speed - alpha * sign, b)
            } else if b.abs() <= alpha {
                (speed - b, speed - b, 0.0)
            } else {
                let root = (lambda * lambda / 4.0 + b.abs() - alpha).sqrt() - lambda / 2.0;
                (speed - alpha * sign, speed - alpha * sign, root * root * sign)
            };
            let moves = if implicit { u1 } else { u };
            for (got, want, error) in [
                (f64::from(velocity.bits()) / 65536.0, u.clamp(-32_767.0, 32_767.0), 1.0 / 131_072.0),
                (state.velocity as f64 * LSB, u1, 0.0),
                (state.ahead as f64 * LSB, e + moves, 0.0),
            ] {
                prop_assert!((got - want).abs() <= error + ERROR_MAX, "{got} against {want}");
            }
        }
    }

    #[test]
    fn at_rest_the_implicit_form_is_exactly_at_rest_and_the_sign_of_zero_is_zero() {
        const SAMPLES: i32 = if cfg!(miri) { 600 } else { 5000 };
        for implicit in [false, true] {
            let levant = LevantDesign::new(20.0, 1.0, &DESIGN).unwrap().quantise(implicit);
            let mut state = Levant::REST;
            for _ in 0..100 {
                assert_eq!(levant.step(&mut state, 0, &Senses::NONE), Velocity::ZERO);
            }
        }
        let levant = LevantDesign::new(20.0, 1.0, &DESIGN).unwrap().quantise(true);
        let mut state = Levant::REST;
        for n in 0..SAMPLES {
            levant.step(&mut state, n % 7 - 3, &Senses::NONE);
        }
        let rest: std::vec::Vec<_> =
            (0..SAMPLES).map(|_| levant.step(&mut state, 0, &Senses::NONE)).collect();
        let moving = rest.iter().rposition(|velocity| *velocity != Velocity::ZERO).unwrap_or(0);
        assert!(moving < 500, "moves for {moving} samples after the stop");
    }

    #[test]
    fn what_is_out_of_range_is_refused_by_name() {
        for (c, ratio, parameter) in [
            (0.0, 1.0, "acceleration_max_m_per_s2"),
            (2e6, 1.0, "acceleration_max_m_per_s2"),
            (f64::NAN, 1.0, "acceleration_max_m_per_s2"),
            (20.0, 0.4, "lambda_ratio"),
            (20.0, 3.1, "lambda_ratio"),
        ] {
            assert_eq!(LevantDesign::new(c, ratio, &DESIGN).unwrap_err().parameter, parameter);
        }
    }
}
