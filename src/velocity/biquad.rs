//! A second-order low-pass in direct form 1. It has coefficients of 32 bits and an accumulator of 64 bits. The rounding
//! residue is carried to the next samples (error feedback). The DC gain is exactly one, and the output settles exactly.
//!
//! ```text
//! y[n] = round((b0 x[n] + b1 x[n-1] + b2 x[n-2] - a1 y[n-1] - a2 y[n-2] + r[n]) / 2^30)
//! ```
//!
//! `a1` and `a2` have the sign of the denominator `1 + a1 z^-1 + a2 z^-2`, as in the paper and in SciPy. In direct form
//! 1 the state consists of past inputs and outputs. So coefficients can change between two samples without a jump of
//! the force.
//!
//! **Error feedback.** Rounding drops the part `e` of a sum. The next sums get this part back, either as `r = e[n-1]`
//! (first order) or as `r = 2 e[n-1] - e[n-2]` (second order). So the output error is `(1 - z^-1) e / A(z)` or `(1 -
//! z^-1)^2 e / A(z)`. Both errors are 0 at DC: with a DC gain of exactly one, the sum of the outputs follows the sum of
//! the inputs for ever. At other frequencies the two errors differ. At low cutoffs both poles are near z = 1. There the
//! error has a gain of about `1 / w` with the first order. At cutoffs of 0.3 to 0.5 Hz and 10 kHz this is an error of
//! 12 LSB RMS, with limit cycles of 9 LSB. With the second order it is 0.3 LSB RMS. At high cutoffs there is no large
//! gain, and the second order would only amplify the error: at 4990 Hz the error is 1 LSB RMS with the second order,
//! and 0.55 LSB RMS with the first. The design chooses the order ([`Shaping`]) by the cutoff.
//!
//! The direct forms of `idsp` compute the same products. But the first-order form of `idsp` wraps at an overshoot at
//! full scale, where this filter must saturate. The wide form of `idsp` truncates, and so has a bias at DC.
//! `docs/theory.md` has the numbers. Coefficients are `dsp-fixedpoint` values.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use dsp_fixedpoint::Q32;

use super::{
    Form, Senses,
    kept::{Bytes, Kept},
};
use crate::units::Velocity;

/// A coefficient with 30 fractional bits. The range is -2 to 2.
pub(super) type Coefficient = Q32<30>;

/// Order of the error feedback.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shaping {
    /// The error of the rounding is shaped by `(1 - z^-1)`. This is used for high cutoffs.
    First,
    /// The error of the rounding is shaped by `(1 - z^-1)^2`. This is used for low cutoffs.
    Second,
}

/// Coefficients of the filter. Made by [`ButterworthDesign::quantise`](super::ButterworthDesign::quantise).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Biquad {
    b: [Coefficient; 3],
    /// `-a1` and `-a2`. With these signs, the five products and the residue are summed without a subtraction. This is
    /// faster, because the Cortex-M4 can add while it multiplies.
    back: [Coefficient; 2],
    /// Mask that selects the order of the error feedback. It is -1 for the second order, and 0 for the first.
    second: i32,
}

impl Biquad {
    /// Fractional bits of a coefficient.
    pub const FRACTION_BITS: u32 = 30;

    /// Makes a filter with these coefficients in LSB of 2^-30. If `second` is true, the error feedback has second
    /// order, otherwise first order. `a1` and `a2` must be above -2.
    pub(super) fn new(b: [i32; 3], a: [i32; 2], second: bool) -> Self {
        let q = Coefficient::from_bits;
        Self { b: b.map(q), back: a.map(|bits| q(-bits)), second: -i32::from(second) }
    }

    /// `[b0, b1, b2, a1, a2]` in LSB of 2^-30.
    pub fn bits(&self) -> [i32; 5] {
        let [b0, b1, b2] = self.b.map(Q32::into_bits);
        let [a1, a2] = self.back.map(|back| -back.into_bits());
        [b0, b1, b2, a1, a2]
    }

    /// Order of the error feedback.
    pub fn shaping(&self) -> Shaping {
        if self.second == 0 { Shaping::First } else { Shaping::Second }
    }

    /// Filters one sample. The output saturates before it is fed back, so an overload ends when its input ends. The
    /// state saturates one count per sample beyond the range of [`Velocity`]. The error feedback needs this room at a
    /// speed at the limit, where clipping would lower the mean.
    #[inline]
    pub fn update(&self, state: &mut BiquadState, input: Velocity) -> Velocity {
        self.update_sealed((state, &mut 0), input)
    }

