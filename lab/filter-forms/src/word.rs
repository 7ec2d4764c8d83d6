//! Integer words of two sizes. The same source makes the 32-bit forms and the 16-bit forms of Q15. A signal or a
//! coefficient has one word. A sum or an integrator has a word of twice the size.

use core::{
    hint::cold_path,
    ops::{Add, BitAnd, Neg, Shl, Shr, Sub},
};

/// A word of twice the size, for sums of products. The forms are designed so that a plain sum does not overflow. A
/// right shift rounds towards minus infinity.
pub trait Wide:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Neg<Output = Self>
    + BitAnd<Output = Self>
    + Shl<u32, Output = Self>
    + Shr<u32, Output = Self>
{
    const ZERO: Self;
    const ONE: Self;
    /// The sum of both words. It saturates if it does not fit.
    fn clipped_add(self, other: Self) -> Self;
}

pub trait Word: Copy + PartialEq {
    type Wide: Wide;
    const BITS: u32;
    const ZERO: Self;
    fn wide(self) -> Self::Wide;
    /// The exact product, in a word of twice the size.
    fn times(self, other: Self) -> Self::Wide;
    /// Computes `self * other / 2^bits`, rounded to nearest. `bits` is at least 1 and below the bits of a word.
    fn times_wide(self, other: Self::Wide, bits: u32) -> Self::Wide;
    /// The word nearest to `value`.
    fn clipped(value: Self::Wide) -> Self;
    /// A whole number as a word. The number must fit into the word.
    fn of_f64(value: f64) -> Self;
}

macro_rules! word {
    ($word:ty, $wide:ty, $clip:expr, $times_wide:expr) => {
        impl Wide for $wide {
            const ZERO: Self = 0;
            const ONE: Self = 1;

            #[inline]
            fn clipped_add(self, other: Self) -> Self {
                self.saturating_add(other)
            }
        }

        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_lossless,
            clippy::unnecessary_cast,
            reason = "one source for two sizes; each narrowing is clipped before"
        )]
        impl Word for $word {
            type Wide = $wide;
            const BITS: u32 = <$word>::BITS;
            const ZERO: Self = 0;

            #[inline]
            fn wide(self) -> $wide {
                self.into()
            }

            #[inline]
            fn times(self, other: Self) -> $wide {
                self.wide() * other.wide()
            }

            #[inline]
            fn times_wide(self, other: $wide, bits: u32) -> $wide {
                let product: fn($word, $wide, u32) -> $wide = $times_wide;
                product(self, other, bits)
            }

            #[inline]
            fn clipped(value: $wide) -> Self {
                let clip: fn($wide) -> $word = $clip;
                clip(value)
            }

            fn of_f64(value: f64) -> Self {
                value as Self
            }
        }
    };
}

// Compiles to one instruction, SSAT.
word!(
    i16,
    i32,
    |value| value.clamp(i16::MIN.into(), i16::MAX.into()) as i16,
    |word, wide, bits| ((i64::from(word) * i64::from(wide) + (1 << (bits - 1))) >> bits) as i32
);
// Two products of 32-bit words, as in the core's multiplier. The sum of the two products is below 2^63 if |wide| is
// below 2^62.
word!(
    i32,
    i64,
    |value| i32::try_from(value).unwrap_or_else(|_| {
        cold_path(); // as in the core
        if value < 0 { i32::MIN } else { i32::MAX }
    }),
    |word, wide, bits| {
        let (high, low) = (wide >> 32, wide & 0xffff_ffff);
        let low = i64::from(word) * low + (1 << (bits - 1));
        ((i64::from(word) * high) << (32 - bits)) + (low >> bits)
    }
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_with_a_wide_word_is_rounded_to_the_nearest() {
        for (word, wide) in [
            (123_456_789, 987_654_321_987_654_321i64),
            (-123_456_789, 987_654_321_987_654_321),
            (i32::MIN, -1),
            (i32::MAX, i64::MIN / 4),
            (3, 5),
        ] {
            for bits in [1, 13, 30, 31] {
                let exact = i128::from(word) * i128::from(wide);
                let nearest = (exact + (1 << (bits - 1))) >> bits;
                if let Ok(nearest) = i64::try_from(nearest) {
                    assert_eq!(word.times_wide(wide, bits), nearest, "{word} {wide} {bits}");
                }
            }
        }
        assert_eq!((-3i16).times_wide(1 << 20, 14), -192);
        assert_eq!(1i16.times_wide(1 << 13, 14), 1, "half an LSB goes up");
        assert_eq!(1i16.times_wide((1 << 13) - 1, 14), 0);
    }
}
