//! A number of 64 bits, or a vector of such numbers. The simulator computes some estimators for many hits at once, in
//! vectors. The code of these estimators uses this trait.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::ops::{Add, Shl, Shr, Sub};

use super::factor::Factor;
use crate::Gain;

/// A signed number of 64 bits, or a vector of them.
///
/// A vector may omit the clamping, if the caller notices when a number of the vector is near a limit.
pub trait Word:
    Copy + Add<Output = Self> + Sub<Output = Self> + Shl<u32, Output = Self> + Shr<u32, Output = Self>
{
    /// A factor. A vector has one for each of its numbers.
    type Gain: Copy;
    /// A factor below 1. A vector has one for each of its numbers.
    type Factor: Copy;
    /// A fraction of 16 bits without sign. A vector has one for each of its numbers.
    type Fraction: Copy;

    /// Returns the nearest number within `-limit..=limit`.
    #[must_use]
    fn clamped(self, limit: i64) -> Self;

    /// Returns the product with a gain, rounded to nearest. It saturates at +-[`Gain::PRODUCT_LIMIT`].
    #[must_use]
    fn times(self, gain: Self::Gain) -> Self;

    /// Returns the product with a factor. It has `bits` more fractional bits, at most 31. It is rounded down, and
    /// saturates at 2^62. The factor of a vector must have been made for this number of bits.
    #[must_use]
    fn part(self, factor: Self::Factor, bits: u8) -> Self;
    /// Returns the sum, which saturates at 64 bits.
    #[must_use]
    fn saturating(self, other: Self) -> Self;
    /// Returns the number without its last `bits` bits, rounded to nearest.
    #[must_use]
    fn rounded(self, bits: u32) -> Self;

    /// Returns the sum of the number and a fraction.
    #[must_use]
    fn plus(self, fraction: Self::Fraction) -> Self;

    /// Returns the number without its last 16 bits, rounded down, and these 16 bits.
    fn split(self) -> (Self, Self::Fraction);
}

impl Word for i64 {
    type Gain = Gain;
    type Factor = Factor;
    type Fraction = u16;

    #[inline]
    fn clamped(self, limit: i64) -> i64 {
        self.clamp(-limit, limit)
    }

    #[inline]
    fn times(self, gain: Gain) -> i64 {
        gain.apply_wide(self)
    }

    #[inline]
    fn part(self, factor: Factor, bits: u8) -> i64 {
        factor.apply(self, bits)
    }

    #[inline]
    fn saturating(self, other: i64) -> i64 {
        self.saturating_add(other)
    }

    #[inline]
    fn rounded(self, bits: u32) -> i64 {
        (self + (1 << (bits - 1))) >> bits
    }

    #[inline]
    fn plus(self, fraction: u16) -> i64 {
        self + i64::from(fraction)
    }

    #[inline]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the last 16 bits are what is asked for"
    )]
    fn split(self) -> (i64, u16) {
        (self >> u16::BITS, self as u16)
    }
}
