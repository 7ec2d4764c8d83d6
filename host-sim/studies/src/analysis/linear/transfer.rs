//! Velocity estimators as transfer functions in z^-1.

use super::{LinearError, ORDER_MAX, SCHUR_ITERATIONS};
use core::f64::consts::{PI, SQRT_2};
use nalgebra::{Complex, DMatrix, Schur};
use zwidth::{
    Design, SettingsError, VelocitySettings,
    velocity::{
        BiquadDesign, ButterworthDesign, CascadeDesign, FirDesign, KalmanDesign, ObserverDesign,
        TrackingLoop,
    },
};

/// Order of a Butterworth low-pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// `w / (s + w)`.
    First,
    /// `w^2 / (s^2 + sqrt(2) w s + w^2)`, the paper's eq. (1).
    Second,
}

/// `(num[0] + num[1] z^-1 + ..) / (den[0] + den[1] z^-1 + ..)`. As an estimator its unit is m/s per m = 1/s.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    /// Numerator, ascending powers of z^-1.
    pub num: Vec<f64>,
    /// Denominator, ascending powers of z^-1; `den[0]` is not 0.
    pub den: Vec<f64>,
}

impl TransferFunction {
    /// The difference of two samples over the time between them: `(1 - z^-1) rate`.
    #[must_use]
    pub fn finite_difference(rate_hz: f64) -> Self {
        Self { num: vec![rate_hz, -rate_hz], den: vec![1.0] }
    }

    /// Butterworth low-pass by the bilinear transform, DC gain 1. Without `prewarp` it is the paper's eq. (2) (with
    /// 2 sqrt(2) where that prints 2.8) and its -3 dB frequency lies below `cutoff_hz`: see [`zwidth::velocity::true_cutoff_hz`].
    /// 0 < cutoff_hz; with `prewarp` also below half the rate.
    #[must_use]
    pub fn butterworth(rate_hz: f64, cutoff_hz: f64, order: Order, prewarp: bool) -> Self {
        let w = if prewarp {
            2.0 * libm::tan(PI * cutoff_hz / rate_hz)
        } else {
            2.0 * PI * cutoff_hz / rate_hz
        };
        match order {
            Order::First => {
                let a0 = 2.0 + w;
                Self { num: vec![w / a0, w / a0], den: vec![1.0, (w - 2.0) / a0] }
            }
            Order::Second => {
                let a0 = 4.0 + 2.0 * SQRT_2 * w + w * w;
                let b0 = w * w / a0;
                let a1 = (2.0 * w * w - 8.0) / a0;
                Self {
                    num: vec![b0, 2.0 * b0, b0],
                    den: vec![1.0, a1, (4.0 - 2.0 * SQRT_2 * w + w * w) / a0],
                }
            }
        }
    }

    /// Finite difference followed by a Butterworth low-pass of second order, not pre-warped: the paper's estimator.
    #[must_use]
    pub fn paper(rate_hz: f64, cutoff_hz: f64) -> Self {
        Self::finite_difference(rate_hz).then(&Self::butterworth(
            rate_hz,
            cutoff_hz,
            Order::Second,
            false,
        ))
    }

    /// This one followed by another.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self { num: multiply(&self.num, &next.num), den: multiply(&self.den, &next.den) }
    }

    /// Number of past samples it depends on (states of a realisation).
    #[must_use]
    pub fn order(&self) -> usize {
        self.num.len().max(self.den.len()).max(1) - 1
    }

    #[must_use]
    pub fn at(&self, z_inverse: Complex<f64>) -> Complex<f64> {
        polynomial(&self.num, z_inverse) / polynomial(&self.den, z_inverse)
    }

    /// Number of poles with |z| above a radius; all of them if they cannot be computed.
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

    /// Says whether it can be analysed.
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

