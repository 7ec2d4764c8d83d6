//! The closed loop stepped over one output period, as a matrix: its eigenvalues decide stability.

use super::{LinearError, Loop, SCHUR_ITERATIONS};
use crate::exact::oscillator_step;
use nalgebra::{Complex, DMatrix, Schur, linalg::balancing};

/// `state(n+1) = (fixed + K stiff + B damped) state(n)` over one output period. The state is the position and
/// velocity at the output instant, the estimator's memory, and the commands on their way.
#[derive(Clone, Debug)]
pub struct Monodromy {
    fixed: DMatrix<f64>,
    stiff: DMatrix<f64>,
    damped: DMatrix<f64>,
}

impl Monodromy {
    /// Builds the matrices by stepping the loop, one unit state at a time.
    ///
    /// # Errors
    /// As [`Loop::check`].
    pub fn new(of: &Loop) -> Result<Self, LinearError> {
        of.check()?;
        let stepper = Stepper::new(of);
        let fixed = stepper.matrix(0.0, 0.0);
        let stiff = stepper.matrix(1.0, 0.0) - &fixed;
        let damped = stepper.matrix(0.0, 1.0) - &fixed;
        Ok(Self { fixed, stiff, damped })
    }

    /// Number of states.
    #[must_use]
    pub fn states(&self) -> usize {
        self.fixed.nrows()
    }

    /// Eigenvalues at stiffness N/m and damping N s/m; `None` if the iteration does not converge, which numbers
    /// beyond f64's range can bring about.
    #[must_use]
    pub fn eigenvalues(&self, stiffness: f64, damping: f64) -> Option<Vec<Complex<f64>>> {
        let mut matrix = &self.fixed + &self.stiff * stiffness + &self.damped * damping;
        if matrix.iter().any(|entry| !entry.is_finite()) {
            return None;
        }
        balancing::balance_parlett_reinsch(&mut matrix);
        let schur = Schur::try_new(matrix, f64::EPSILON, SCHUR_ITERATIONS)?;
        Some(schur.complex_eigenvalues().iter().copied().collect())
    }

    /// Largest magnitude of an eigenvalue: the loop is stable where it is below 1. Infinite where it cannot be
    /// computed.
    #[must_use]
    pub fn spectral_radius(&self, stiffness: f64, damping: f64) -> f64 {
        self.eigenvalues(stiffness, damping).map_or(f64::INFINITY, |all| {
            all.iter().map(|z| z.norm_sqr()).fold(0.0, f64::max).sqrt()
        })
    }
}

/// One output period of the loop, sample by sample.
struct Stepper {
    num: Vec<f64>,
    den: Vec<f64>,
    /// Estimator states.
    order: usize,
    /// Commands on their way at an output instant, newest first.
    queue: usize,
    /// The command changes within the period and not at its start.
    splits: bool,
    period: u32,
    /// Sample in which the command changes.
    change: u32,
    whole: ([[f64; 2]; 2], [f64; 2]),
    /// The step before and after the change.
    parts: [([[f64; 2]; 2], [f64; 2]); 2],
    mass: f64,
}

impl Stepper {
    fn new(of: &Loop) -> Self {
        let mass = of.device.mass_kg;
        let (w2, d) = (of.device.stiffness_n_per_m / mass, of.device.damping_n_s_per_m / mass);
        let step = |samples: f64| oscillator_step(w2, d, samples * of.sample_s());
        let (late, rest) = of.split_latency();
        let (change, fraction) = (rest.floor(), rest.fract());
        let order = of.estimator.order();
        let lead = of.estimator.den[0];
        let padded =
            |c: &[f64]| (0..=order).map(|i| c.get(i).copied().unwrap_or(0.0) / lead).collect();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "below the period"
        )]
        let change = change as u32;
        Self {
            num: padded(&of.estimator.num),
            den: padded(&of.estimator.den),
            order,
            queue: late + usize::from(rest > 0.0),
            splits: rest > 0.0,
            period: of.period,
            change,
            whole: step(1.0),
            parts: [step(fraction), step(1.0 - fraction)],
            mass,
        }
    }

    fn matrix(&self, stiffness: f64, damping: f64) -> DMatrix<f64> {
        let states = 2 + self.order + self.queue;
        let mut matrix = DMatrix::zeros(states, states);
        for column in 0..states {
            let mut state = vec![0.0; states];
            state[column] = 1.0;
            self.advance(&mut state, stiffness, damping);
            matrix.column_mut(column).copy_from_slice(&state);
        }
        matrix
    }

    fn advance(&self, state: &mut [f64], stiffness: f64, damping: f64) {
        let (plant, rest) = state.split_at_mut(2);
        let (memory, queue) = rest.split_at_mut(self.order);
        let mut z = [plant[0], plant[1]];
        let velocity = self.num[0] * z[0] + memory.first().copied().unwrap_or(0.0);
        let mut commands = vec![-(stiffness * z[0] + damping * velocity)];
        commands.extend_from_slice(queue);
        // The oldest command acts first; with a latency of whole periods it is also the one that acts on.
        let before = commands[self.queue];
        let now = if self.splits { commands[self.queue - 1] } else { before };
        for sample in 0..self.period {
            self.remember(memory, z[0]);
            match sample.cmp(&self.change) {
                core::cmp::Ordering::Less => z = self.move_by(&self.whole, z, before),
                core::cmp::Ordering::Greater => z = self.move_by(&self.whole, z, now),
                core::cmp::Ordering::Equal => {
                    z = self.move_by(&self.parts[0], z, before);
                    z = self.move_by(&self.parts[1], z, now);
                }
            }
        }
        plant.copy_from_slice(&z);
        queue.copy_from_slice(&commands[..self.queue]);
    }

    /// Estimator, direct form 2 transposed.
    fn remember(&self, memory: &mut [f64], x: f64) {
        let y = self.num[0] * x + memory.first().copied().unwrap_or(0.0);
        for i in 0..self.order {
            let next = memory.get(i + 1).copied().unwrap_or(0.0);
            memory[i] = next + self.num[i + 1] * x - self.den[i + 1] * y;
        }
    }

    fn move_by(
        &self,
        (phi, gamma): &([[f64; 2]; 2], [f64; 2]),
        z: [f64; 2],
        force: f64,
    ) -> [f64; 2] {
        let acceleration = force / self.mass;
        [0, 1].map(|row| phi[row][0] * z[0] + phi[row][1] * z[1] + gamma[row] * acceleration)
    }
}
