//! Design of the algebraic differentiators (Mboup, Join, Fliess, "Numerical differentiation with annihilators in noisy
//! environment", Numerical Algorithms 50(4), 2009): the derivative from integrals of the position over a window, by
//! operators that make the unknown initial values vanish.
//!
//! With the age `s` in parts of the window `W`, 0 now and 1 at its end, the minimal estimator of the first derivative is
//!
//! ```text
//! v(t) = y / W  integral over s of  (s^(kappa+1) (1-s)^(mu+1))'  x(t - W s),   y = (kappa+mu+3)! / ((kappa+1)! (mu+1)!)
//! ```
//!
//! The derivative in it is `-(kappa+mu+2) w(s) (s - m)`, with `w(s) = s^kappa (1-s)^mu` and its mean `m`: so this is
//! the slope of the straight line that fits `x` best under the weight `w` (degree 1). The affine estimator without delay
//! lies on the line through two minimal ones, those of `kappa` and `kappa + 1`, and is the slope now of the
//! parabola that fits best under `w` (degree 2; `N = 2`, `xi = 0` in the paper). A test holds both.
//!
//! **Discrete.** The fit itself is made at the samples, not the integral by a quadrature: sample `i = 0 .. window` stands
//! for its part of the time, `s = (i + 1/2) / (window + 1)`. So a constant speed comes out exactly, for degree 2 a
//! constant acceleration too, and with `kappa = mu = 0` the weights are those of
//! [`least_squares`](FirDesign::least_squares). `kappa` takes weight from the newest samples and `mu` from the oldest.
//!
//! Degree 1 is late by the mean age of its weights: half the window where `kappa = mu`, near
//! `(kappa+2) / (kappa+mu+4)` of it else. `kappa` ends at 2: at 4 a weight of a short parabola, which is carried on far
//! beyond the ages that count, would be above 2.

use core::ops::RangeInclusive;

use super::{
    history::{LENGTH, WINDOW_MAX},
    polynomial::FirDesign,
};
use crate::range::{SettingsError, within};

/// Accepted powers of the age in the weight.
pub const KAPPA: RangeInclusive<f64> = 0.0..=2.0;
/// Accepted powers of what is left of the window.
pub const MU: RangeInclusive<f64> = 0.0..=8.0;

