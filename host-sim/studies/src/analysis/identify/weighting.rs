//! Weights of the rows of a residual.
//!
//! **Constant readings.** If the handle rests and the encoder has no noise, many rows have the same reading and the
//! same error. These rows count as one reading. So if the residual comes from the quantiser, the weight of a row is 1
//! divided by the number of neighbouring rows with the same reading.
//!
//! **Forces.** Some forces are not in the model, for example friction that is not Coulomb's. The mass integrates a
//! missing force twice. So the residual varies slowly and follows the command. In a closed loop the command also
//! follows the residual. In a closed loop, least squares is therefore biased. So the residual is converted to the
//! missing force. The device's own step over `stride` rows is `z(n + stride) = P z(n)`. With this step,
//! ```text
//! e(n) - trace(P) e(n - stride) + det(P) e(n - 2 stride)
//! ```
//! is the missing force over two strides, with triangular weights. This missing force does not depend on earlier
//! forces. The weighted residual is a prediction error with a disturbance model at the input. Least squares of this
//! error is also valid in a closed loop (Ljung, System Identification, 2nd edition, sections 4.2 and 13.4). With a
//! short stride, noise of the positions dominates. With a long stride, no motion remains. The stride is the geometric
//! mean of the shortest and the longest useful stride.

use super::motion::Motion;

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum Weighting {
    /// All rows have the same weight.
    #[default]
    White,
    /// Each row has its own weight. The lists have the square roots of the weights, one list per record.
    Readings(Vec<Vec<f64>>),
    /// The residual is converted to the missing force. `stride` is in rows. `trace` and `determinant` belong to the
    /// step over the stride.
    Force { stride: usize, trace: f64, determinant: f64 },
}

impl Weighting {
    /// Weights that count constant readings once. `readings` has the readings of each record.
    pub fn of_readings(readings: &[&[f64]]) -> Self {
        let of = |readings: &&[f64]| {
            let stays = readings.chunk_by(|a, b| a == b);
            stays.flat_map(|stay| vec![1.0 / (stay.len() as f64).sqrt(); stay.len()]).collect()
        };
        Self::Readings(readings.iter().map(of).collect())
    }

    /// Weighting that converts the residual to the missing force, for a device with this motion.
    pub fn of_force(motion: &Motion, step_s: f64, stride: usize) -> Self {
        let [trace, determinant] = motion.invariants(stride as f64 * step_s);
        Self::Force { stride, trace, determinant }
    }

    /// Sum of squares of the weighted errors in the first record. The first errors are left out, because the errors
    /// before them are not known.
    pub fn squares(&self, errors: &[f64]) -> f64 {
        let known = if let Self::Force { stride, .. } = self { 2 * stride } else { 0 };
        self.weighed(0, errors.to_vec()).iter().skip(known).map(|error| error * error).sum()
    }

    pub fn is_force(&self) -> bool {
        matches!(self, Self::Force { .. })
    }

    /// The number of rows that count. Equal readings in sequence count as one row.
    pub fn rows(&self, all: usize) -> f64 {
        match self {
            Self::Readings(weights) => weights.iter().flatten().map(|weight| weight * weight).sum(),
            _ => all as f64,
        }
    }

    /// Weighted errors of a record. With [`Force`](Self::Force), the first errors stay unchanged, because the errors
    /// before them are not known.
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

    /// Converts an effect of weighted errors to the effect of the rows' own errors. With [`Force`](Self::Force) the
    /// effect stays unchanged, because each weighted error combines several rows.
    pub fn of_rows(&self, weighed: &mut [f64]) {
        if let Self::Readings(weights) = self {
            weighed
                .iter_mut()
                .zip(weights.iter().flatten())
                .for_each(|(one, weight)| *one *= weight);
        }
    }
}
