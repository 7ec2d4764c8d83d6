//! Analyses the residual of a fit: its size, the part from quantisation, and whether the rest is noise.
//!
//! With e = count + 1/2 - x / resolution, the error of a floor quantiser is a sawtooth over the position:
//! ```text
//! e(x) = sum over h = 1, 2, ... of sin(2 pi h x) / (pi h)        x in counts, |e| <= 1/2, variance 1/12
//! ```
//! Gaussian noise of s counts before the quantiser reduces harmonic h by the factor `a^(h^2)`, with `a = exp(-2 pi^2
//! s^2)`. The rest of the error becomes white (Widrow and Kollar, "Quantization Noise", 2008, chapters 4 and 19). The
//! factor a is the coherence. The coherence is the residual's component along the first harmonic, and is measured in
//! blocks of rows. Blocks are necessary, because the fit follows the sawtooth where the handle rests. As a result,
//! where the handle moves, the model is wrong by a slowly varying part of a count. Even and odd rows of a block have
//! the same sawtooth and independent noise. So the mean product of their amplitudes is a^2 without a bias. If a large
//! part of the sawtooth remains, the residual is bound by quantisation. A residual that is bound by quantisation is not
//! white, even if the model is right.

use std::f64::consts::{PI, TAU};

use nalgebra::DVector;
use statrs::distribution::{ChiSquared, ContinuousCDF as _};

use super::{
    Options,
    fit::{Fitted, motion},
};
use crate::scene::Rounding;

/// Number of lags of the Ljung-Box test.
const LAGS: usize = 20;
/// Significance level of the test. One of a thousand white residuals fails it.
const WHITE_P: f64 = 1e-3;
/// Smallest speed that counts as motion, in counts per row. Slower rows give no information about the coherence.
const MOVING: f64 = 0.05;
/// Number of rows in a block. Within a block the model's own error is taken as constant.
const BLOCK: usize = 128;
/// Smallest number of blocks in motion with which the coherence is measured. With fewer blocks it is set to 1.
const FEWEST_BLOCKS: usize = 4;
/// Smallest coherence of a residual that is bound by quantisation. The noise is then below [`HIDES`].
const BOUND: f64 = 0.2;
/// Noise, in counts RMS, that hides the sawtooth of the quantiser.
const HIDES: f64 = 0.28;
/// A residual counts as bound by quantisation only if its squared coherence is at least `CERTAIN` standard errors above
/// 0.
const CERTAIN: f64 = 4.0;
/// Unit of the residuals of a sensor without counts, as a share of the motion. With this unit the values are near 1.
const UNIT_SHARE: f64 = 1e-6;
/// Number of harmonics of the sawtooth that are computed.
pub(super) const HARMONICS: u32 = 64;

/// The residual and the modelled position of one record. Both are in counts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece<'a> {
    pub residual: &'a [f64],
    /// Modelled position, measured from the edge of a count.
    pub position: &'a [f64],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    pub rms_m: f64,
    /// RMS of the residual in counts; `None` for a sensor without counts.
    pub rms_counts: Option<f64>,
    /// RMS of the noise before the quantiser, in counts. Noise of this size explains the RMS of the residual.
    pub noise_counts: Option<f64>,
    /// The share of the sawtooth that remains in the residual. It is 0 if noise hides the sawtooth, and 1 without
    /// noise.
    pub coherence: f64,
    pub coherence_squared_error: f64,
    /// p-value of the Ljung-Box test over 20 lags. A small value means that the residual is not white.
    pub whiteness_p: f64,
    /// Autocorrelation of the residual at a lag of one row.
    pub autocorrelation: f64,
    /// Largest residual divided by the RMS.
    pub peak_per_rms: f64,
}

/// The residual and the modelled positions of a fit in counts, and the properties of the residual.
pub(super) struct Weighed {
    /// The residual and the modelled position of each record.
    counted: Vec<[Vec<f64>; 2]>,
    pub found: Residual,
    /// Length of a count, in m. A sensor without counts has a small part of the motion instead.
    pub unit_m: f64,
}