impl FirDesign {
    /// Algebraic differentiator of degree 1 (minimal) or 2 (affine, without delay) over the last `window` differences,
    /// `degree` to [`WINDOW_MAX`], under the weight `s^kappa (1-s)^mu`.
    ///
    /// # Errors
    /// Names the parameter and its range.
    pub fn algebraic(degree: u32, window: u32, kappa: f64, mu: f64) -> Result<Self, SettingsError> {
        within("degree", f64::from(degree), 1.0..=2.0)?;
        let range = f64::from(degree)..=f64::from(WINDOW_MAX);
        within("window_samples", f64::from(window), range)?;
        within("kappa", kappa, KAPPA)?;
        within("mu", mu, MU)?;
        let samples = f64::from(window) + 1.0;
        let mut fit = [0.0; LENGTH + 1];
        let mut moments = [0.0; 2];
        for (i, weight) in (0..=window).zip(&mut fit) {
            let age = f64::from(i) + 0.5;
            let part = age / samples;
            *weight = libm::pow(part, kappa) * libm::pow(1.0 - part, mu);
            moments = [moments[0] + *weight, moments[1] + *weight * age];
        }
        // ages about their mean, where the line is orthogonal to the constant under the weight
        let mean = moments[1] / moments[0];
        let about = |i: u32| f64::from(i) + 0.5 - mean;
        let sum = |of: &dyn Fn(f64) -> f64| -> f64 {
            (0..=window).zip(&fit).map(|(i, weight)| weight * of(about(i))).sum()
        };
        let second = sum(&|u| u * u);
        // the parabola `u^2 - skew u - spread` is orthogonal to both
        let skew = sum(&|u| u * u * u) / second;
        let spread = second / moments[0];
        let curve = |u: f64| u * (u - skew) - spread;
        let bend = match degree {
            1 => 0.0,
            _ => (2.0 * about(0) - skew) / sum(&|u| curve(u) * curve(u)),
        };
        let mut weights = [0.0; LENGTH];
        let mut total = 0.0;
        for ((i, weight), place) in (0..window).zip(&fit).zip(&mut weights) {
            let u = about(i);
            total -= weight * (u / second + bend * curve(u));
            *place = total;
        }
        Ok(Self::of(weights.get(..window as usize).unwrap_or(&weights)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn weights(degree: u32, window: u32, kappa: f64, mu: f64) -> Vec<f64> {
        FirDesign::algebraic(degree, window, kappa, mu).unwrap().weights().to_vec()
    }

    fn close(ours: &[f64], theirs: &[f64], within: f64) {
        assert_eq!(ours.len(), theirs.len());
        for (a, b) in ours.iter().zip(theirs) {
            assert!((a - b).abs() < within, "{a} {b}");
        }
    }

    #[test]
    fn without_a_weight_it_is_the_least_squares_fit() {
        for degree in 1..=2 {
            for window in degree..=WINDOW_MAX {
                let fit = FirDesign::least_squares(degree, window).unwrap();
                close(&weights(degree, window, 0.0, 0.0), fit.weights(), 1e-12);
            }
        }
    }

    /// The kernel of the minimal estimator, `s^(kappa+1) (1-s)^(mu+1)` over its integral, weighs the velocities: a long
    /// window comes near it, and is as late as its mean.
    #[test]
    fn a_long_window_is_the_minimal_estimator() {
        for (kappa, mu) in [(0i32, 0i32), (1, 1), (2, 3), (0, 4)] {
            let factorial = |n: i32| -> f64 { (1..=n).map(f64::from).product() };
            let scale = factorial(kappa + mu + 3) / (factorial(kappa + 1) * factorial(mu + 1));
            let ours = weights(1, 64, f64::from(kappa), f64::from(mu));
            let mut late = 0.0;
            for (i, ours) in (0u8..).zip(&ours) {
                let s = (f64::from(i) + 1.0) / 65.0; // between two samples
                let kernel = scale * s.powi(kappa + 1) * (1.0 - s).powi(mu + 1) / 65.0;
                assert!((ours - kernel).abs() < 4e-4, "{kappa} {mu} {i}: {ours} {kernel}");
                late += ours * (f64::from(i) + 0.5);
            }
            let stated = 64.0 * f64::from(kappa + 2) / f64::from(kappa + mu + 4);
            assert!((late - stated).abs() < 0.6, "{kappa} {mu}: {late} {stated}");
            assert!(kappa != mu || (late - 32.0).abs() < 1e-9, "{late}");
        }
    }

    #[test]
    fn the_affine_estimator_is_on_the_line_through_two_minimal_ones_and_follows_a_parabola() {
        for window in [3, 5, 16, 64] {
            for (kappa, mu) in [(0.0, 0.0), (1.0, 1.0), (0.5, 2.0)] {
                let affine = weights(2, window, kappa, mu);
                let [one, other] = [kappa, kappa + 1.0].map(|kappa| weights(1, window, kappa, mu));
                let late = |g: &[f64]| -> f64 {
                    (0u8..).zip(g).map(|(age, g)| g * (f64::from(age) + 0.5)).sum()
                };
                // where the delay vanishes
                let part = late(&one) / (late(&one) - late(&other));
                let line: Vec<f64> =
                    one.iter().zip(&other).map(|(a, b)| a + part * (b - a)).collect();
                close(&affine, &line, 1e-10);
                assert!(
                    late(&affine).abs() < 1e-10 && (affine.iter().sum::<f64>() - 1.0).abs() < 1e-12
                );
            }
        }
    }

    /// What [`FirDesign::quantise`] takes; the largest sum is within 64 bits as that of any weights below 2.
    #[test]
    fn every_weight_is_below_two_and_what_is_out_of_range_is_refused_by_name() {
        let ends = |range: &RangeInclusive<f64>| [*range.start(), 1.0, *range.end()];
        let mut largest = 0f64;
        for degree in 1..=2 {
            for window in degree..=WINDOW_MAX {
                for (kappa, mu) in
                    ends(&KAPPA).into_iter().flat_map(|k| ends(&MU).map(|mu| (k, mu)))
                {
                    let design = FirDesign::algebraic(degree, window, kappa, mu).unwrap();
                    let most = design.weights().iter().fold(0f64, |most, g| most.max(g.abs()));
                    largest = largest.max(most);
                    let sum: i64 = design.quantise().weights().iter().map(|g| i64::from(*g)).sum();
                    assert_eq!(sum, 1 << 30, "{degree} {window} {kappa} {mu}");
                }
            }
        }
        assert!((1.0..1.6).contains(&largest), "{largest}");
        for (degree, window, kappa, mu, parameter) in [
            (3, 9, 1.0, 1.0, "degree"),
            (2, 1, 1.0, 1.0, "window_samples"),
            (1, 65, 1.0, 1.0, "window_samples"),
            (1, 9, -0.1, 1.0, "kappa"),
            (1, 9, 2.1, 1.0, "kappa"),
            (1, 9, f64::NAN, 1.0, "kappa"),
            (1, 9, 1.0, 8.1, "mu"),
        ] {
            let refused = FirDesign::algebraic(degree, window, kappa, mu).unwrap_err();
            assert_eq!(refused.parameter, parameter);
        }
    }
}
