//! The exact filter's output: the state-variable form in double-double arithmetic, 32 digits.

use std::ops::{Add, Mul, Sub};

use filter_forms::Prototype;

/// A number as an unevaluated sum of two, the second below half an LSB of the first. (A crate for it, `twofloat`,
/// would bring a second `syn` into every build.)
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

/// Sum and its rounding error (Knuth, "The Art of Computer Programming", vol. 2, 4.2.2, theorem B).
#[inline]
fn two_sum(a: f64, b: f64) -> Double {
    let high = a + b;
    let rounded = high - a;
    Double { high, low: (a - (high - rounded)) + (b - rounded) }
}

/// The same for `abs(a) >= abs(b)`.
#[inline]
fn quick_sum(a: f64, b: f64) -> Double {
    let high = a + b;
    Double { high, low: b - (high - a) }
}

/// Product and its rounding error, by halves of 26 bits (Dekker, Numer. Math. 18, 1971).
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

/// A value near `start` at which `error` is 0, by Newton's method: `next` makes one step.
fn improved(start: f64, next: impl Fn(Double) -> Double) -> Double {
    (0..3).fold(start.into(), |value, _| next(value))
}

/// The reference with its state.
#[derive(Clone, Copy, Debug)]
pub struct Reference {
    g: Double,
    d: Double,
    s: [Double; 2],
}

impl Reference {
    /// At rest.
    pub fn new(cutoff_hz: f64, rate_hz: f64) -> Self {
        // w is a number of 53 bits for all variants; from there on it is exact
        let g = Double::from(Prototype::new(cutoff_hz, rate_hz).g());
        let [one, two, half] = [1.0, 2.0, 0.5].map(Double::from);
        // 1/sqrt(2) and 1/(1 + g (g + sqrt(2))): y (3 - 2 y^2) / 2 and y (2 - q y)
        let root = improved(0.5f64.sqrt(), |y| half * y * (Double::from(3.0) - two * y * y));
        let q = one + g * (g + two * root);
        let d = improved(1.0 / f64::from(q), |y| y * (two - q * y));
        Self { g, d, s: [0.0.into(); 2] }
    }

    /// The output for an input in counts per sample.
    #[inline]
    pub fn step(&mut self, x: f64) -> f64 {
        let [s1, s2] = self.s;
        let v = self.d * (self.g * (Double::from(x) - s2) + s1);
        let y = self.g * v + s2;
        self.s = [v + v - s1, y + y - s2];
        y.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_and_a_sum_keep_32_digits() {
        let third = improved(1.0 / 3.0, |y| y * (Double::from(2.0) - Double::from(3.0) * y));
        let one = third * Double::from(3.0) - Double::from(1.0);
        assert!(f64::from(one).abs() < 1e-31, "{one:?}");
        let tiny = Double::from(1e-20);
        assert_eq!(f64::from(Double::from(1.0) + tiny - Double::from(1.0)), 1e-20);
    }

    /// b0 = w^2 / a0 comes first; the sum of the impulse response is 1.
    #[test]
    fn its_impulse_response_begins_with_b0_and_has_the_sum_1() {
        let mut reference = Reference::new(1e4 / (2.0 * std::f64::consts::PI), 1e4);
        let outputs: Vec<f64> =
            (0..400).map(|n| reference.step(if n == 0 { 1.0 } else { 0.0 })).collect();
        assert!((outputs[0] - 1.0 / (5.0 + 8f64.sqrt())).abs() < 1e-16, "{}", outputs[0]);
        let sum: f64 = outputs.iter().sum();
        assert!((sum - 1.0).abs() < 1e-15, "{sum}");
    }

    /// Far below the cutoff `f64` loses digits that this keeps: after a step the output ends at 1.
    #[test]
    fn at_the_lowest_cutoff_a_step_ends_at_1() {
        let mut reference = Reference::new(0.1, 1e4);
        let last = (0..1_000_000).map(|_| reference.step(1.0)).last().unwrap();
        assert!((last - 1.0).abs() < 1e-15, "{last}");
    }
}
