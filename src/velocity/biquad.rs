//! A second-order low-pass in direct form 1, whose DC gain is exactly one and whose output leaves
//! nothing behind: 32-bit coefficients, 64-bit accumulator, residue carried (error feedback).
//!
//! ```text
//! y[n] = round((b0 x[n] + b1 x[n-1] + b2 x[n-2] - a1 y[n-1] - a2 y[n-2] + r[n]) / 2^30)
//! ```
//!
//! `a1` and `a2` carry the sign of the denominator `1 + a1 z^-1 + a2 z^-2`, as in the paper and in
//! SciPy. Direct form 1, because its state is past inputs and outputs: coefficients can change
//! between two samples and the hand feels no kick.
//!
//! **Error feedback.** What rounding dropped, `e`, goes back into the next sums, either as
//! `r = e[n-1]` or as `r = 2 e[n-1] - e[n-2]`, so the output error is `(1 - z^-1) e / A(z)` or
//! `(1 - z^-1)^2 e / A(z)`. Both vanish at DC: with a DC gain of exactly one, the sum of the outputs
//! follows the sum of the inputs for ever. They differ in between. Low cutoffs put both poles near
//! z = 1, where the first order leaves a gain of about `1 / w` (12 LSB RMS and limit cycles of 9 LSB
//! at 0.3 .. 0.5 Hz and 10 kHz) and the second order leaves 0.3 LSB RMS. High cutoffs have no such
//! gain, and the second order would only amplify (1 LSB RMS at 4990 Hz against 0.55). The design
//! picks the order ([`Shaping`]) by the cutoff.
//!
//! `idsp`'s direct forms do the same products, but its first-order form wraps where this one must
//! saturate (an overshoot at full scale), and its wide form truncates and so has a bias at DC;
//! `docs/theory.md` has the numbers. Coefficients are `dsp-fixedpoint` values.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use dsp_fixedpoint::Q32;

use super::{Form, Senses, kept::kept};
use crate::units::Velocity;

/// Coefficient with 30 fractional bits: -2 .. 2.
pub(super) type Coefficient = Q32<30>;

/// Order of the error feedback.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shaping {
    /// `(1 - z^-1)`, for high cutoffs.
    First,
    /// `(1 - z^-1)^2`, for low cutoffs.
    Second,
}

/// Coefficients of the filter; made by [`ButterworthDesign::quantise`](super::ButterworthDesign::quantise).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Biquad {
    pub(super) b: [Coefficient; 3],
    pub(super) a: [Coefficient; 2],
    /// Mask of the second difference of the residue: -1 with it, 0 without.
    pub(super) second: i32,
}

impl Biquad {
    /// Fractional bits of a coefficient.
    pub const FRACTION_BITS: u32 = 30;

    /// `[b0, b1, b2, a1, a2]` in LSB of 2^-30.
    pub fn bits(&self) -> [i32; 5] {
        let [b0, b1, b2] = self.b;
        let [a1, a2] = self.a;
        [b0, b1, b2, a1, a2].map(Q32::into_bits)
    }

    /// Order of the error feedback.
    pub fn shaping(&self) -> Shaping {
        if self.second == 0 { Shaping::First } else { Shaping::Second }
    }

    /// Filters one sample. Saturates before the feedback, so that an overload ends with its input.
    /// The state saturates one count per sample beyond [`Velocity`]: the error feedback of a speed
    /// at the limit needs that room, or the clipping would pull the mean down.
    #[inline]
    pub fn update(&self, state: &mut BiquadState, input: Velocity) -> Velocity {
        let x0 = input.bits();
        let [x1, x2] = state.x;
        let [y1, y2] = state.y;
        let [e1, e2] = state.residue;
        // Sum of the magnitudes below 2^63: the design keeps |b0| + |b1| + |b2| + |a1| + |a2| < 4.
        let sum =
            self.b[0] * x0 + self.b[1] * x1 + self.b[2] * x2 - self.a[0] * y1 - self.a[1] * y2;
        let carried = e1 + (self.second & (e1 - e2));
        let total = sum.into_bits() + i64::from(carried) + HALF;
        let rounded = total >> Self::FRACTION_BITS;
        let y0 = i32::try_from(rounded).unwrap_or_else(|_| {
            cold_path();
            if rounded < 0 { i32::MIN } else { i32::MAX }
        });
        // What rounding dropped, -2^29 .. 2^29. What saturation cuts off is not carried.
        let residue = (total & (2 * HALF - 1)) - HALF;
        #[expect(clippy::cast_possible_truncation, reason = "within 30 bits by the line above")]
        let e0 = residue as i32;
        state.x = [x0, x1];
        state.y = [y0, y1];
        state.residue = [e0, e1];
        Velocity::saturating_from_bits(y0)
    }
}

/// Half an LSB of the output, in LSB of the accumulator.
const HALF: i64 = 1 << (Biquad::FRACTION_BITS - 1);

/// Past inputs and outputs in LSB of [`Velocity`], and past residues in LSB of the accumulator.
#[derive(Clone, Copy, Debug, Default)]
pub struct BiquadState {
    x: [i32; 2],
    y: [i32; 2],
    residue: [i32; 2],
}

kept!(BiquadState { x, y, residue });

impl BiquadState {
    /// The last input, LSB.
    pub(super) fn input(&self) -> i32 {
        self.x[0]
    }
}

#[cfg(test)]
impl Biquad {
    /// Coefficients b0, b1, b2, a1, a2 and the mask of the second residue, as they are.
    pub(crate) fn from_bits([b0, b1, b2, a1, a2]: [i32; 5], second: i32) -> Self {
        let q = Coefficient::from_bits;
        Self { b: [q(b0), q(b1), q(b2)], a: [q(a1), q(a2)], second }
    }
}

#[cfg(test)]
impl BiquadState {
    pub(crate) fn from_bits(x: [i32; 2], y: [i32; 2], residue: [i32; 2]) -> Self {
        Self { x, y, residue }
    }

    pub(crate) fn residue(&self) -> [i32; 2] {
        self.residue
    }
}

impl Form for Biquad {
    type State = BiquadState;
    const REST: BiquadState = BiquadState { x: [0; 2], y: [0; 2], residue: [0; 2] };

    fn at(&self, velocity: Velocity) -> BiquadState {
        BiquadState { x: [velocity.bits(); 2], y: [velocity.bits(); 2], residue: [0; 2] }
    }

    #[inline]
    fn step(&self, state: &mut BiquadState, difference: i32, _: &Senses) -> Velocity {
        self.update(state, Velocity::saturating_from_counts(difference))
    }
}
