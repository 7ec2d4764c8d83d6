//! Velocity estimators as transfer functions in z^-1.

use super::{LinearError, ORDER_MAX, SCHUR_ITERATIONS};
use crate::simulation::twin::{Equation, Foaw, LowPass};
use nalgebra::{Complex, DMatrix, Schur};
use zwidth::{
    Design, SettingsError, VelocitySettings,
    velocity::{ButterworthDesign, FirDesign, KalmanDesign, TrackingLoop},
};

/// A transfer function `(num[0] + num[1] z^-1 + ..) / (den[0] + den[1] z^-1 + ..)`. The unit of an estimator is m/s per
/// m = 1/s.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    /// Coefficients of the numerator, in ascending powers of z^-1.
    pub num: Vec<f64>,
    /// Coefficients of the denominator, in ascending powers of z^-1. `den[0]` is not 0.
    pub den: Vec<f64>,
}

impl TransferFunction {
    /// The difference of two samples divided by the time between them: `(1 - z^-1) rate`.
    #[must_use]
    pub fn finite_difference(rate_hz: f64) -> Self {
        Self { num: vec![rate_hz, -rate_hz], den: vec![1.0] }
    }

    /// The paper's estimator: a finite difference and a Butterworth low-pass of second order. The low-pass is not
    /// pre-warped.
    ///
    /// # Errors
    /// The core refuses the cutoff.
    pub fn paper(rate_hz: f64, cutoff_hz: f64) -> Result<Self, SettingsError> {
        let low_pass = LowPass::from(ButterworthDesign::new(cutoff_hz, rate_hz, false)?);
        Ok(Self::finite_difference(rate_hz).then(&low_pass.into()))
    }

    /// This transfer function in series with `next`.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self { num: multiply(&self.num, &next.num), den: multiply(&self.den, &next.den) }
    }

    /// Number of states: the number of past samples on which the output depends.
    #[must_use]
    pub fn order(&self) -> usize {
        self.num.len().max(self.den.len()).max(1) - 1
    }

    #[must_use]
    pub fn at(&self, z_inverse: Complex<f64>) -> Complex<f64> {
        polynomial(&self.num, z_inverse) / polynomial(&self.den, z_inverse)
    }

    /// Number of poles with |z| above a radius. If the poles cannot be computed, it is the number of all poles.
    pub(super) fn poles_beyond(&self, radius: f64) -> u32 {
        let order = self.den.len().saturating_sub(1);
        if order == 0 {
            return 0;
        }
        let companion = DMatrix::from_fn(order, order, |row, column| {
            if row == 0 {
                -self.den[column + 1] / self.den[0]
            } else if row == column + 1 {
                1.0
            } else {
                0.0
            }
        });
        let all = u32::try_from(order).unwrap_or(u32::MAX);
        Schur::try_new(companion, f64::EPSILON, SCHUR_ITERATIONS).map_or(all, |schur| {
            schur
                .complex_eigenvalues()
                .iter()
                .map(|z| u32::from(z.norm_sqr() > radius * radius))
                .sum()
        })
    }

    /// Checks whether the transfer function can be analysed.
    pub(super) fn check(&self) -> Result<(), LinearError> {
        let finite = self.num.iter().chain(&self.den).all(|c| c.is_finite());
        let leads = self.den.first().is_some_and(|lead| *lead != 0.0);
        if finite && leads && self.order() <= ORDER_MAX {
            Ok(())
        } else {
            Err(LinearError::Estimator)
        }
    }
}

impl From<LowPass> for TransferFunction {
    fn from(LowPass { b, a, order }: LowPass) -> Self {
        Self { num: b[..=order].to_vec(), den: [&[1.0], &a[..order]].concat() }
    }
}

/// Transfer function of the estimator from position to velocity, in m/s per m. `None` if the estimator is not linear,
/// or has inputs in addition to the position.
pub fn transfer_function(
    settings: &VelocitySettings,
    design: &Design,
) -> Result<Option<TransferFunction>, SettingsError> {
    use Equation::{Foaw, Fusion, Levant, Observer, TimeStamps};
    Ok(match Equation::of(settings, design)? {
        Observer(_) | Fusion(_) | TimeStamps(_) | Foaw(_) | Levant(_) => None,
        linear => response(linear, design.rate_hz)?,
    })
}

