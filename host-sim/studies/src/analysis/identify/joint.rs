//! The joint error of the estimates. It is needed to draw random devices from an identification. An error of the
//! positions changes mass, damping and latency together. Values that are drawn independently would give devices that do
//! not fit the record.

use std::f64::consts::{PI, TAU};

use super::{
    Drive,
    residual::{HARMONICS, Piece, Residual},
};
use crate::scene::{Scene, Uncertainty};

/// Number of a device's parameters, in the order of [`Uncertainty::NAMES`]. The latency is in seconds.
pub(super) const NUMBERS: usize = Uncertainty::NAMES.len();

/// Standard deviations and correlations of the fitted parameters. For all other parameters they are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joint {
    /// Standard deviations: the half-widths divided by `confidence::quantile`.
    pub deviations: [f64; NUMBERS],
    pub correlations: [[f64; NUMBERS]; NUMBERS],
}

/// Indices of the parameters that change in proportion to the gain.
const BY_GAIN: [usize; 3] = [0, 1, 2];
const GAIN: usize = 4;
const LATENCY: usize = 5;

impl Joint {
    /// Takes the uncertainty of `base` and replaces the values of the fitted parameters. The latency is in samples of
    /// the scene `made`. If the gain is given and the command is a voltage, mass, damping and stiffness also get the
    /// gain's uncertainty from `base`.
    pub fn uncertainty(
        &self,
        base: Option<&Uncertainty>,
        made: &Scene,
        drive: Drive,
    ) -> Uncertainty {
        let base = base.cloned().unwrap_or_default();
        let was = [
            base.mass_kg,
            base.damping_n_s_per_m,
            base.stiffness_n_per_m,
            base.rest_position_m,
            base.gain_n_per_v,
            base.latency,
        ];
        let mut own = self.deviations;
        own[LATENCY] *= made.control.rate_hz;
        let mut covariance = self.correlations;
        for (a, row) in covariance.iter_mut().enumerate() {
            for (b, value) in row.iter_mut().enumerate() {
                *value *= own[a] * own[b];
            }
        }
        if own[GAIN] == 0.0 && was[GAIN] > 0.0 {
            let device = &made.device;
            let numbers = [
                device.mass_kg,
                device.damping_n_s_per_m,
                device.stiffness_n_per_m,
                0.0,
                made.actuator.gain_n_per_v,
                0.0,
            ];
            let part = was[GAIN] / made.actuator.gain_n_per_v;
            let found_by_it = if drive == Drive::Voltage { &BY_GAIN[..] } else { &[] };
            for &a in found_by_it.iter().chain(&[GAIN]) {
                for &b in found_by_it.iter().chain(&[GAIN]) {
                    covariance[a][b] += numbers[a] * numbers[b] * part * part;
                }
            }
        }
        let found: [f64; NUMBERS] = std::array::from_fn(|place| covariance[place][place].sqrt());
        let of = |place: usize| if found[place] > 0.0 { found[place] } else { was[place] };
        let names = Uncertainty::NAMES;
        let known = |name: &str| Uncertainty::place(name).is_some_and(|place| found[place] > 0.0);
        let kept = base.correlations.into_iter().filter(|(a, b, _)| !known(a) && !known(b));
        let pairs = (0..NUMBERS).flat_map(|b| (0..b).map(move |a| (a, b)));
        let together = pairs.filter(|&(a, b)| covariance[a][b] != 0.0).map(|(a, b)| {
            let correlation = covariance[a][b] / (found[a] * found[b]);
            (names[a].to_owned(), names[b].to_owned(), correlation.clamp(-1.0, 1.0))
        });
        Uncertainty {
            mass_kg: of(0),
            damping_n_s_per_m: of(1),
            stiffness_n_per_m: of(2),
            rest_position_m: of(3),
            gain_n_per_v: of(GAIN),
            latency: of(LATENCY),
            correlations: kept.chain(together).collect(),
        }
    }
}

/// Model of the position error: white noise and the sawtooth of the quantiser. The residuals are in counts.
pub(super) struct ErrorModel {
    white: f64,
    /// Power of each harmonic of the sawtooth.
    harmonics: Vec<f64>,
}

/// What the variance of an estimate needs: its row q of `(J' J)^-1 J'`, and `sum of q(n) exp(2 pi i h x(n))` for each
/// record and harmonic.
pub(super) struct Seen<'a> {
    column: &'a [f64],
    sums: Vec<[f64; 2]>,
}