/// The estimator from position to velocity, m/s per m; `None` if it is not linear, or if it looks
/// at more than the position.
///
/// # Errors
/// A parameter is out of range.
pub fn transfer_function(
    settings: &VelocitySettings,
    design: &Design,
) -> Result<Option<TransferFunction>, SettingsError> {
    settings.build(design)?;
    let rate_hz = design.rate_hz;
    let difference = TransferFunction::finite_difference(rate_hz);
    let low_pass = |order, cutoff_hz, prewarp| {
        difference.then(&TransferFunction::butterworth(rate_hz, cutoff_hz, order, prewarp))
    };
    let poles = |TrackingLoop { kp, ki, lead, .. }: &TrackingLoop| {
        let den = vec![1.0, kp + ki - 2.0, 1.0 - kp];
        difference.then(&TransferFunction { num: vec![ki * (1.0 + lead), -ki * lead], den })
    };
    Ok(Some(match *settings {
        VelocitySettings::Butterworth { cutoff_hz } => low_pass(Order::Second, cutoff_hz, false),
        VelocitySettings::ButterworthPrewarped { cutoff_hz } => {
            low_pass(Order::Second, cutoff_hz, true)
        }
        VelocitySettings::FirstOrder { cutoff_hz } => low_pass(Order::First, cutoff_hz, false),
        VelocitySettings::FirstOrderPrewarped { cutoff_hz } => {
            low_pass(Order::First, cutoff_hz, true)
        }
        VelocitySettings::Difference {} => difference,
        VelocitySettings::SecondOrder { cutoff_hz, quality } => {
            let filter = ButterworthDesign::damped(cutoff_hz, quality, rate_hz)?;
            let ButterworthDesign { b0, a1, a2, .. } = filter;
            let num = vec![b0, 2.0 * b0, b0];
            difference.then(&TransferFunction { num, den: vec![1.0, a1, a2] })
        }
        VelocitySettings::Biquad { frequency_hz, damping, lead_s, zero } => {
            let filter = BiquadDesign::new(frequency_hz, damping, lead_s, zero, rate_hz)?;
            let [a1, a2] = filter.a;
            let den = vec![1.0, a1, a2];
            difference.then(&TransferFunction { num: filter.b.to_vec(), den })
        }
        VelocitySettings::Biquad2 {
            frequency_hz,
            damping,
            lead_s,
            zero,
            second_ratio,
            second_damping,
            second_lead_s,
            second_zero,
        } => {
            let cascade = CascadeDesign::new(
                [frequency_hz, damping, lead_s, zero],
                [second_ratio, second_damping, second_lead_s, second_zero],
                rate_hz,
            )?;
            cascade.sections.iter().fold(difference, |before, section| {
                let [a1, a2] = section.a;
                let den = vec![1.0, a1, a2];
                before.then(&TransferFunction { num: section.b.to_vec(), den })
            })
        }
        VelocitySettings::WindowDifference { window_samples } => ends(window_samples, rate_hz),
        VelocitySettings::TrackingLoop { bandwidth_hz } => {
            poles(&TrackingLoop::new(bandwidth_hz, rate_hz)?)
        }
        VelocitySettings::TrackingLead { bandwidth_hz, lead } => {
            poles(&TrackingLoop::led(bandwidth_hz, lead, rate_hz)?)
        }
        VelocitySettings::Smoothing { cutoff_hz, ratio } => {
            poles(&TrackingLoop::smoothing(cutoff_hz, ratio, rate_hz)?)
        }
        VelocitySettings::Kalman2 { acceleration_rms_m_per_s2 } => {
            kalman(&KalmanDesign::two_states(acceleration_rms_m_per_s2, design)?, &difference)
        }
        VelocitySettings::Kalman3 { jerk_rms_m_per_s3 } => {
            kalman(&KalmanDesign::three_states(jerk_rms_m_per_s3, design)?, &difference)
        }
        _ => {
            return Ok(settings.weights(design)?.map(|design| difference.then(&weights(&design))));
        }
    }))
}