/// Response of the estimator to the position alone. For an observer, the known acceleration is 0. Adaptive windowing
/// uses its longest window. Time stamps have an edge in every sample. `None` for Levant's differentiator, which is not
/// linear anywhere.
pub fn position_response(
    settings: &VelocitySettings,
    design: &Design,
) -> Result<Option<TransferFunction>, SettingsError> {
    response(Equation::of(settings, design)?, design.rate_hz)
}

fn response(equation: Equation, rate_hz: f64) -> Result<Option<TransferFunction>, SettingsError> {
    let difference = TransferFunction::finite_difference(rate_hz);
    let sum = |design: &FirDesign| {
        difference.then(&TransferFunction { num: design.weights().to_vec(), den: vec![1.0] })
    };
    Ok(Some(match equation {
        Equation::LowPass(section) => difference.then(&section.into()),
        Equation::Cascade(sections) => {
            sections.into_iter().fold(difference, |before, section| before.then(&section.into()))
        }
        Equation::Sum(design) => sum(&design),
        Equation::Tracking(TrackingLoop { kp, ki, lead, .. }) => {
            let den = vec![1.0, kp + ki - 2.0, 1.0 - kp];
            difference.then(&TransferFunction { num: vec![ki * (1.0 + lead), -ki * lead], den })
        }
        Equation::Kalman(KalmanDesign { alpha, beta, gamma }) => {
            difference.then(&kalman([alpha, beta, gamma]))
        }
        // The same recursion, but with the disturbance instead of the acceleration.
        Equation::Observer(design) | Equation::Fusion(design) => {
            difference.then(&kalman(design.gains))
        }
        Equation::Foaw(Foaw { best: true, window, .. }) => {
            sum(&FirDesign::least_squares(1, window)?)
        }
        Equation::Ends(samples)
        | Equation::TimeStamps(samples)
        | Equation::Foaw(Foaw { window: samples, .. }) => ends(samples, rate_hz),
        Equation::Levant(_) => return Ok(None),
    }))
}

/// Transfer function from the difference to the velocity, for the core's recursion. With `q = z^-1`,
/// `v = (beta (1-q) + gamma q) / D` and `D = (1-q)^2 (1 - q + alpha q) + q (1-q) (beta + gamma/2) + gamma q^2`. With
/// gamma = 0 the factor `1 - q` cancels.
fn kalman([alpha, beta, gamma]: [f64; 3]) -> TransferFunction {
    let (num, den) = if gamma == 0.0 {
        (vec![beta], vec![1.0, alpha + beta - 2.0, 1.0 - alpha])
    } else {
        let slope = beta + gamma / 2.0;
        let den = vec![1.0, alpha - 3.0 + slope, 3.0 - 2.0 * alpha - slope + gamma, alpha - 1.0];
        (vec![beta, gamma - beta], den)
    };
    TransferFunction { num, den }
}

/// Mean speed of the handle over a window of `samples` samples: the motion from the first to the last sample, divided
/// by the time.
fn ends(samples: u32, rate_hz: f64) -> TransferFunction {
    let mut num = vec![0.0; samples as usize + 1];
    num[0] = rate_hz / f64::from(samples);
    num[samples as usize] = -num[0];
    TransferFunction { num, den: vec![1.0] }
}

/// Value of a polynomial with ascending coefficients, by Horner's method.
pub(super) fn polynomial(coefficients: &[f64], x: Complex<f64>) -> Complex<f64> {
    coefficients.iter().rev().fold(Complex::new(0.0, 0.0), |sum, c| sum * x + c)
}

