//! Whether the residual is what the model allows.
//!
//! A residual that noise makes is white (Ljung and Box, `residual`). One that the quantiser makes is not, though the model
//! is right. Then it is held against [`COPIES`] that are made as the model says: the modelled motion from a start within
//! the count, noise as the sawtooth shows it, the quantiser, and the part that the fit would take out. It is larger than
//! the model allows if its mean square, and more coloured if the mean square of its means over [`BLOCKS`] stretches, is
//! beyond [`BEYOND`] standard deviations of theirs, on a logarithmic scale.

use nalgebra::DVector;

use super::residual::{Residual, Weighed};
use crate::numerics::random;

/// Records that are made as the model says.
const COPIES: u64 = 40;
/// Stretches of a record over which means are taken.
const BLOCKS: usize = 200;
/// Standard deviations beyond which a residual is not the model's.
const BEYOND: f64 = 6.0;
/// Least factor of a mean square that is worth a warning.
const WORTH: f64 = 1.15;

/// How much larger, or more coloured, the residual of a model is than the model allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Misfit {
    /// Its RMS, and that of the model, counts.
    Larger(f64, f64),
    /// The RMS of its means over stretches, and that of the model, counts.
    Coloured(f64, f64),
}

/// Standard deviation of the noise that leaves so much of the sawtooth, counts.
fn noise_counts(residual: &Residual) -> f64 {
    let squared = residual.coherence.powi(2) - 2.0 * residual.coherence_squared_error;
    let coherence = squared.clamp(1e-6, 1.0).sqrt();
    (-coherence.ln() / 2.0).sqrt() / std::f64::consts::PI
}

/// The misfit of a residual that the quantiser makes; `None` if it is as the model says. `left` is what the fit leaves of
/// errors of the rows.
pub(super) fn misfit(
    weighed: &Weighed,
    left: impl Fn(DVector<f64>) -> DVector<f64>,
) -> Option<Misfit> {
    let pieces = weighed.pieces();
    let noise = noise_counts(&weighed.found);
    let rows: Vec<usize> = pieces.iter().map(|piece| piece.residual.len()).collect();
    let own: Vec<f64> = pieces.iter().flat_map(|piece| piece.residual).copied().collect();
    let own = measures(&own, &rows);
    let copies: Vec<[f64; 2]> = (0..COPIES)
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
            let left = left(errors);
            measures(left.as_slice(), &rows)
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
}

/// Mean square of a residual, and of its means over stretches.
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