impl Weighed {
    /// Takes the residual of all records, measured from `reference_m`, in m.
    pub(super) fn new(
        records: &[Fitted<'_>],
        (residual_m, reference_m): (&DVector<f64>, f64),
        options: &Options,
    ) -> Self {
        let unit_m = if options.resolution_m > 0.0 {
            options.resolution_m
        } else {
            UNIT_SHARE * motion(records)
        };
        // The edges of a floor quantiser are at whole counts. The edges of a rounding quantiser are halfway between
        // whole counts.
        let edge = if options.rounding == Rounding::Round { 0.5 } else { 0.0 };
        let mut top = 0;
        let mut counted = vec![];
        for Fitted { positions_m, first, .. } in records {
            let measured = &positions_m[*first..];
            let left = residual_m.rows(top, measured.len());
            top += measured.len();
            let model = measured.iter().zip(left.iter()).map(|(x, left)| x - left + reference_m);
            counted.push([
                left.iter().map(|value| value / unit_m + 0.0).collect(),
                model.map(|value| value / unit_m + edge).collect(),
            ]);
        }
        let pieces: Vec<Piece<'_>> = pieces(&counted);
        let found = Residual::new(&pieces, options.resolution_m, unit_m);
        Self { counted, found, unit_m }
    }

    pub(super) fn pieces(&self) -> Vec<Piece<'_>> {
        pieces(&self.counted)
    }
}

fn pieces(counted: &[[Vec<f64>; 2]]) -> Vec<Piece<'_>> {
    counted.iter().map(|[residual, position]| Piece { residual, position }).collect()
}

