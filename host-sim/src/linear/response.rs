//! Frequency response of the open loop at the output instants.
//!
//! From the force computed at an output instant to the position and the estimated velocity at the output
//! instants: Hx(z) and Hv(z), z = one output period. Everything is written in `delta = z - 1` with the exact
//! `phi - 1`, because at low frequency that is where the digits are.
//!
//! With `E = phi - 1` over one period, and the period's force made of the previous command (b) up to the
//! latency's rest and of the present one (a) after it:
//! ```text
//! D = det(delta - E),  n = adj(delta - E) (gamma_a + gamma_b / z)
//! Hx = z^-q n_x / D,   q whole periods of latency
//! x at sample i of the period = (phi(i T) n)_x / D + a_i + b_i / z    (times z^-q)
//! ```
//! The estimator sees the samples `x_i z^n`, a sum of the aliases `exp(j (w + 2 pi l) / period)`, and answers
//! each with its own transfer function.

use super::transfer::TransferFunction;
use super::{LinearError, Loop};
use crate::exact::{Increment, oscillator_increment};
use core::f64::consts::TAU;
use nalgebra::Complex;

/// The curve along which a root lies on the unit circle, at one frequency: `K = -(inverse + B velocity)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    /// Radians per output period.
    pub(super) omega: f64,
    /// 1 / Hx, N/m.
    pub(super) inverse: Complex<f64>,
    /// Hv / Hx, 1/s.
    pub(super) velocity: Complex<f64>,
}

impl Point {
    /// The stiffness, complex off the crossings, that puts a root at this frequency.
    pub(super) fn stiffness(&self, damping: f64) -> Complex<f64> {
        -(self.inverse + self.velocity * damping)
    }
}

/// Response of position at one sample within a period: to the state (x, v) at its start and to the two forces.
#[derive(Clone, Copy, Debug)]
struct Sample {
    x: f64,
    v: f64,
    now: f64,
    before: f64,
}

/// The open loop, ready to be evaluated.
#[derive(Clone, Debug)]
pub(super) struct Response {
    less: [[f64; 2]; 2],
    now: [f64; 2],
    before: [f64; 2],
    mass: f64,
    /// Whole output periods of latency.
    pub(super) late: usize,
    samples: Vec<Sample>,
    estimator: TransferFunction,
}

/// Adds the identity's part: (phi z).
fn through(step: &Increment, z: [f64; 2]) -> [f64; 2] {
    let [[a, b], [c, d]] = step.phi_minus_one;
    [z[0] + a * z[0] + b * z[1], z[1] + c * z[0] + d * z[1]]
}

impl Response {
    pub(super) fn new(of: &Loop) -> Result<Self, LinearError> {
        of.check()?;
        let mass = of.device.mass_kg;
        let (w2, d) = (of.device.stiffness_n_per_m / mass, of.device.damping_n_s_per_m / mass);
        let step = |samples: f64| oscillator_increment(w2, d, samples * of.sample_s());
        let (late, rest) = of.split_latency();
        let period = f64::from(of.period);
        // Forces up to `at` samples into the period: the present command, the previous one.
        let forces = |at: f64| {
            if at <= rest {
                ([0.0, 0.0], step(at).gamma)
            } else {
                let after = step(at - rest);
                (after.gamma, through(&after, step(rest).gamma))
            }
        };
        let (now, before) = forces(period);
        let samples = (0..of.period)
            .map(|i| {
                let i = f64::from(i);
                let [[less, v], _] = step(i).phi_minus_one;
                let (now, before) = forces(i);
                Sample { x: 1.0 + less, v, now: now[0], before: before[0] }
            })
            .collect();
        let less = step(period).phi_minus_one;
        Ok(Self { less, now, before, mass, late, samples, estimator: of.estimator.clone() })
    }

    /// At z = exp(j omega).
    pub(super) fn at(&self, omega: f64) -> Point {
        self.at_radius(omega, 0.0)
    }

    /// At z = (1 + outside) exp(j omega).
    pub(super) fn at_radius(&self, omega: f64, outside: f64) -> Point {
        let (sin, half) = (libm::sin(omega), libm::sin(0.5 * omega));
        let delta = Complex::new(-2.0 * half * half, sin); // exp(j omega) - 1 without cancellation
        let delta = delta + (delta + 1.0) * outside;
        let z_inverse = (delta + 1.0).inv();
        let [[e11, e12], [e21, e22]] = self.less;
        let determinant = delta * (delta - (e11 + e22)) + (e11 * e22 - e12 * e21);
        let gamma = [0, 1].map(|row| z_inverse * self.before[row] + self.now[row]);
        let x = (delta - e22) * gamma[0] + gamma[1] * e12;
        let v = (delta - e11) * gamma[1] + gamma[0] * e21;
        let inverse = determinant * self.mass
            / x
            / z_inverse.powu(u32::try_from(self.late).unwrap_or(u32::MAX));
        let velocity = if self.samples.len() == 1 {
            self.estimator.at(z_inverse)
        } else {
            self.lifted(omega, outside, z_inverse, [x, v], determinant) / x
        };
        Point { omega, inverse, velocity }
    }

    /// Estimated velocity at the output instants for the state `start`, all times `determinant`.
    fn lifted(
        &self,
        omega: f64,
        outside: f64,
        z_inverse: Complex<f64>,
        start: [Complex<f64>; 2],
        determinant: Complex<f64>,
    ) -> Complex<f64> {
        let positions: Vec<Complex<f64>> = self
            .samples
            .iter()
            .map(|s| start[0] * s.x + start[1] * s.v + determinant * (z_inverse * s.before + s.now))
            .collect();
        #[expect(clippy::cast_precision_loss, reason = "at most PERIOD_MAX")]
        let period = positions.len() as f64;
        let shrink = libm::pow(1.0 + outside, -1.0 / period);
        let mut velocity = Complex::new(0.0, 0.0);
        for alias in 0..positions.len() {
            #[expect(clippy::cast_precision_loss, reason = "at most PERIOD_MAX")]
            let angle = (omega + TAU * alias as f64) / period;
            let back = Complex::new(libm::cos(angle), -libm::sin(angle)) * shrink;
            let share =
                positions.iter().rev().fold(Complex::new(0.0, 0.0), |sum, x| sum * back + x);
            velocity += share * self.estimator.at(back);
        }
        velocity / period
    }
}