fn multiply(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            product[i + j] += x * y;
        }
    }
    product
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use zwidth::velocity::{FirstOrder, true_cutoff_hz};

    use super::*;

    /// Tolerance of a few rounding errors. The golden values have 17 digits.
    const COEFFICIENT_TOLERANCE: f64 = 4.0 * f64::EPSILON;
    /// At the lowest cutoff, 1 + a1 + a2 has the rounding error of a1 and a2 relative to b0: 1e-16 / 6e-9.
    const HALF_POWER_TOLERANCE: f64 = 1e-6;

    fn rows(golden: &str) -> Vec<Vec<f64>> {
        let rows: Vec<Vec<f64>> = golden
            .lines()
            .skip(1)
            .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
            .collect();
        assert!(rows.len() > 150);
        rows
    }

    #[test]
    fn second_order_matches_scipy_and_mpmath() {
        let plain = include_str!("../../../../../tests/golden/butterworth.csv");
        let prewarped = include_str!("../../../../../tests/golden/butterworth_prewarped.csv");
        for (golden, prewarp) in [(plain, false), (prewarped, true)] {
            let mut used = 0;
            for row in rows(golden) {
                let (rate, cutoff) = (row[0], row[1]);
                let Ok(filter) = ButterworthDesign::new(cutoff, rate, prewarp) else {
                    continue; // the core refuses it
                };
                let filter = TransferFunction::from(LowPass::from(filter));
                used += 1;
                // Near half the sample rate, tan amplifies the rounding error of its argument.
                let tolerance = COEFFICIENT_TOLERANCE
                    * if prewarp && cutoff > 0.4 * rate { 100.0 } else { 1.0 };
                for (ours, exact) in filter.num.iter().chain(&filter.den[1..]).zip(&row[2..7]) {
                    assert!(
                        (ours - exact).abs() <= tolerance * exact.abs().max(filter.num[0]),
                        "{row:?}: {ours}"
                    );
                }
                if !prewarp {
                    assert!(
                        (true_cutoff_hz(cutoff, rate, false) - row[7]).abs()
                            <= COEFFICIENT_TOLERANCE * row[7]
                    );
                }
                assert!(
                    (power(&filter, row[7] / rate) - 0.5).abs() < HALF_POWER_TOLERANCE,
                    "{row:?}"
                );
            }
            assert!(used > 100, "{used}");
        }
    }

    fn power(filter: &TransferFunction, cycles_per_sample: f64) -> f64 {
        let w = 2.0 * PI * cycles_per_sample;
        filter.at(Complex::new(w.cos(), -w.sin())).norm_sqr()
    }

    #[test]
    fn a_damped_second_order_is_half_power_at_its_true_cutoff() {
        for (cutoff, quality) in [(1.0, 0.3), (100.0, 0.5), (1500.0, 0.55), (400.0, 2.0)] {
            let design = ButterworthDesign::damped(cutoff, quality, 1e4).unwrap();
            let filter = TransferFunction::from(LowPass::from(design));
            let settings = VelocitySettings::SecondOrder { cutoff_hz: cutoff, quality };
            let at = settings.true_cutoff_hz(1e4).unwrap();
            assert!((power(&filter, at / 1e4) - 0.5).abs() < HALF_POWER_TOLERANCE, "{cutoff} {at}");
        }
    }

    #[test]
    fn first_order_is_half_power_at_its_true_cutoff() {
        let first = |cutoff, prewarp| {
            TransferFunction::from(LowPass::from(FirstOrder::new(cutoff, 1e4, prewarp).unwrap()))
        };
        for cutoff in [1.0, 100.0, 2000.0, 4900.0] {
            let plain = first(cutoff, false);
            assert!(
                (power(&plain, true_cutoff_hz(cutoff, 1e4, false) / 1e4) - 0.5).abs()
                    < HALF_POWER_TOLERANCE
            );
            let warped = first(cutoff.min(3700.0), true);
            let at = cutoff.min(3700.0) / 1e4;
            assert!((power(&warped, at) - 0.5).abs() < HALF_POWER_TOLERANCE);
            assert!((power(&plain, 0.0) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn estimators_measure_a_ramp() {
        // The response to a ramp of 1 m/s is V(z) (z^-1 T) / (1 - z^-1)^2. So the final velocity is num / (1 - z^-1) at
        // z = 1.
        let estimator = TransferFunction::paper(1e4, 500.0).unwrap();
        let (mut x, mut y) = (vec![0.0; 4], vec![0.0; 4]);
        for n in 0..1000 {
            x.rotate_right(1);
            x[0] = f64::from(n) * 1e-4;
            let sum: f64 = estimator.num.iter().zip(&x).map(|(c, x)| c * x).sum();
            let past: f64 = estimator.den[1..].iter().zip(&y).map(|(c, y)| c * y).sum();
            y.rotate_right(1);
            y[0] = sum - past;
        }
        assert!((y[0] - 1.0).abs() < 1e-9, "{}", y[0]);
        assert_eq!(estimator.order(), 3);
    }
}