impl Residual {
    pub(super) fn new(pieces: &[Piece<'_>], resolution_m: f64, unit_m: f64) -> Self {
        let all = || pieces.iter().flat_map(|piece| piece.residual.iter().copied());
        let rows = all().count() as f64;
        let variance = all().map(|r| r * r).sum::<f64>() / rows;
        let rms = variance.sqrt();
        let counts = resolution_m > 0.0;
        let correlations = autocorrelations(pieces, variance * rows);
        let ljung_box = correlations
            .iter()
            .enumerate()
            .map(|(index, rho)| rho * rho / (rows - (index + 1) as f64));
        let statistic = rows * (rows + 2.0) * ljung_box.sum::<f64>();
        let whiteness_p =
            ChiSquared::new(LAGS as f64).map_or(0.0, |distribution| distribution.sf(statistic));
        let (squared, coherence_squared_error) =
            if counts { coherence_squared(pieces) } else { (0.0, 0.0) };
        Self {
            rms_m: rms * unit_m,
            rms_counts: counts.then_some(rms),
            noise_counts: counts.then(|| (variance - 1.0 / 12.0).max(0.0).sqrt()),
            coherence: squared.clamp(0.0, 1.0).sqrt(),
            coherence_squared_error,
            whiteness_p,
            autocorrelation: correlations[0],
            peak_per_rms: all().map(f64::abs).fold(0.0, f64::max) / rms.max(f64::MIN_POSITIVE),
        }
    }

    /// Whether the test finds no difference from a white residual.
    pub fn is_white(&self) -> bool {
        self.whiteness_p >= WHITE_P
    }

    /// Whether the residual comes from quantisation and not from noise.
    pub fn is_bound_by_quantisation(&self) -> bool {
        let squared = self.coherence.powi(2);
        squared >= BOUND.powi(2).max(CERTAIN * self.coherence_squared_error)
    }

    /// Whether the residual is too large for quantisation alone.
    pub(super) fn hides_quantisation(&self) -> bool {
        self.noise_counts.is_some_and(|noise| noise > HIDES)
    }

    /// Squared share that harmonic h of the sawtooth has in the residual. To be safe, two standard errors are added to
    /// the squared coherence first.
    pub(super) fn harmonic_squared(&self, h: u32) -> f64 {
        let squared = self.coherence.powi(2) + 2.0 * self.coherence_squared_error;
        squared.min(1.0).powi((h * h).cast_signed())
    }
}

/// Autocorrelation at the lags 1, 2, and so on. Only rows of the same record are compared.
fn autocorrelations(pieces: &[Piece<'_>], power: f64) -> [f64; LAGS] {
    let mut correlations = [0.0; LAGS];
    for (index, rho) in correlations.iter_mut().enumerate() {
        let products = pieces.iter().flat_map(|piece| {
            piece.residual.iter().zip(piece.residual.iter().skip(index + 1)).map(|(a, b)| a * b)
        });
        *rho = products.sum::<f64>() / power.max(f64::MIN_POSITIVE);
    }
    correlations
}

/// The squared share that the sawtooth has in the residual, and the standard error of this square.
fn coherence_squared(pieces: &[Piece<'_>]) -> (f64, f64) {
    let mut found = vec![];
    for piece in pieces {
        let blocks = piece.position.chunks_exact(BLOCK).zip(piece.residual.chunks_exact(BLOCK));
        for (position, residual) in blocks {
            if position.windows(2).all(|pair| (pair[1] - pair[0]).abs() >= MOVING) {
                found.push(block(position, residual));
            }
        }
    }
    if found.len() < FEWEST_BLOCKS {
        return (1.0, 0.0);
    }
    let blocks = found.len() as f64;
    let mean = found.iter().sum::<f64>() / blocks;
    let variance = found.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / (blocks - 1.0);
    (mean, (variance / blocks).sqrt())
}

/// The first harmonic has an amplitude in the even rows and one in the odd rows. Returns the product of the two.
fn block(position: &[f64], residual: &[f64]) -> f64 {
    let mut sums = [[0.0; 2]; 2];
    for (row, (x, r)) in position.iter().zip(residual).enumerate() {
        let (s, c) = (TAU * (x - x.floor())).sin_cos();
        let [sin, cos] = &mut sums[row % 2];
        (*sin, *cos) = (*sin + r * s, *cos + r * c);
    }
    let per_half = 2.0 * PI / (0.5 * BLOCK as f64);
    let [[sin, cos], [sin_odd, cos_odd]] = sums;
    (sin * sin_odd + cos * cos_odd) * per_half * per_half
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};

    /// Residual and positions of a quantised sweep with noise. Both are in counts.
    fn swept(noise: f64, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let position: Vec<f64> = (0..20_000).map(|n| 1e-3 * f64::from(n).powf(1.7)).collect();
        let residual = position.iter().map(|x| {
            let normal = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            (x + noise * normal).floor() + 0.5 - x
        });
        (residual.collect(), position)
    }

    fn of(residual: &[f64], position: &[f64]) -> Residual {
        Residual::new(&[Piece { residual, position }], 1.0, 1.0)
    }

    #[test]
    fn the_coherence_is_that_of_the_noise() {
        for noise in [0.0, 0.1, 0.2, 0.3, 0.5] {
            let (residual, position) = swept(noise, 7);
            let found = of(&residual, &position);
            let wanted: f64 = (-2.0 * PI * PI * noise * noise).exp();
            println!("noise {noise}: coherence {:.3}, theory {wanted:.3}", found.coherence);
            let error = (found.coherence.powi(2) - wanted.powi(2)).abs();
            assert!(error < 4.0 * found.coherence_squared_error + 0.02);
            assert!((found.noise_counts.unwrap().powi(2) - noise * noise).abs() < 0.01);
            assert_eq!(found.is_bound_by_quantisation(), noise < 0.28);
        }
    }

    #[test]
    fn white_passes_and_colour_does_not() {
        let mut failed = 0;
        for seed in 0..200 {
            let (mut residual, position) = swept(0.5, seed);
            failed += usize::from(!of(&residual, &position).is_white());
            for n in (1..residual.len()).rev() {
                residual[n] += 0.1 * residual[n - 1];
            }
            assert!(!of(&residual, &position).is_white());
        }
        println!("{failed} of 200 white residuals fail");
        assert!(failed <= 2);
    }

    #[test]
    fn without_motion_the_sawtooth_is_assumed_whole() {
        assert_eq!(of(&[0.2; 500], &[7.3; 500]).coherence, 1.0);
    }
}