    /// Like [`update`](Self::update), but also keeps the seal of [`Form::sealed`].
    #[inline(always)]
    fn update_sealed(
        &self,
        (state, seal): (&mut BiquadState, &mut u32),
        input: Velocity,
    ) -> Velocity {
        let x0 = input.bits();
        let [x1, x2] = state.x;
        let [y1, y2] = state.y;
        let [r1, r2] = state.dropped;
        *seal = seal.wrapping_sub([x2, y2, r2].sum());
        // The sum cannot overflow: its magnitude is below 2^63, because the design keeps |b0| + |b1| + |b2| + |a1| +
        // |a2| < 4.
        let [b0, b1, b2] = self.b;
        let [c1, c2] = self.back;
        // The value is below 2^31. It can wrap only after a flipped bit, which the check of the state's sum then finds.
        let carried = i64::from(r1.wrapping_add(self.second & r1.wrapping_sub(r2)));
        let sum = b0 * x0 + b1 * x1 + b2 * x2 + c1 * y1 + c2 * y2;
        let total = sum.into_bits() + carried;
        let upper = (total >> 32) as i32;
        state.x = [x0, x1];
        let dropped = (total & ((1 << Self::FRACTION_BITS) - 1)) as i32;
        state.dropped = [dropped, r1];
        *seal = seal.wrapping_add([x0, dropped].sum());
        // The sum is hardly ever near saturation. One comparison shows whether it is.
        if upper.wrapping_add(NEAR).cast_unsigned() < 2 * NEAR.cast_unsigned() {
            #[expect(clippy::cast_possible_truncation, reason = "within 4 NEAR")]
            let y0 = (total >> Self::FRACTION_BITS) as i32;
            state.y = [y0, y1];
            *seal = seal.wrapping_add(y0.sum());
            return Velocity::from_bits_in_range(y0);
        }
        cold_path();
        let rounded = total >> Self::FRACTION_BITS;
        let y0 = i32::try_from(rounded).unwrap_or(if rounded < 0 { i32::MIN } else { i32::MAX });
        state.y = [y0, y1];
        *seal = seal.wrapping_add(y0.sum());
        Velocity::saturating_from_bits(y0)
    }
}

/// If the accumulator's upper half is within this limit, the rounded velocity is in range.
const NEAR: i32 = 0x1F00_0000;
const _: () = assert!(4 * (NEAR as i64) < Velocity::LIMIT_BITS as i64);

/// Past inputs and outputs in LSB of [`Velocity`], and past residues in LSB of the accumulator.
#[derive(Clone, Copy, Debug)]
pub struct BiquadState {
    x: [i32; 2],
    y: [i32; 2],
    /// The parts that were dropped when the last two outputs were rounded down, 0 to 2^30. Each is the residue plus
    /// half an LSB, so that the next sum already contains the half for rounding.
    dropped: [i32; 2],
}

/// Half an LSB of the output, in LSB of the accumulator.
const ROUNDED: i32 = 1 << (Biquad::FRACTION_BITS - 1);

impl Default for BiquadState {
    fn default() -> Self {
        Biquad::REST
    }
}

impl Kept for BiquadState {
    fn put(&self, bytes: &mut Bytes<'_>) {
        let Self { x, y, dropped } = self;
        [*x, *y, dropped.map(|dropped| dropped.wrapping_sub(ROUNDED))].put(bytes);
    }

    fn take(rest: &mut &[u8]) -> Option<Self> {
        let [x, y, residue] = Kept::take(rest)?;
        Some(Self { x, y, dropped: residue.map(|residue: i32| residue.wrapping_add(ROUNDED)) })
    }

    #[inline(always)]
    fn sum(&self) -> u32 {
        let Self { x, y, dropped } = self;
        [*x, *y, *dropped].sum()
    }
}

#[cfg(test)]
impl Biquad {
    /// Makes a filter with the coefficients b0, b1, b2, a1 and a2 and the mask `second`. Nothing is checked.
    pub(crate) fn from_bits([b0, b1, b2, a1, a2]: [i32; 5], second: i32) -> Self {
        Self { second, ..Self::new([b0, b1, b2], [a1, a2], false) }
    }
}

#[cfg(test)]
impl BiquadState {
    pub(crate) fn from_bits(x: [i32; 2], y: [i32; 2], residue: [i32; 2]) -> Self {
        Self { x, y, dropped: residue.map(|residue| residue + ROUNDED) }
    }

    pub(crate) fn residue(&self) -> [i32; 2] {
        self.dropped.map(|dropped| dropped - ROUNDED)
    }
}

impl Form for Biquad {
    type State = BiquadState;
    const REST: BiquadState = BiquadState { x: [0; 2], y: [0; 2], dropped: [ROUNDED; 2] };

    fn at(&self, velocity: Velocity) -> BiquadState {
        BiquadState { x: [velocity.bits(); 2], y: [velocity.bits(); 2], dropped: [ROUNDED; 2] }
    }

    #[inline]
    fn step(&self, state: &mut BiquadState, difference: i32, _: &Senses) -> Velocity {
        self.update(state, Velocity::saturating_from_counts(difference))
    }

    #[inline(always)]
    fn sealed(
        &self,
        sealed: (&mut BiquadState, &mut u32),
        difference: i32,
        _: &Senses,
    ) -> Velocity {
        self.update_sealed(sealed, Velocity::saturating_from_counts(difference))
    }
}
