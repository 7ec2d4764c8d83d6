//! Frequency response of the open loop at the output instants.
//!
//! Hx(z) and Hv(z) are the responses of position and estimated velocity to the force, all at the output instants. `z`
//! is a shift by one output period. The matrix `phi(t)` advances the plant's state by the time t without a force. All
//! equations use `delta = z - 1` and the exact `phi - 1`, which keep the digits at low frequency.
//!
//! `E` is `phi - 1` for one output period. The latency has q whole periods and a rest. Within a period, the previous
//! command (b) acts during the rest. Then the present command (a) acts. `gamma_a` and `gamma_b` are the responses of
//! the state to these commands at the end of the period. `a_i` and `b_i` are the responses of the position at sample i:
//! ```text
//! D = det(delta - E),  n = adj(delta - E) (gamma_a + gamma_b / z)
//! Hx = z^-q n_x / D,   q whole periods of latency
//! x at sample i of the period = (phi(i T) n)_x / D + a_i + b_i / z    (times z^-q)
//! ```
//! A plant with more states uses the same equations. For this plant, `n = (delta - E)^-1 (..)` comes from a matrix
//! decomposition instead of adjugate and determinant.
//!
//! The inputs of the estimator are the samples `x_i z^n`. These samples are a sum of the aliases `exp(j (w + 2 pi l) /
//! period)`. The estimator's transfer function applies to each alias.

use super::{LinearError, Loop, acting::Acting, transfer::TransferFunction};
use crate::{
    numerics::exact::{Increment, oscillator_increment},
    scene::element::Chain,
};
use core::f64::consts::{PI, TAU};
use nalgebra::{Complex, DMatrix, DVector, Schur};

/// A frequency, and the curve's values there. On the curve `K = -(inverse + B velocity)` a root lies on the unit
/// circle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    /// Frequency in radians per output period.
    pub(super) omega: f64,
    /// The value 1 / Hx, in N/m.
    pub(super) inverse: Complex<f64>,
    /// The value Hv / Hx, in 1/s.
    pub(super) velocity: Complex<f64>,
}

impl Point {
    /// The stiffness that gives a root at this frequency. The stiffness is complex except at a crossing.
    pub(super) fn stiffness(&self, damping: f64) -> Complex<f64> {
        -(self.inverse + self.velocity * damping)
    }
}

/// Response of the position at one sample within a period. One part comes from the state (x, v) at the start of the
/// period. Each of the two forces gives another part.
#[derive(Clone, Copy, Debug)]
struct Sample {
    x: f64,
    v: f64,
    now: f64,
    before: f64,
}

#[derive(Clone, Debug)]
struct Alone {
    less: [[f64; 2]; 2],
    now: [f64; 2],
    before: [f64; 2],
    mass: f64,
    samples: Vec<Sample>,
}

/// A device with linear elements. Speeds are in m per period, and the force is in m per period^2, so that the elements
/// of the matrix have similar sizes.
#[derive(Clone, Debug)]
struct Augmented {
    less: DMatrix<f64>,
    now: DVector<f64>,
    before: DVector<f64>,
    /// Response of the position at each sample: to the state at the start of the period, and to each of the two forces.
    samples: Vec<(DVector<f64>, f64, f64)>,
    /// Frequencies of the poles and zeros, in radians per output period. They are folded into 0 to pi.
    marks: Vec<f64>,
}

#[derive(Clone, Debug)]
enum Plant {
    Alone(Alone),
    Augmented(Augmented),
}

/// Three values: the positions at the samples of a period, the first of these positions, and `1 / Hx` times this first
/// position. The third leaves out the whole periods of latency.
type Positions = (Vec<Complex<f64>>, Complex<f64>, Complex<f64>);

/// The open loop, prepared for many frequencies.
#[derive(Clone, Debug)]
pub(super) struct Response {
    plant: Plant,
    /// The latency as a number of whole output periods.
    pub(super) late: usize,
    estimator: TransferFunction,
}

/// The product `phi z`. It is computed from `phi - 1`, plus the identity.
fn through(step: &Increment, z: [f64; 2]) -> [f64; 2] {
    let [[a, b], [c, d]] = step.phi_minus_one;
    [z[0] + a * z[0] + b * z[1], z[1] + c * z[0] + d * z[1]]
}

impl Alone {
    fn new(of: &Loop, rest: f64) -> Self {
        let mass = of.device.mass_kg;
        let (w2, d) = (of.device.stiffness_n_per_m / mass, of.device.damping_n_s_per_m / mass);
        let step = |samples: f64| oscillator_increment(w2, d, samples * of.sample_s());
        let period = f64::from(of.period);
        // Response to the present command and to the previous command, `at` samples after the start of the period.
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
        Self { less, now, before, mass, samples }
    }

    fn at(&self, delta: Complex<f64>, z_inverse: Complex<f64>) -> Positions {
        let [[e11, e12], [e21, e22]] = self.less;
        let determinant = delta * (delta - (e11 + e22)) + (e11 * e22 - e12 * e21);
        let gamma = [0, 1].map(|row| z_inverse * self.before[row] + self.now[row]);
        let x = (delta - e22) * gamma[0] + gamma[1] * e12;
        let v = (delta - e11) * gamma[1] + gamma[0] * e21;
        let position =
            |s: &Sample| x * s.x + v * s.v + determinant * (z_inverse * s.before + s.now);
        (self.samples.iter().map(position).collect(), x, determinant * self.mass)
    }
}

