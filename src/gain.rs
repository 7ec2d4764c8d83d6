//! A positive factor with a mantissa and a shift. Its relative precision is equal over the whole range of wall gains.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

/// A factor >= 0. Its value is `mantissa * 2^-shift`. The mantissa is normalised: 2^30 <= mantissa < 2^31, or 0. A
/// negative shift is a left shift. With a coarse encoder and a weak motor, one count of penetration may demand many
/// times full scale. Such a gain needs a left shift.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Gain {
    mantissa: i32,
    shift: i8,
}

impl Gain {
    /// Largest magnitude that [`apply`](Self::apply) returns. The sum of two such products does not overflow.
    pub const PRODUCT_LIMIT: i64 = 1 << 61;
    /// Largest right shift. A larger one would lose the mantissa's normalisation.
    const SHIFT_MAX: i32 = 62;
    /// Largest left shift, with a negative sign. A larger one leaves no room for a mantissa.
    const SHIFT_MIN: i32 = -23;

    /// Returns the gain nearest to `value`, with a relative error of at most 2^-31. Zero is exact. Returns `None` if
    /// `value` is negative, not finite or outside 2^-32 .. 2^54.
    #[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
    pub fn from_f64(value: f64) -> Option<Self> {
        if value == 0.0 {
            return Some(Self::default());
        }
        if !value.is_finite() || value < 0.0 {
            return None;
        }
        // libm: value = fraction * 2^exponent with 0.5 <= fraction < 1
        let (fraction, exponent) = libm::frexp(value);
        let rounded = libm::round(libm::scalbn(fraction, 31));
        let (mantissa, exponent) = if rounded >= libm::scalbn(1.0, 31) {
            (rounded / 2.0, exponent + 1)
        } else {
            (rounded, exponent)
        };
        let shift = 31 - exponent;
        if !(Self::SHIFT_MIN..=Self::SHIFT_MAX).contains(&shift) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, reason = "in range by the checks above")]
        Some(Self { mantissa: mantissa as i32, shift: shift as i8 })
    }

    /// The mantissa. It lies from 2^30 to below 2^31, or is 0.
    pub const fn mantissa(self) -> i32 {
        self.mantissa
    }

    /// Number of bits by which a product with the mantissa is shifted right. A negative number shifts left.
    pub const fn shift(self) -> i8 {
        self.shift
    }

    /// The factor as a float, exact.
    pub fn as_f64(self) -> f64 {
        libm::scalbn(f64::from(self.mantissa), -i32::from(self.shift))
    }

    /// Multiplies `value` by the gain. The product is rounded to nearest and limited to
    /// +-[`PRODUCT_LIMIT`](Self::PRODUCT_LIMIT).
    #[inline]
    pub fn apply(self, value: i32) -> i64 {
        let product = i64::from(self.mantissa) * i64::from(value); // at most 2^62
        if self.shift > 0 {
            let half = 1i64 << (self.shift - 1);
            let rounded = (product + half) >> self.shift; // at most 2^62 + 2^61 before the shift
            rounded.clamp(-Self::PRODUCT_LIMIT, Self::PRODUCT_LIMIT)
        } else {
            let bound = Self::PRODUCT_LIMIT >> self.shift.unsigned_abs();
            product.clamp(-bound, bound) << self.shift.unsigned_abs()
        }
    }

    /// Like [`apply`](Self::apply), but for a value of 64 bits.
    #[inline]
    pub(crate) fn apply_wide(self, value: i64) -> i64 {
        if self.shift < 1 {
            // The gain is 2^30 or more here. With a value of more than 32 bits the product reaches its limit anyway.
            let narrow = value.clamp(i64::from(i32::MIN), i64::from(i32::MAX));
            #[expect(clippy::cast_possible_truncation, reason = "clamped in the line above")]
            return self.apply(narrow as i32);
        }
        let shift = u32::from(self.shift.unsigned_abs());
        // the product is high * 2^32 + low, 0 <= low < 2^32
        let low = (value & 0xFFFF_FFFF) * i64::from(self.mantissa); // below 2^63
        let high = (value >> 32) * i64::from(self.mantissa) + (low >> 32); // at most 2^62 + 2^31
        let low = low & 0xFFFF_FFFF;
        let product = if shift > 32 {
            (high + (1i64 << (shift - 33))) >> (shift - 32)
        } else {
            let bound = Self::PRODUCT_LIMIT >> (32 - shift);
            if high >= bound {
                Self::PRODUCT_LIMIT
            } else if high < -bound {
                -Self::PRODUCT_LIMIT
            } else {
                (high << (32 - shift)) + ((low + (1i64 << (shift - 1))) >> shift)
            }
        };
        product.clamp(-Self::PRODUCT_LIMIT, Self::PRODUCT_LIMIT)
    }
}

