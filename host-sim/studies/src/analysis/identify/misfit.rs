//! Checks whether the residual agrees with the model.
//!
//! A residual from noise is white (Ljung and Box, `residual`). A residual from quantisation is not white, even if the
//! model is right. So the residual is compared with [`COPIES`] simulated residuals, the copies. For a copy, the
//! modelled motion starts at a random point within a count. Noise is added, with a standard deviation that is estimated
//! from the sawtooth. The sum is quantised. The part of the copy that a fit would remove is subtracted.
//!
//! Three measures are compared: the mean square, the mean square of the means over [`BLOCKS`] stretches, and the mean
//! square with the weights of the fit. The third measure is necessary, because a long rest hides the motion in the
//! first two measures. The copies give the mean and the standard deviation of the logarithm of each measure. The
//! residual is too large, or too coloured, if two conditions are true. First, the logarithm of its measure is more than
//! [`BEYOND`] standard deviations above the mean. Second, the measure is more than [`WORTH`] times the measure of every
//! copy.

use nalgebra::DVector;

use super::residual::{Residual, Weighed};
use crate::numerics::random;

const COPIES: u64 = 40;
/// Number of stretches into which a record is divided. The mean of each stretch is computed.
const BLOCKS: usize = 200;
/// Largest measure of a residual that agrees with the model, in standard deviations.
const BEYOND: f64 = 6.0;
/// A smaller ratio of mean squares gives no warning.
const WORTH: f64 = 1.15;

/// A residual that is larger, or more coloured, than the model allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Misfit {
    /// RMS of the residual, and RMS that the model allows, in counts.
    Larger(f64, f64),
    /// RMS of the means over stretches, and RMS that the model allows for these means, in counts.
    Coloured(f64, f64),
    /// The residual of the readings in motion is too large.
    InMotion,
}

/// Standard deviation of the noise before the quantiser, in counts. Noise of this size explains the residual's
/// coherence.
fn noise_counts(residual: &Residual) -> f64 {
    let squared = residual.coherence.powi(2) - 2.0 * residual.coherence_squared_error;
    let coherence = squared.clamp(1e-6, 1.0).sqrt();
    (-coherence.ln() / 2.0).sqrt() / std::f64::consts::PI
}

/// Compares a residual from quantisation with the model; `None` if they agree. `left` returns the part of the rows'
/// errors that a fit does not remove. `weights` are the weights of the fit.
pub(super) fn misfit(
    weighed: &Weighed,
    weights: Option<&DVector<f64>>,
    left: impl Fn(DVector<f64>) -> DVector<f64>,
) -> Option<Misfit> {
    let pieces = weighed.pieces();
    let noise = noise_counts(&weighed.found);
    let rows: Vec<usize> = pieces.iter().map(|piece| piece.residual.len()).collect();
    let own: Vec<f64> = pieces.iter().flat_map(|piece| piece.residual).copied().collect();
    let measures = |residual: DVector<f64>| {
        let [square, means] = measures(residual.as_slice(), &rows);
        let weighed =
            weights.map_or(square, |weights| residual.component_mul(weights).norm_squared());
        [square, means, weighed]
    };
    let own = measures(DVector::from_vec(own));
    let copies: Vec<[f64; 3]> = (0..COPIES)
        .map(|copy| {
            let errors = pieces.iter().enumerate().flat_map(|(record, piece)| {
                let shift = random::uniform(copy, record as u64);
                let stream = (copy << 8) | (record as u64 + 1);
                piece.position.iter().enumerate().map(move |(row, x)| {
                    let at = x + shift;
                    let read = at + noise * random::gaussian(stream, row as u64);
                    read.floor() + 0.5 - at
                })
            });
            let errors = DVector::from_iterator(rows.iter().sum(), errors);
            measures(left(errors))
        })
        .collect();
    let beyond = |measure: usize| {
        let logs: Vec<f64> = copies.iter().map(|copy| copy[measure].ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let variance = logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>();
        let deviation = (variance / (logs.len() - 1) as f64).sqrt();
        let most = copies.iter().map(|copy| copy[measure]).fold(0.0, f64::max);
        let over = own[measure].ln() - mean;
        let counts = (own[measure].sqrt(), mean.exp().sqrt());
        (over > BEYOND * deviation && own[measure] > WORTH * most).then_some(counts)
    };
    beyond(0)
        .map(|(is, allowed)| Misfit::Larger(is, allowed))
        .or_else(|| beyond(1).map(|(is, allowed)| Misfit::Coloured(is, allowed)))
        .or_else(|| beyond(2).map(|_| Misfit::InMotion))
}

/// Mean square of a residual, and mean square of the means of its stretches.
fn measures(residual: &[f64], rows: &[usize]) -> [f64; 2] {
    let square = residual.iter().map(|r| r * r).sum::<f64>() / residual.len() as f64;
    let (mut sum, mut count, mut rest) = (0.0, 0.0, residual);
    for rows in rows {
        let (own, others) = rest.split_at(*rows);
        rest = others;
        for stretch in own.chunks_exact((rows / BLOCKS).max(2)) {
            let mean = stretch.iter().sum::<f64>() / stretch.len() as f64;
            (sum, count) = (sum + mean * mean, count + 1.0);
        }
    }
    [square, f64::max(sum / f64::max(count, 1.0), f64::MIN_POSITIVE)]
}