impl Augmented {
    fn new(of: &Loop, rest: f64) -> Self {
        let chain = of.chain();
        let (states, acting) = (chain.states(), Acting::of(&chain));
        let period = f64::from(of.period);
        let period_s = period * of.sample_s();
        let scale = DVector::from_fn(states, |row, _| {
            if states % 2 == 1 && row == states - 1 {
                period_s * period_s / of.device.mass_kg
            } else if row % 2 == 1 {
                period_s
            } else {
                1.0
            }
        });
        let step = |samples: f64| {
            let (less, gamma) = chain.increment(samples * of.sample_s());
            let less = DMatrix::from_fn(states, states, |r, c| less[(r, c)] * scale[r] / scale[c]);
            acting.reduce((less, gamma.component_mul(&scale)))
        };
        let forces = |at: f64| {
            if at <= rest {
                (DVector::zeros(acting.states()), step(at).1)
            } else {
                let (less, now) = step(at - rest);
                let start = step(rest).1;
                (now, &less * &start + start)
            }
        };
        let (now, before) = forces(period);
        let samples = (0..of.period)
            .map(|i| {
                let i = f64::from(i);
                let mut row = step(i).0.row(0).transpose();
                row[0] += 1.0;
                let (now, before) = forces(i);
                (row, now[0], before[0])
            })
            .collect();
        let marks = marks(&chain, period_s);
        Self { less: step(period).0, now, before, samples, marks }
    }

    fn at(&self, delta: Complex<f64>, z_inverse: Complex<f64>) -> Positions {
        let states = self.now.len();
        let matrix = DMatrix::from_fn(states, states, |row, column| {
            Complex::from(-self.less[(row, column)])
                + if row == column { delta } else { 0.0.into() }
        });
        let gamma = DVector::from_fn(states, |row, _| z_inverse * self.before[row] + self.now[row]);
        // Exactly at a pole, the response and all its parts are infinite.
        let state = matrix
            .lu()
            .solve(&gamma)
            .unwrap_or_else(|| DVector::from_element(states, f64::INFINITY.into()));
        let x = state[0];
        let positions = self.samples.iter().map(|(row, now, before)| {
            let start: Complex<f64> = row.iter().zip(state.iter()).map(|(r, z)| z * r).sum();
            start + z_inverse * before + now
        });
        (positions.collect(), x, 1.0.into())
    }
}

/// Frequencies at which the response of a chain changes fast: the poles and zeros of the chain. The zeros are the poles
/// of the chain while its device is held.
fn marks(chain: &Chain, period_s: f64) -> Vec<f64> {
    let a = chain.matrix();
    let held = a.clone().remove_rows(0, 2).remove_columns(0, 2);
    let eigenvalues = |matrix: DMatrix<f64>| {
        Schur::try_new(matrix, f64::EPSILON, super::SCHUR_ITERATIONS)
            .map(|schur| schur.complex_eigenvalues())
    };
    let all = [eigenvalues(a), eigenvalues(held)].into_iter().flatten();
    all.flat_map(|values| values.iter().map(|value| value.im).collect::<Vec<_>>())
        .filter(|frequency| *frequency > 0.0)
        .map(|frequency| {
            let angle = (frequency * period_s) % TAU;
            if angle > PI { TAU - angle } else { angle }
        })
        .collect()
}

impl Response {
    pub(super) fn new(of: &Loop) -> Result<Self, LinearError> {
        of.check()?;
        let (late, rest) = of.split_latency();
        let plant = if of.chain().states() == 2 {
            Plant::Alone(Alone::new(of, rest))
        } else {
            Plant::Augmented(Augmented::new(of, rest))
        };
        Ok(Self { plant, late, estimator: of.estimator.clone() })
    }

    /// Frequencies near which the response changes fast, in radians per output period.
    pub(super) fn marks(&self) -> &[f64] {
        match &self.plant {
            Plant::Alone(_) => &[],
            Plant::Augmented(plant) => &plant.marks,
        }
    }

    /// The response at z = exp(j omega).
    pub(super) fn at(&self, omega: f64) -> Point {
        self.at_radius(omega, 0.0)
    }

    /// The response at z = (1 + outside) exp(j omega).
    pub(super) fn at_radius(&self, omega: f64, outside: f64) -> Point {
        // z = -1 is real. With a rounded PI, the response at z = -1 would have a false imaginary part.
        let sin = if omega == PI { 0.0 } else { libm::sin(omega) };
        let half = libm::sin(0.5 * omega);
        let delta = Complex::new(-2.0 * half * half, sin); // exp(j omega) - 1 without cancellation
        let delta = delta + (delta + 1.0) * outside;
        let z_inverse = (delta + 1.0).inv();
        let (positions, x, unit) = match &self.plant {
            Plant::Alone(plant) => plant.at(delta, z_inverse),
            Plant::Augmented(plant) => plant.at(delta, z_inverse),
        };
        let inverse = unit / x / z_inverse.powu(u32::try_from(self.late).unwrap_or(u32::MAX));
        let velocity = match positions.len() {
            1 => self.estimator.at(z_inverse),
            _ => self.lifted(omega, outside, &positions) / x,
        };
        Point { omega, inverse, velocity }
    }

    /// Response of the estimated velocity at the output instants. It is computed from the positions at the samples of a
    /// period.
    fn lifted(&self, omega: f64, outside: f64, positions: &[Complex<f64>]) -> Complex<f64> {
        let period = positions.len() as f64;
        let shrink = libm::pow(1.0 + outside, -1.0 / period);
        let mut velocity = Complex::new(0.0, 0.0);
        for alias in 0..positions.len() {
            let angle = (omega + TAU * alias as f64) / period;
            let back = Complex::new(libm::cos(angle), -libm::sin(angle)) * shrink;
            let share =
                positions.iter().rev().fold(Complex::new(0.0, 0.0), |sum, x| sum * back + x);
            velocity += share * self.estimator.at(back);
        }
        velocity / period
    }
}