#[cfg(test)]
impl Gain {
    /// Every shift of a gain that is not 0.
    #[expect(clippy::cast_possible_truncation, reason = "-23 to 62")]
    pub(crate) const SHIFTS: core::ops::RangeInclusive<i8> =
        Self::SHIFT_MIN as i8..=Self::SHIFT_MAX as i8;

    pub(crate) const fn from_parts(mantissa: i32, shift: i8) -> Self {
        Self { mantissa, shift }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Largest relative error of a gain. Only 2^-20 is needed, so the format is far more precise than that.
    const RELATIVE_ERROR_MAX: f64 = 1.0 / (1u64 << 31) as f64;

    #[test]
    fn ends_of_the_range_are_exact_or_refused() {
        for exponent in -31..=53 {
            let value = libm::scalbn(1.0, exponent);
            assert_eq!(Gain::from_f64(value).unwrap().as_f64(), value, "2^{exponent}");
        }
        for bad in [libm::scalbn(1.0, 54), libm::scalbn(1.0, -33), -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(Gain::from_f64(bad), None, "{bad}");
        }
        assert_eq!(Gain::from_f64(0.0).unwrap().apply(i32::MAX), 0);
    }

    #[test]
    fn rounding_up_to_the_next_power_of_two_keeps_the_mantissa_normalised() {
        let value = 2.0 - f64::EPSILON;
        assert_eq!(Gain::from_f64(value).unwrap(), Gain { mantissa: 1 << 30, shift: 29 });
    }

    #[test]
    fn products_round_to_nearest_and_saturate() {
        let half = Gain::from_f64(0.5).unwrap();
        assert_eq!((half.apply(3), half.apply(-3), half.apply(4)), (2, -1, 2));
        let huge = Gain::from_f64(libm::scalbn(1.0, 53)).unwrap();
        assert_eq!(huge.apply(1), 1 << 53);
        assert_eq!(huge.apply(i32::MAX), Gain::PRODUCT_LIMIT);
        assert_eq!(huge.apply(i32::MIN), -Gain::PRODUCT_LIMIT);
    }

    proptest! {
        #[test]
        fn products_are_within_half_an_lsb_or_saturated(
            exponent in -31.0..53.0f64, value in any::<i32>()
        ) {
            let factor = exponent.exp2();
            let gain = Gain::from_f64(factor).unwrap();
            prop_assert!((gain.as_f64() / factor - 1.0).abs() <= RELATIVE_ERROR_MAX);
            let limit = Gain::PRODUCT_LIMIT as f64;
            let exact = (gain.as_f64() * f64::from(value)).clamp(-limit, limit);
            let error = gain.apply(value) as f64 - exact;
            // Above 2^53 the reference in `f64` itself rounds.
            prop_assert!(error.abs() <= 0.5 + exact.abs() * f64::EPSILON, "{error}");
        }
    }

    proptest! {
        #[test]
        fn a_wide_product_is_rounded_and_saturated_like_one_in_128_bits(
            mantissa in (1i32 << 30)..=i32::MAX,
            shift in -23i8..=62,
            bits in any::<i64>(),
            narrower in 0u32..64,
        ) {
            let gain = Gain { mantissa, shift };
            let value = bits >> narrower;
            let product = i128::from(mantissa) * i128::from(value);
            let exact = if shift > 0 {
                (product + (1 << (shift - 1))) >> shift
            } else {
                product << -shift
            };
            let limit = i128::from(Gain::PRODUCT_LIMIT);
            let bound = limit - (limit >> (-i32::from(shift)).max(0) << (-i32::from(shift)).max(0));
            let off = i128::from(gain.apply_wide(value)) - exact.clamp(-limit, limit);
            prop_assert!(off.abs() <= bound, "{off}");
        }
    }
}
