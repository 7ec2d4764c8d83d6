//! Computes the output of the exact filter. It is the state-variable form in double-double arithmetic, which has 32
//! digits.

use filter_forms::Prototype;

use crate::numerics::double::Double;

/// Finds the root of an equation near `start` by Newton's method. `next` makes one step of the method.
fn improved(start: f64, next: impl Fn(Double) -> Double) -> Double {
    (0..3).fold(start.into(), |value, _| next(value))
}

#[derive(Clone, Copy, Debug)]
pub struct Reference {
    g: Double,
    d: Double,
    s: [Double; 2],
}

impl Reference {
    pub fn new(cutoff_hz: f64, rate_hz: f64) -> Self {
        // All variants have the same `w`, an `f64`. From `w` on, the reference computes in double-double arithmetic.
        let g = Double::from(Prototype::new(cutoff_hz, rate_hz).g());
        let [one, two, half] = [1.0, 2.0, 0.5].map(Double::from);
        // 1/sqrt(2) and 1/(1 + g (g + sqrt(2))): y (3 - 2 y^2) / 2 and y (2 - q y)
        let root = improved(0.5f64.sqrt(), |y| half * y * (Double::from(3.0) - two * y * y));
        let q = one + g * (g + two * root);
        let d = improved(1.0 / f64::from(q), |y| y * (two - q * y));
        Self { g, d, s: [0.0.into(); 2] }
    }

    /// Advances the filter by one sample. Input and output are in counts per sample.
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

    /// The first output for an impulse is b0 = w^2 / a0. The sum of the impulse response is 1.
    #[test]
    fn its_impulse_response_begins_with_b0_and_has_the_sum_1() {
        let mut reference = Reference::new(1e4 / (2.0 * std::f64::consts::PI), 1e4);
        let outputs: Vec<f64> =
            (0..400).map(|n| reference.step(if n == 0 { 1.0 } else { 0.0 })).collect();
        assert!((outputs[0] - 1.0 / (5.0 + 8f64.sqrt())).abs() < 1e-16, "{}", outputs[0]);
        let sum: f64 = outputs.iter().sum();
        assert!((sum - 1.0).abs() < 1e-15, "{sum}");
    }

    /// Far below the cutoff `f64` loses digits, but the reference does not. After a step, its output ends at 1.
    #[test]
    fn at_the_lowest_cutoff_a_step_ends_at_1() {
        let mut reference = Reference::new(0.1, 1e4);
        let last = (0..1_000_000).map(|_| reference.step(1.0)).last().unwrap();
        assert!((last - 1.0).abs() < 1e-15, "{last}");
    }
}
