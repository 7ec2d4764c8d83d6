//! The core's [`Word`] as a vector, so that the core's own code of an estimator can run in lanes.

use std::ops::{Add, Shl, Shr, Sub};

use zwidth::{
    Gain,
    velocity::{Factor, Word},
};

use crate::engine::simd_ops::{SimdOps, lanes_mut};

/// A vector of signed 64-bit numbers. Its clamp functions do nothing, so the caller must detect two cases: a number
/// comes near the limits of the core, or a number of 2^[`FACTOR_BITS`] or more is multiplied.
#[derive(Clone, Copy)]
pub struct Vector<S: SimdOps> {
    pub simd: S,
    pub bits: S::u64s,
}

#[derive(Clone, Copy)]
pub struct LaneGain<S: SimdOps> {
    mantissa: S::u64s,
    half: S::u64s,
    shift: S::u64s,
}

impl<S: SimdOps> LaneGain<S> {
    pub fn zero(simd: S) -> Self {
        let zero = simd.splat_u64s(0);
        Self { mantissa: zero, half: zero, shift: zero }
    }

    /// Whether lanes can represent the gain: the gain must be below 2^13.
    pub fn has(gain: Gain) -> bool {
        gain.mantissa() == 0 || i32::from(gain.shift()) + LEFT.cast_signed() > 32
    }

    /// Puts a gain into a lane. Lanes must be able to represent the gain.
    pub fn set(&mut self, place: usize, gain: Gain) {
        let shift = (i32::from(gain.shift()) + LEFT.cast_signed() - 32).max(1).unsigned_abs();
        lanes_mut(&mut self.mantissa)[place] = u64::from(gain.mantissa().unsigned_abs());
        lanes_mut(&mut self.half)[place] = 1u64 << (shift - 1);
        lanes_mut(&mut self.shift)[place] = u64::from(shift);
    }
}

/// A [`Factor`] for each lane of a vector. A mantissa has 32 bits and no sign, so the number that it multiplies must be
/// positive. Therefore `PLUS` is added to the number first, and `PLUS` times the mantissa is subtracted from the
/// product.
#[derive(Clone, Copy)]
pub struct LaneFactor<S: SimdOps> {
    mantissa: S::u64s,
    shift: S::u64s,
    less: S::u64s,
}

/// Limit of the magnitude of numbers that a [`LaneFactor`] multiplies.
const PLUS: u64 = 1 << 47;

impl<S: SimdOps> LaneFactor<S> {
    pub fn zero(simd: S) -> Self {
        let zero = simd.splat_u64s(0);
        Self { mantissa: zero, shift: zero, less: zero }
    }

    /// Puts a factor into a lane. Its products have `bits` more fractional bits. Returns `false` if the product of
    /// factor and `PLUS` is not a whole number. Then the factor cannot be used in lanes.
    pub fn set(&mut self, place: usize, factor: Factor, bits: u8) -> bool {
        // the product is mantissa * number * 2^LEFT / 2^32; the shift corrects for LEFT and 32
        let shift = i32::from(factor.shift()) + LEFT.cast_signed() - i32::from(bits);
        let left = 30 - shift; // 2^47 shifted right by 17 is 2^30
        let has = (0..64).contains(&shift) && (0..32).contains(&left);
        lanes_mut(&mut self.mantissa)[place] = u64::from(factor.mantissa());
        lanes_mut(&mut self.shift)[place] = u64::from(shift.max(0).unsigned_abs().min(63));
        lanes_mut(&mut self.less)[place] =
            u64::from(factor.mantissa()) << left.clamp(0, 31).unsigned_abs();
        has
    }
}

/// Number of bits by which numbers are shifted left before they are multiplied. After this shift, the product's bits
/// below 2^32 only affect rounding.
const LEFT: u32 = 15;
/// Largest number of bits of a number before it is multiplied. Its magnitude must be below 2^48.
pub const FACTOR_BITS: u32 = 63 - LEFT;

impl<S: SimdOps> Vector<S> {
    #[inline(always)]
    fn with(self, bits: S::u64s) -> Self {
        Self { bits, ..self }
    }
}

impl<S: SimdOps> Add for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.with(self.simd.add_u64s(self.bits, other.bits))
    }
}

impl<S: SimdOps> Sub for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.with(self.simd.sub_u64s(self.bits, other.bits))
    }
}

impl<S: SimdOps> Shl<u32> for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn shl(self, by: u32) -> Self {
        self.with(self.simd.shift_left(self.bits, self.simd.splat_u64s(by.into())))
    }
}

impl<S: SimdOps> Shr<u32> for Vector<S> {
    type Output = Self;

    #[inline(always)]
    fn shr(self, by: u32) -> Self {
        self.with(self.simd.signed_shift_right(self.bits, self.simd.splat_u64s(by.into())))
    }
}

impl<S: SimdOps> Word for Vector<S> {
    type Gain = LaneGain<S>;
    type Factor = LaneFactor<S>;
    type Fraction = Self;

    #[inline(always)]
    fn clamped(self, _: i64) -> Self {
        self
    }

    #[inline(always)]
    fn times(self, gain: LaneGain<S>) -> Self {
        let simd = self.simd;
        let low = (self << LEFT).bits;
        let high = simd.product(gain.mantissa, simd.shift_right(low, simd.splat_u64s(32)));
        let low = simd.unsigned_product(gain.mantissa, low);
        let carried = simd.add_u64s(high, simd.shift_right(low, simd.splat_u64s(32)));
        self.with(simd.signed_shift_right(simd.add_u64s(carried, gain.half), gain.shift))
    }

    #[inline(always)]
    fn part(self, factor: LaneFactor<S>, _: u8) -> Self {
        let simd = self.simd;
        let low = simd.add_u64s(self.bits, simd.splat_u64s(PLUS));
        let low = simd.shift_left(low, simd.splat_u64s(LEFT.into()));
        let high =
            simd.unsigned_product(factor.mantissa, simd.shift_right(low, simd.splat_u64s(32)));
        let low = simd.unsigned_product(factor.mantissa, low);
        let product = simd.add_u64s(high, simd.shift_right(low, simd.splat_u64s(32)));
        self.with(simd.sub_u64s(simd.shift_right(product, factor.shift), factor.less))
    }

    #[inline(always)]
    fn saturating(self, other: Self) -> Self {
        self + other
    }

    #[inline(always)]
    fn rounded(self, bits: u32) -> Self {
        let half = self.simd.splat_u64s(1 << (bits - 1));
        self.with(self.simd.add_u64s(self.bits, half)) >> bits
    }

    #[inline(always)]
    fn plus(self, fraction: Self) -> Self {
        self + fraction
    }

    #[inline(always)]
    fn split(self) -> (Self, Self) {
        let low = self.simd.splat_u64s(u16::MAX.into());
        (self >> u16::BITS, self.with(self.simd.and_u64s(self.bits, low)))
    }
}
