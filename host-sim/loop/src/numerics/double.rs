//! Arithmetic with about 32 decimal digits.

use std::ops::{Add, Mul, Sub};

/// A number as the sum of two floats. The second float is at most half an LSB of the first float. The crate `twofloat`
/// has this type too, but it would add a second `syn` to every build.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Double {
    high: f64,
    low: f64,
}

impl From<f64> for Double {
    fn from(value: f64) -> Self {
        Self { high: value, low: 0.0 }
    }
}

impl From<Double> for f64 {
    fn from(value: Double) -> Self {
        value.high + value.low
    }
}

/// A sum and its rounding error (Knuth, "The Art of Computer Programming", vol. 2, 4.2.2, theorem B).
#[inline]
fn two_sum(a: f64, b: f64) -> Double {
    let high = a + b;
    let rounded = high - a;
    Double { high, low: (a - (high - rounded)) + (b - rounded) }
}

/// A sum and its rounding error, for `abs(a) >= abs(b)`.
#[inline]
fn quick_sum(a: f64, b: f64) -> Double {
    let high = a + b;
    Double { high, low: b - (high - a) }
}

/// A product and its rounding error. Both are computed from halves of 26 bits (Dekker, Numer. Math. 18, 1971).
#[inline]
fn two_product(a: f64, b: f64) -> Double {
    const HALVES: f64 = 134_217_729.0; // 2^27 + 1
    let split = |value: f64| {
        let shifted = HALVES * value;
        let high = shifted - (shifted - value);
        [high, value - high]
    };
    let high = a * b;
    let ([ah, al], [bh, bl]) = (split(a), split(b));
    Double { high, low: ((ah * bh - high) + ah * bl + al * bh) + al * bl }
}

impl Add for Double {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        let sum = two_sum(self.high, other.high);
        let low = two_sum(self.low, other.low);
        let sum = quick_sum(sum.high, sum.low + low.high);
        quick_sum(sum.high, sum.low + low.low)
    }
}

impl Sub for Double {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        self + Self { high: -other.high, low: -other.low }
    }
}

impl Mul for Double {
    type Output = Self;

    #[inline]
    fn mul(self, other: Self) -> Self {
        let product = two_product(self.high, other.high);
        let low = product.low + (self.high * other.low + self.low * other.high);
        quick_sum(product.high, low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_and_a_sum_keep_32_digits() {
        let y = Double::from(1.0 / 3.0);
        let third = y * (Double::from(2.0) - Double::from(3.0) * y);
        let one = third * Double::from(3.0) - Double::from(1.0);
        assert!(f64::from(one).abs() < 1e-31, "{one:?}");
        let tiny = Double::from(1e-20);
        assert_eq!(f64::from(Double::from(1.0) + tiny - Double::from(1.0)), 1e-20);
    }
}