impl ErrorModel {
    /// The model for a residual with this variance. A whitened residual has no sawtooth.
    pub fn new(residual: &Residual, variance: f64, is_whitened: bool) -> Self {
        let power = |h: u32| residual.harmonic_squared(h) / (2.0 * PI * PI * f64::from(h * h));
        let kept = (1..=HARMONICS).take_while(|h| power(*h) > 1e-9);
        let harmonics: Vec<f64> = if residual.rms_counts.is_some() && !is_whitened {
            kept.map(power).collect()
        } else {
            vec![]
        };
        Self { white: (variance - harmonics.iter().sum::<f64>()).max(0.0), harmonics }
    }

    /// Prepares the sums with which the variance of one estimate is computed.
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

    pub fn covariance(&self, a: &Seen<'_>, b: &Seen<'_>) -> f64 {
        let white: f64 = a.column.iter().zip(b.column).map(|(a, b)| a * b).sum();
        let powers = a.sums.iter().zip(&b.sums).map(|(a, b)| a[0] * b[0] + a[1] * b[1]);
        let sawtooth: f64 =
            powers.zip(self.harmonics.iter().cycle()).map(|(sum, power)| sum * power).sum();
        self.white * white + sawtooth
    }

    pub fn correlations(&self, seen: &[Seen<'_>]) -> Vec<Vec<f64>> {
        let own: Vec<f64> = seen.iter().map(|one| self.covariance(one, one).sqrt()).collect();
        let of = |a: usize, b: usize| {
            let together = self.covariance(&seen[a], &seen[b]) / (own[a] * own[b]);
            if together.is_finite() { together.clamp(-1.0, 1.0) } else { 0.0 }
        };
        (0..seen.len()).map(|a| (0..seen.len()).map(|b| of(a, b)).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    /// A given gain is uncertain. In a drawn device, the parameters that are proportional to the gain have the relative
    /// error of the gain.
    #[test]
    fn what_scales_with_a_given_gain_errs_with_it() {
        let made = NamedScene::load("paper-1um").unwrap().scene;
        let mut joint =
            Joint { deviations: [1e-7, 1e-6, 1e-5, 1e-8, 0.0, 1e-7], ..Joint::default() };
        for (place, row) in
            joint.correlations.iter_mut().enumerate().filter(|(place, _)| *place != GAIN)
        {
            row[place] = 1.0;
        }
        let base = Uncertainty {
            gain_n_per_v: 0.02 * made.actuator.gain_n_per_v,
            ..Uncertainty::default()
        };
        let found = joint.uncertainty(Some(&base), &made, Drive::Voltage);
        assert!((found.mass_kg / made.device.mass_kg / 0.02 - 1.0).abs() < 1e-9);
        assert_eq!(found.latency, 1e-7 * made.control.rate_hz);
        assert_eq!(found.rest_position_m, 1e-8);
        let drawn = Scene { uncertainty: Some(found), ..made.clone() };
        drawn.check().unwrap();
        let per_gain = |scene: &Scene| {
            [scene.device.mass_kg, scene.device.damping_n_s_per_m, scene.device.stiffness_n_per_m]
                .map(|number| number / scene.actuator.gain_n_per_v)
        };
        for n in 0..50 {
            let one = drawn.drawn(3, n).unwrap();
            for (is, was) in per_gain(&one).into_iter().zip(per_gain(&made)) {
                assert!((is / was - 1.0).abs() < 1e-5, "{is} {was}");
            }
        }
        // Parameters that are fitted again get a new uncertainty. Its names may be linear or rotary.
        let again = Uncertainty {
            correlations: vec![
                ("inertia_kg_m2".into(), "latency".into(), 0.9),
                ("mass_kg".into(), "gain_n_m_per_v".into(), 0.9),
            ],
            ..base
        };
        let renewed = joint.uncertainty(Some(&again), &made, Drive::Voltage);
        assert!(renewed.correlations.iter().all(|(_, _, value)| *value != 0.9));
        // Without `base`, the uncertainty of the gain is not known.
        let found = joint.uncertainty(None, &made, Drive::Voltage);
        assert_eq!((found.mass_kg, found.gain_n_per_v), (1e-7, 0.0));
        assert!(found.correlations.is_empty());
    }
}
