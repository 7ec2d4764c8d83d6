/// A factor between 0 and 1, for values of 64 bits. It is `mantissa * 2^-(32 + shift)`, with 2^31 <= mantissa < 2^32.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factor {
    mantissa: u32,
    shift: u8,
}

impl Factor {
    /// Mantissa, from 2^31 to below 2^32.
    pub const fn mantissa(self) -> u32 {
        self.mantissa
    }

    /// Number of bits by which a product with the mantissa is shifted right, in addition to 32.
    pub const fn shift(self) -> u8 {
        self.shift
    }

    /// Multiplies `value` by the factor. The result has `bits` more fractional bits than `value`, at most 31. It is
    /// rounded down, and saturates at 2^62.
    #[inline]
    pub(super) fn apply(self, value: i64, bits: u8) -> i64 {
        let mantissa = i64::from(self.mantissa);
        // The product has 96 bits. It is high * 2^32 + (the low half of low).
        #[expect(clippy::cast_sign_loss, reason = "its low half")]
        let low = (value as u64 & 0xFFFF_FFFF) * u64::from(self.mantissa);
        #[expect(clippy::cast_possible_wrap, reason = "below 2^32")]
        let high = (value >> 32) * mantissa + (low >> 32) as i64;
        // value * mantissa / 2^(32 + shift - bits)
        if self.shift >= bits {
            return high >> (self.shift - bits).min(63);
        }
        let left = (bits - self.shift).min(31);
        let limit = 1i64 << (62 - left);
        let rest = (low & 0xFFFF_FFFF) >> (32 - left);
        #[expect(clippy::cast_possible_wrap, reason = "below 2^31")]
        let rest = rest as i64;
        (high.clamp(-limit, limit - 1) << left) + rest
    }

    /// Returns the factor nearest to a value between 2^-32 and 1.
    pub(super) fn of(value: f64) -> Self {
        // value = fraction * 2^exponent, 0.5 <= fraction < 1, exponent <= 0
        let (fraction, exponent) = libm::frexp(value);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturating: 2^31 to 2^32, and 0 to 32"
        )]
        Self { mantissa: libm::round(libm::scalbn(fraction, 32)) as u32, shift: -exponent as u8 }
    }
}
