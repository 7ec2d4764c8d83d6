//! The prototype of all variants: the core's Butterworth filter, with the coefficients of each form.
//!
//! ```text
//! w = 2 pi fc T,  k = sqrt(2),  a0 = 4 + 2 k w + w^2
//! direct         b0 = w^2 / a0, b1 = 2 b0, b2 = b0, a1 = (2 w^2 - 8) / a0, a2 = (4 - 2 k w + w^2) / a0
//! delta          alpha1 = 2 + a1 = (4 k w + 4 w^2) / a0,  alpha2 = 1 + a1 + a2 = 4 b0
//! state-variable g = w / 2,  d = 1 / (1 + g (g + k))
//! ```
//! The equations have no pre-warping: `g` is `w / 2` and not `tan(w / 2)`. Only `a1` and `a2` of the direct forms lose
//! digits by cancellation at low cutoffs. This loss is a property of the direct forms.

use core::f64::consts::{PI, SQRT_2};

/// The analog prototype at a sample rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prototype {
    /// `2 pi fc T`.
    pub w: f64,
}

impl Prototype {
    pub fn new(cutoff_hz: f64, rate_hz: f64) -> Self {
        Self { w: 2.0 * PI * cutoff_hz / rate_hz }
    }

    fn a0(&self) -> f64 {
        4.0 + 2.0 * SQRT_2 * self.w + self.w * self.w
    }

    /// `b0`, equal to `b2` and to half of `b1`.
    pub fn b0(&self) -> f64 {
        self.w * self.w / self.a0()
    }

    /// `a1` of `1 + a1 z^-1 + a2 z^-2`.
    pub fn a1(&self) -> f64 {
        (2.0 * self.w * self.w - 8.0) / self.a0()
    }

    /// `a2` of `1 + a1 z^-1 + a2 z^-2`.
    pub fn a2(&self) -> f64 {
        (4.0 - 2.0 * SQRT_2 * self.w + self.w * self.w) / self.a0()
    }

    /// `2 + a1`, computed without cancellation.
    pub fn alpha1(&self) -> f64 {
        4.0 * (SQRT_2 * self.w + self.w * self.w) / self.a0()
    }

    /// `1 + a1 + a2 = 4 b0`, computed without cancellation.
    pub fn alpha2(&self) -> f64 {
        4.0 * self.b0()
    }

    /// Gain `g = w / 2` of an integrator in the state-variable form.
    pub fn g(&self) -> f64 {
        0.5 * self.w
    }

    /// `1 / (1 + g (g + sqrt(2)))`.
    pub fn d(&self) -> f64 {
        1.0 / (1.0 + self.g() * (self.g() + SQRT_2))
    }

    /// The frequency at which the gain is -3 dB, as a fraction of the sample rate.
    pub fn true_cutoff(&self) -> f64 {
        // The formula of `zwidth` with a rate of 1.
        zwidth::velocity::true_cutoff_hz(self.w / (2.0 * PI), 1.0, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zwidth::velocity::ButterworthDesign;

    #[test]
    fn it_is_the_cores_filter() {
        for cutoff_hz in [0.35, 1.0, 20.0, 1500.0, 4990.0] {
            let ours = Prototype::new(cutoff_hz, 1e4);
            let core = ButterworthDesign::new(cutoff_hz, 1e4, false).unwrap();
            assert!((ours.b0() / core.b0 - 1.0).abs() < 1e-15);
            assert!((ours.a1() - core.a1).abs() < 1e-15 && (ours.a2() - core.a2).abs() < 1e-15);
            assert!((ours.alpha1() - (2.0 + core.a1)).abs() < 1e-15);
            assert!((ours.alpha2() - (1.0 + core.a1 + core.a2)).abs() < 1e-15);
        }
    }
}
