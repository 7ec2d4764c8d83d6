//! How the rows of a residual are weighed.
//!
//! **A reading that stays** while a quiet encoder's handle rests is one reading, not as many as it has rows: its error is
//! the same in all of them. Where the quantiser makes the residual a row weighs 1 over the rows of its reading.
//!
//! **Forces.** What drives a handle and is not in the model, friction that is not Coulomb's for example, passes through
//! its mass twice integrated: the residual wanders, follows the command, and under a loop the command follows it. Least
//! squares of such a residual are biased. So it is weighed as the force that makes it: with the device's own step over
//! `stride` rows, `z(n + stride) = P z(n)`,
//! ```text
//! e(n) - trace(P) e(n - stride) + det(P) e(n - 2 stride)
//! ```
//! is the missing force under a triangle of two strides and nothing of what it was before: a prediction error with the
//! model of a disturbance at the input, which needs no open loop (Ljung, System Identification, 2nd edition, sections 4.2
//! and 13.4). A stride that is too short leaves noise of the
//! positions, one too long nothing of the motion: it is the geometric mean of both ends.

use super::motion::Motion;

/// What the rows of a residual weigh.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum Weighting {
    /// All the same.
    #[default]
    White,
    /// Square roots of the weights, record by record.
    Readings(Vec<Vec<f64>>),
    /// As the force that is missing: rows of a stride, trace and determinant of the step over it.
    Force { stride: usize, trace: f64, determinant: f64 },
}

impl Weighting {
    /// By readings that stay, each of a record.
    pub fn of_readings(readings: &[&[f64]]) -> Self {
        let of = |readings: &&[f64]| {
            let stays = readings.chunk_by(|a, b| a == b);
            stays.flat_map(|stay| vec![1.0 / (stay.len() as f64).sqrt(); stay.len()]).collect()
        };
        Self::Readings(readings.iter().map(of).collect())
    }

    /// By the force that makes residuals in a device of that motion.
    pub fn of_force(motion: &Motion, step_s: f64, stride: usize) -> Self {
        let [trace, determinant] = motion.invariants(stride as f64 * step_s);
        Self::Force { stride, trace, determinant }
    }

    /// Sum of the squares of what errors of the first record weigh, but for those whose past is not known.
    pub fn squares(&self, errors: &[f64]) -> f64 {
        let known = if let Self::Force { stride, .. } = self { 2 * stride } else { 0 };
        self.weighed(0, errors.to_vec()).iter().skip(known).map(|error| error * error).sum()
    }

    pub fn is_force(&self) -> bool {
        matches!(self, Self::Force { .. })
    }

    /// Rows that count.
    pub fn rows(&self, all: usize) -> f64 {
        match self {
            Self::Readings(weights) => weights.iter().flatten().map(|weight| weight * weight).sum(),
            _ => all as f64,
        }
    }

    /// Errors of a record as they weigh. As forces the first, whose past is not known, are as they are.
    pub fn weighed(&self, record: usize, mut errors: Vec<f64>) -> Vec<f64> {
        match self {
            Self::White => errors,
            Self::Readings(weights) => {
                errors
                    .iter_mut()
                    .zip(&weights[record])
                    .for_each(|(error, weight)| *error *= weight);
                errors
            }
            Self::Force { stride, trace, determinant } => {
                let force = |n: usize| {
                    errors[n] - trace * errors[n - stride] + determinant * errors[n - 2 * stride]
                };
                (0..errors.len())
                    .map(|n| if n < 2 * stride { errors[n] } else { force(n) })
                    .collect()
            }
        }
    }

    /// What an error of each row does, of what it does once it is weighed; not of forces, whose rows are not apart.
    pub fn of_rows(&self, weighed: &mut [f64]) {
        if let Self::Readings(weights) = self {
            weighed
                .iter_mut()
                .zip(weights.iter().flatten())
                .for_each(|(one, weight)| *one *= weight);
        }
    }
}