/// What the estimator makes of the position when it knows nothing else: the observers with a known
/// acceleration of 0. Adaptive windowing with its longest window in use, time stamps with an edge in
/// every sample. `None` for Levant's differentiator, which is linear nowhere.
///
/// # Errors
/// A parameter is out of range.
pub fn position_response(
    settings: &VelocitySettings,
    design: &Design,
) -> Result<Option<TransferFunction>, SettingsError> {
    settings.build(design)?;
    let rate_hz = design.rate_hz;
    let difference = TransferFunction::finite_difference(rate_hz);
    let observer = |design: ObserverDesign| {
        // the same recursion, its disturbance in the place of the acceleration
        let [alpha, beta, gamma] = design.gains;
        kalman(&KalmanDesign { alpha, beta, gamma }, &difference)
    };
    Ok(Some(match *settings {
        VelocitySettings::Observer { bandwidth_hz: hz, .. }
        | VelocitySettings::Fusion { crossover_hz: hz } => {
            observer(ObserverDesign::of_accelerometer(hz, rate_hz)?)
        }
        VelocitySettings::TimeStamps { span_samples } => ends(span_samples, rate_hz),
        VelocitySettings::FoawEnd { window_samples, .. } => ends(window_samples, rate_hz),
        VelocitySettings::FoawBest { window_samples, .. } => {
            difference.then(&weights(&FirDesign::least_squares(1, window_samples)?))
        }
        _ => return transfer_function(settings, design),
    }))
}

/// From the difference to the velocity, of the core's recursion (its module has it): with
/// `q = z^-1`, `v = (beta (1-q) + gamma q) / D` and
/// `D = (1-q)^2 (1 - q + alpha q) + q (1-q) (beta + gamma/2) + gamma q^2`; with gamma = 0 a factor
/// `1 - q` is common.
fn kalman(gains: &KalmanDesign, difference: &TransferFunction) -> TransferFunction {
    let KalmanDesign { alpha, beta, gamma } = *gains;
    let (num, den) = if gamma == 0.0 {
        (vec![beta], vec![1.0, alpha + beta - 2.0, 1.0 - alpha])
    } else {
        let slope = beta + gamma / 2.0;
        let den = vec![1.0, alpha - 3.0 + slope, 3.0 - 2.0 * alpha - slope + gamma, alpha - 1.0];
        (vec![beta, gamma - beta], den)
    };
    difference.then(&TransferFunction { num, den })
}

/// What the handle moved in so many samples over their time.
fn ends(samples: u32, rate_hz: f64) -> TransferFunction {
    let mut num = vec![0.0; samples as usize + 1];
    num[0] = rate_hz / f64::from(samples);
    num[samples as usize] = -num[0];
    TransferFunction { num, den: vec![1.0] }
}

fn weights(design: &FirDesign) -> TransferFunction {
    TransferFunction { num: design.weights().to_vec(), den: vec![1.0] }
}

/// Polynomial with ascending coefficients, by Horner.
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
    use zwidth::velocity::true_cutoff_hz;

    use super::*;

    /// A handful of roundings; the golden values carry 17 digits.
    const COEFFICIENT_TOLERANCE: f64 = 4.0 * f64::EPSILON;
    /// 1 + a1 + a2 is what the rounding of a1 and a2 leaves of b0 at the lowest cutoff: 1e-16 / 6e-9.
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
            for row in rows(golden) {
                let (rate, cutoff) = (row[0], row[1]);
                let filter = TransferFunction::butterworth(rate, cutoff, Order::Second, prewarp);
                // tan near half the rate amplifies the rounding of its argument.
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
        }
    }

    fn power(filter: &TransferFunction, cycles_per_sample: f64) -> f64 {
        let w = 2.0 * PI * cycles_per_sample;
        filter.at(Complex::new(w.cos(), -w.sin())).norm_sqr()
    }

    #[test]
    fn first_order_is_half_power_at_its_true_cutoff() {
        for cutoff in [1.0, 100.0, 2000.0, 4900.0] {
            let plain = TransferFunction::butterworth(1e4, cutoff, Order::First, false);
            assert!(
                (power(&plain, true_cutoff_hz(cutoff, 1e4, false) / 1e4) - 0.5).abs()
                    < HALF_POWER_TOLERANCE
            );
            let warped = TransferFunction::butterworth(1e4, cutoff, Order::First, true);
            assert!((power(&warped, cutoff / 1e4) - 0.5).abs() < HALF_POWER_TOLERANCE);
            assert!((power(&plain, 0.0) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn estimators_measure_a_ramp() {
        // A ramp of 1 m/s: V(z) (z^-1 T) / (1 - z^-1)^2, so the final velocity is the value of num / (1 - z^-1) at 1.
        let estimator = TransferFunction::paper(1e4, 500.0);
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
