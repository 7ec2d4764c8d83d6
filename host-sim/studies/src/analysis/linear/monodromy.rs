//! The matrix that takes the closed loop's state over one output period. Its eigenvalues show whether the loop is
//! stable.

use super::{LinearError, Loop, SCHUR_ITERATIONS, acting::Acting};
use crate::scene::element::{Chain, STATES_MAX};
use nalgebra::{Complex, DMatrix, Schur, linalg::balancing};

/// The matrix `fixed + K stiff + B damped`. It takes the state from one output instant to the next. The matrix is the
/// product of the steps between all events within the period. The events are samples and the change of the command. The
/// state contains the plant's state at the output instant, the estimator's memory, and the commands that are delayed by
/// the latency.
#[derive(Clone, Debug)]
pub struct Monodromy {
    fixed: DMatrix<f64>,
    stiff: DMatrix<f64>,
    damped: DMatrix<f64>,
}

impl Monodromy {
    /// Builds the matrices. The loop is stepped with one unit of each state, or of the command.
    ///
    /// # Errors
    /// An error of [`Loop::check`].
    pub fn new(of: &Loop) -> Result<Self, LinearError> {
        of.check()?;
        let stepper = Stepper::new(of);
        let fixed = stepper.uncontrolled();
        // The matrix is affine in K and B. The parts for K and B are the effect of one newton of command times the
        // command's dependence on the state. A difference of two matrices would lose digits, because the identity is
        // much larger.
        let newton = stepper.after_one_newton();
        let (mut stiff, mut damped) = (fixed.clone() * 0.0, fixed.clone() * 0.0);
        stiff.column_mut(0).copy_from_slice(&newton);
        damped.column_mut(0).copy_from_slice(&newton);
        stiff *= -1.0;
        damped *= -stepper.num[0];
        if stepper.order > 0 {
            for (entry, newton) in damped.column_mut(stepper.plant).iter_mut().zip(&newton) {
                *entry = -newton;
            }
        }
        Ok(Self { fixed, stiff, damped })
    }

    #[must_use]
    pub fn states(&self) -> usize {
        self.fixed.nrows()
    }

    /// Eigenvalues of the matrix for a stiffness in N/m and a damping in N s/m. `None` if the iteration does not
    /// converge, for example because numbers exceed the range of f64.
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

    /// Largest magnitude of an eigenvalue. The loop is stable if this radius is below 1. It is infinite if the
    /// eigenvalues cannot be computed.
    #[must_use]
    pub fn spectral_radius(&self, stiffness: f64, damping: f64) -> f64 {
        self.eigenvalues(stiffness, damping).map_or(f64::INFINITY, |all| {
            all.iter().map(|z| z.norm_sqr()).fold(0.0, f64::max).sqrt()
        })
    }
}

/// Steps the loop through one output period, sample by sample.
struct Stepper {
    num: Vec<f64>,
    den: Vec<f64>,
    /// Number of states that the estimator has.
    order: usize,
    /// Number of commands that are still delayed at an output instant. The newest comes first.
    queue: usize,
    /// Whether the command changes within the period. It is false if it changes at the period's start.
    splits: bool,
    period: u32,
    /// Index of the sample during which the command changes.
    change: u32,
    /// Number of states of the plant.
    plant: usize,
    whole: Step,
    /// The steps before and after the change.
    parts: [Step; 2],
}

/// State of the plant. Elements that a plant does not use are 0.
type Plant = [f64; STATES_MAX];

/// One exact step of the plant.
struct Step {
    /// Rows of the matrix. Each state of the plant has one.
    phi: Vec<Plant>,
    gamma: Plant,
}

impl Step {
    fn new(chain: &Chain, dt: f64) -> Self {
        let (less, effect) = Acting::of(chain).reduce(chain.increment(dt));
        let mut gamma = [0.0; STATES_MAX];
        gamma[..effect.len()].copy_from_slice(effect.as_slice());
        let phi = (0..effect.len()).map(|row| {
            let mut entries = [0.0; STATES_MAX];
            for (column, entry) in entries[..effect.len()].iter_mut().enumerate() {
                *entry = less[(row, column)] + if row == column { 1.0 } else { 0.0 };
            }
            entries
        });
        Self { phi: phi.collect(), gamma }
    }

    fn apply(&self, z: &Plant, force: f64) -> Plant {
        let mut next = [0.0; STATES_MAX];
        for (row, next) in self.phi.iter().zip(&mut next) {
            *next = row.iter().zip(z).map(|(entry, value)| entry * value).sum();
        }
        for (next, gamma) in next.iter_mut().zip(&self.gamma) {
            *next += gamma * force;
        }
        next
    }
}

impl Stepper {
    fn new(of: &Loop) -> Self {
        let chain = of.chain();
        let step = |samples: f64| Step::new(&chain, samples * of.sample_s());
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
            plant: Acting::of(&chain).states(),
        }
    }

    fn states(&self) -> usize {
        self.plant + self.order + self.queue
    }

    /// The matrix if there is no wall.
    fn uncontrolled(&self) -> DMatrix<f64> {
        let states = self.states();
        let mut matrix = DMatrix::zeros(states, states);
        for column in 0..states {
            let mut state = vec![0.0; states];
            state[column] = 1.0;
            self.advance(&mut state, 0.0);
            matrix.column_mut(column).copy_from_slice(&state);
        }
        matrix
    }

    /// The state after one period with a command of one newton. It begins with a state of zero.
    fn after_one_newton(&self) -> Vec<f64> {
        let mut state = vec![0.0; self.states()];
        self.advance(&mut state, 1.0);
        state
    }

    fn advance(&self, state: &mut [f64], command: f64) {
        let (plant, rest) = state.split_at_mut(self.plant);
        let (memory, queue) = rest.split_at_mut(self.order);
        let mut z = [0.0; STATES_MAX];
        z[..self.plant].copy_from_slice(plant);
        let mut commands = vec![command];
        commands.extend_from_slice(queue);
        // The oldest command acts first. With a latency of whole periods, the oldest command acts over the whole
        // period.
        let before = commands[self.queue];
        let now = if self.splits { commands[self.queue - 1] } else { before };
        for sample in 0..self.period {
            self.remember(memory, z[0]);
            match sample.cmp(&self.change) {
                core::cmp::Ordering::Less => z = self.whole.apply(&z, before),
                core::cmp::Ordering::Greater => z = self.whole.apply(&z, now),
                core::cmp::Ordering::Equal => {
                    z = self.parts[0].apply(&z, before);
                    z = self.parts[1].apply(&z, now);
                }
            }
        }
        plant.copy_from_slice(&z[..self.plant]);
        queue.copy_from_slice(&commands[..self.queue]);
    }

    /// Updates the estimator's memory. The form is direct form 2 transposed.
    fn remember(&self, memory: &mut [f64], x: f64) {
        let y = self.num[0] * x + memory.first().copied().unwrap_or(0.0);
        for i in 0..self.order {
            let next = memory.get(i + 1).copied().unwrap_or(0.0);
            memory[i] = next + self.num[i + 1] * x - self.den[i + 1] * y;
        }
    }
}
