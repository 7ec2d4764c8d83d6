//! How the estimates err together, for devices that are drawn by an identification: an error of the positions moves mass,
//! damping and latency at once, so that drawn one by one they would make devices that no record is of.

use std::f64::consts::{PI, TAU};

use super::residual::{HARMONICS, Piece, Residual};
use crate::scene::Uncertainty;

/// The numbers of a device, in the order of [`Uncertainty::NAMES`]; the latency in seconds.
pub(super) const NUMBERS: usize = Uncertainty::NAMES.len();

/// Standard deviations and correlations of the numbers that were fitted; 0 of the others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joint {
    /// Standard deviations: the stated intervals over their quantile.
    pub deviations: [f64; NUMBERS],
    /// Correlations of two of them.
    pub correlations: [[f64; NUMBERS]; NUMBERS],
}

impl Joint {
    /// In place of what `base` says of the numbers that were fitted, the latency in samples of that rate.
    pub fn uncertainty(&self, base: Option<&Uncertainty>, rate_hz: f64) -> Uncertainty {
        let base = base.cloned().unwrap_or_default();
        let was = [
            base.mass_kg,
            base.damping_n_s_per_m,
            base.stiffness_n_per_m,
            base.rest_position_m,
            base.gain_n_per_v,
            base.latency,
        ];
        let mut is = self.deviations;
        is[NUMBERS - 1] *= rate_hz;
        let fitted = |place: usize| self.deviations[place] > 0.0;
        let of = |place: usize| if fitted(place) { is[place] } else { was[place] };
        let names = Uncertainty::NAMES;
        let known = |name: &str| names.iter().position(|known| *known == name).is_some_and(fitted);
        let kept = base.correlations.into_iter().filter(|(a, b, _)| !known(a) && !known(b));
        let pairs = (0..NUMBERS).flat_map(|b| (0..b).map(move |a| (a, b)));
        let found = pairs.filter(|&(a, b)| self.correlations[a][b] != 0.0);
        let found =
            found.map(|(a, b)| (names[a].to_owned(), names[b].to_owned(), self.correlations[a][b]));
        Uncertainty {
            mass_kg: of(0),
            damping_n_s_per_m: of(1),
            stiffness_n_per_m: of(2),
            rest_position_m: of(3),
            gain_n_per_v: of(4),
            latency: of(5),
            correlations: kept.chain(found).collect(),
        }
    }
}

/// The error of the positions as the model has it, residuals in counts: white noise and the quantiser's sawtooth.
pub(super) struct ErrorModel {
    white: f64,
    /// Of the sawtooth's harmonics.
    harmonics: Vec<f64>,
}

/// An estimate's row of `(J' J)^-1 J'`, and what the harmonics of each record make of it.
pub(super) struct Seen<'a> {
    column: &'a [f64],
    sums: Vec<[f64; 2]>,
}

impl ErrorModel {
    /// Of a residual of that variance.
    pub fn new(residual: &Residual, variance: f64) -> Self {
        let power = |h: u32| residual.harmonic_squared(h) / (2.0 * PI * PI * f64::from(h * h));
        let kept = (1..=HARMONICS).take_while(|h| power(*h) > 1e-9);
        let harmonics: Vec<f64> =
            if residual.rms_counts.is_some() { kept.map(power).collect() } else { vec![] };
        Self { white: (variance - harmonics.iter().sum::<f64>()).max(0.0), harmonics }
    }

    /// What it makes of an estimate.
    pub fn seen<'a>(&self, column: &'a [f64], pieces: &[Piece<'_>]) -> Seen<'a> {
        let mut all = vec![];
        let mut rest = column;
        for piece in pieces {
            let (own, others) = rest.split_at(piece.position.len());
            rest = others;
            let mut sums = vec![[0.0; 2]; self.harmonics.len()];
            for (q, x) in own.iter().zip(piece.position) {
                let (s, c) = (TAU * (x - x.floor())).sin_cos();
                let (mut re, mut im) = (*q, 0.0);
                for sum in &mut sums {
                    (re, im) = (re * c - im * s, re * s + im * c);
                    *sum = [sum[0] + re, sum[1] + im];
                }
            }
            all.extend(sums);
        }
        Seen { column, sums: all }
    }

    /// Covariance of two estimates.
    pub fn covariance(&self, a: &Seen<'_>, b: &Seen<'_>) -> f64 {
        let white: f64 = a.column.iter().zip(b.column).map(|(a, b)| a * b).sum();
        let powers = a.sums.iter().zip(&b.sums).map(|(a, b)| a[0] * b[0] + a[1] * b[1]);
        let sawtooth: f64 =
            powers.zip(self.harmonics.iter().cycle()).map(|(sum, power)| sum * power).sum();
        self.white * white + sawtooth
    }

    /// Correlations of those estimates.
    pub fn correlations(&self, seen: &[Seen<'_>]) -> Vec<Vec<f64>> {
        let own: Vec<f64> = seen.iter().map(|one| self.covariance(one, one).sqrt()).collect();
        let of = |a: usize, b: usize| {
            let together = self.covariance(&seen[a], &seen[b]) / (own[a] * own[b]);
            if together.is_finite() { together.clamp(-1.0, 1.0) } else { 0.0 }
        };
        (0..seen.len()).map(|a| (0..seen.len()).map(|b| of(a, b)).collect()).collect()
    }
}
