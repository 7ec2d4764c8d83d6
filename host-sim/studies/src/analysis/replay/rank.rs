//! Ranks the estimators by their errors on recorded counts. The reference is the velocity of a low-pass that runs
//! forwards and backwards.
//!
//! The reference has no delay, but needs the whole record. So a controller cannot use the reference. An ideal encoder
//! also reads the low-passed motion. This gives simulated counts. Every estimator is tuned for the smallest error on
//! the recorded counts, in the core's arithmetic. Its error on the simulated counts, with the same tuning, shows the
//! effect of an ideal encoder.
//!
//! All quantities are in counts and samples, so the record may have any rate. The tunings belong to a design of 10 kHz,
//! and are scaled to the record's rate.

use std::{path::Path, sync::atomic::AtomicBool};

use serde::Serialize;
use zwidth::{
    CounterWidth, Design, Sampler, Settings, VelocitySettings, WallSettings,
    velocity::EstimatorName,
};

use super::rms;
use crate::{
    analysis::{
        compare::{axis::Axes, bandwidth::bandwidth_hz},
        identify::{Record, Span},
    },
    error::Error,
    input, interrupt,
    scene::Scene,
};

/// Sample rate of the design in which the tunings are tried, in Hz. Every estimator has its defaults at this rate.
const RATE_HZ: f64 = 1e4;
/// Number of points along an axis that the search tries in one pass.
const PLACES: u32 = 9;
/// Number of passes of the search. Each pass searches a quarter of the range of the pass before.
const PASSES: i32 = 3;
/// Length of each end of the record that is left out, in time constants of the low-pass.
const SETTLES: f64 = 2.0;

/// The result of one estimator on the counts of a record.
#[derive(Clone, Debug, Serialize)]
pub struct Ranked {
    pub estimator: &'static str,
    /// Bandwidth of the best tuning (-3 dB), at the record's rate. `None` if the estimator has no tuning.
    pub bandwidth_hz: Option<f64>,
    /// RMS of the estimator's error on the recorded counts.
    pub error_m_per_s: f64,
    /// RMS of the estimator's error on the counts of an ideal encoder.
    pub simulated_error_m_per_s: f64,
}

/// The ranked estimators. The one with the smallest error comes first.
#[derive(Clone, Debug, Serialize)]
pub struct Ranking {
    pub samples: usize,
    pub rate_hz: f64,
    /// Frequency at which the gain of the low-pass is -3 dB.
    pub reference_hz: f64,
    /// RMS of the difference between count and low-passed position. With an ideal encoder it is 0.29 counts.
    pub residual_counts: f64,
    /// RMS of the low-passed velocity.
    pub speed_rms_m_per_s: f64,
    pub estimators: Vec<Ranked>,
    /// Spearman's rank correlation between the errors on recorded and on simulated counts.
    pub spearman: f64,
}

/// What an estimator is compared with: recorded and simulated counts, the reference velocities in counts per sample,
/// and the range of the samples that are compared.
struct Bench<'a> {
    design: Design,
    counts: [Vec<i32>; 2],
    truth: Vec<f64>,
    /// Largest acceleration of the reference velocity, in the units of the design.
    acceleration_m_per_s2: f64,
    inner: std::ops::Range<usize>,
    stop: &'a AtomicBool,
}

/// Reads a log to [`rank`] the estimators on. `scene` says whether its positions are lengths or angles.
pub fn read_log(path: &Path, scene: &Scene, resolution_m: f64) -> Result<Record, Error> {
    let name = path.display().to_string();
    let text = input::read_text(path, input::RECORD)?;
    Record::from_csv(&name, &text, Span::default(), scene.units, resolution_m)
        .map_err(|error| Error::Input(scene.units.text(&error)).of(&name))
}

/// Ranks all estimators that need only the count.
///
/// # Errors
/// The record has no counts or is too short for the low-pass, or `stop` was set.
pub fn rank(
    record: &Record,
    resolution_m: f64,
    reference_hz: f64,
    scene: &Scene,
    stop: &AtomicBool,
) -> Result<Ranking, Error> {
    let rate_hz = 1.0 / record.step_s;
    let (low, high) = (20.0 * rate_hz / record.len() as f64, 0.25 * rate_hz);
    if !(low..=high).contains(&reference_hz) {
        return Err(Error::Input(format!(
            "--rank is {reference_hz}, allowed {low:.3} to {high:.3} Hz: a quarter of the record's rate, and twenty \
             periods in the record"
        )));
    }
    let first_m = record.position_m[0];
    let places: Vec<f64> =
        record.position_m.iter().map(|at| libm::round((at - first_m) / resolution_m)).collect();
    let smooth = both_ways(&places, reference_hz / rate_hz);
    // An ideal encoder rounds down. This offset of half a count does not change the velocity.
    let residual: Vec<f64> =
        places.iter().zip(&smooth).map(|(place, smooth)| place - smooth).collect();
    let settles = SETTLES * rate_hz / reference_hz;
    let edge = (0..places.len()).take_while(|n| (*n as f64) < settles).count();
    let inner = edge..places.len() - edge;
    let mut truth = vec![0.0; places.len()];
    for n in inner.clone() {
        truth[n] = 0.5 * (smooth[n + 1] - smooth[n - 1]);
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "positions of records are within 2^31 counts"
    )]
    let whole = |of: &[f64]| of.iter().map(|place| libm::floor(*place) as i32).collect();
    let design = Design { rate_hz: RATE_HZ, ..scene.design() };
    let change = |n: usize| (truth[n] - truth[n - 1]).abs();
    let fastest = inner.clone().skip(1).map(change).fold(0.0, f64::max);
    let bench = Bench {
        acceleration_m_per_s2: fastest * design.resolution_m * design.rate_hz * design.rate_hz,
        design,
        counts: [whole(&places), whole(&smooth)],
        truth,
        inner: inner.clone(),
        stop,
    };
    let per_s = resolution_m * rate_hz;
    let mut estimators = vec![];
    for name in EstimatorName::ALL {
        if name.missing(&[]).is_none() {
            let (settings, error) = bench.best(name.defaults(), scene.device.mass_kg)?;
            let tuned = settings.tuning().is_some();
            let hz = bandwidth_hz(&settings, &bench.design).map_err(Error::input)?;
            estimators.push(Ranked {
                estimator: name.text(),
                bandwidth_hz: tuned.then_some(hz / bench.design.rate_hz * rate_hz),
                error_m_per_s: error * per_s,
                simulated_error_m_per_s: bench.error(&settings, 1)? * per_s,
            });
        }
    }
    estimators.sort_by(|a, b| a.error_m_per_s.total_cmp(&b.error_m_per_s));
    Ok(Ranking {
        samples: places.len(),
        rate_hz,
        reference_hz,
        residual_counts: spread(&residual[inner.clone()]),
        speed_rms_m_per_s: rms(bench.truth[inner].iter().copied()) * per_s,
        spearman: spearman(&estimators),
        estimators,
    })
}

impl Bench<'_> {
    /// RMS of an estimator's error, in counts per sample. `of` is 0 for the recorded counts and 1 for the simulated
    /// counts.
    fn error(&self, velocity: &VelocitySettings, of: usize) -> Result<f64, Error> {
        interrupt::unless(self.stop)?;
        let wall = WallSettings {
            position_m: 0.0,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        };
        let settings = Settings { velocity: *velocity, wall };
        let control = settings.build(&self.design).map_err(Error::input)?;
        let counts = &self.counts[of];
        let mut sampler = Sampler::new(counts[0].cast_unsigned(), CounterWidth::Bits32);
        let off = counts.iter().zip(&self.truth).map(|(count, truth)| {
            let velocity = sampler.sample(&control, count.cast_unsigned()).motion.velocity;
            f64::from(velocity.bits()) / 65_536.0 - truth
        });
        let off: Vec<f64> = off.collect();
        Ok(rms(off[self.inner.clone()].iter().copied()))
    }

    /// The settings at a point on the axes. Levant's bandwidth is defined for an error of one count. It has no meaning
    /// if the acceleration is many counts. So Levant's parameter goes from 1/30 to 30 times the largest acceleration.
    fn at(&self, axes: &Axes, place: [f64; 2]) -> VelocitySettings {
        let settings = axes.at(place);
        match settings {
            VelocitySettings::LevantExplicit { .. } | VelocitySettings::LevantImplicit { .. } => {
                settings.with_tuning(self.acceleration_m_per_s2 * 900f64.powf(place[0] - 0.5))
            }
            _ => settings,
        }
    }

    /// Searches the tuning with the smallest error on the recorded counts. Returns the tuning and this error.
    fn best(
        &self,
        start: VelocitySettings,
        mass_kg: f64,
    ) -> Result<(VelocitySettings, f64), Error> {
        let mut best = (start, self.error(&start, 0)?);
        let Some(axes) = Axes::new(&start, &self.design, mass_kg) else { return Ok(best) };
        let mut centre = [0.5, axes.start_second()];
        for pass in 0..PASSES {
            let half = 0.5 * 0.25f64.powi(pass);
            let places = |centre: f64| {
                (0..PLACES).map(move |n| {
                    (centre + half * (f64::from(2 * n) / f64::from(PLACES - 1) - 1.0))
                        .clamp(0.0, 1.0)
                })
            };
            let from = centre;
            for along in places(from[0]) {
                let seconds =
                    if axes.second.is_some() { places(from[1]).collect() } else { vec![from[1]] };
                for second in seconds {
                    let settings = self.at(&axes, [along, second]);
                    if axes.accepts(&settings) {
                        let error = self.error(&settings, 0)?;
                        if error < best.1 {
                            (best, centre) = ((settings, error), [along, second]);
                        }
                    }
                }
            }
        }
        Ok(best)
    }
}

/// Runs a Butterworth low-pass of second order forwards and then backwards. `of_rate` is the -3 dB frequency of one
/// pass, divided by the sample rate.
fn both_ways(values: &[f64], of_rate: f64) -> Vec<f64> {
    let w = libm::tan(std::f64::consts::PI * of_rate);
    let norm = 1.0 / (1.0 + std::f64::consts::SQRT_2 * w + w * w);
    let (gain, a1) = (w * w * norm, 2.0 * (w * w - 1.0) * norm);
    let a2 = (1.0 - std::f64::consts::SQRT_2 * w + w * w) * norm;
    let pass = |values: &mut Vec<f64>| {
        let first = values.first().copied().unwrap_or_default();
        let (mut x, mut y) = ([first; 2], [first; 2]);
        for value in values.iter_mut() {
            let out = gain * (*value + 2.0 * x[0] + x[1]) - a1 * y[0] - a2 * y[1];
            (x, y) = ([*value, x[0]], [out, y[0]]);
            *value = out;
        }
        values.reverse();
    };
    let mut values = values.to_vec();
    pass(&mut values);
    pass(&mut values);
    values
}

/// RMS of the deviations from the mean.
fn spread(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    rms(values.iter().map(|value| value - mean))
}

/// Rank correlation of the two errors. The rows are sorted by the first error.
fn spearman(rows: &[Ranked]) -> f64 {
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|a, b| {
        rows[*a].simulated_error_m_per_s.total_cmp(&rows[*b].simulated_error_m_per_s)
    });
    let apart = order.iter().enumerate().map(|(rank, row)| (rank as f64 - *row as f64).powi(2));
    let n = rows.len() as f64;
    1.0 - 6.0 * apart.sum::<f64>() / (n * (n * n - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{analysis::identify::Drive, scene::NamedScene};

    static NEVER: AtomicBool = AtomicBool::new(false);

    /// What an ideal encoder records of a motion of two sines. The record lasts 2 s at 1 kHz.
    fn record(noise: impl Fn(u32) -> f64) -> Record {
        let position = |n: u32| {
            let t = f64::from(n) * 1e-3;
            let x = 300.0 * (9.0 * t).sin() + 40.0 * (31.0 * t).sin() + noise(n);
            x.floor() * 1e-5
        };
        Record {
            name: "made".into(),
            start_s: 0.0,
            step_s: 1e-3,
            drive: Drive::Voltage,
            command: vec![0.0; 2000],
            position_m: (0..2000).map(position).collect(),
            may_clip: false,
        }
    }

    fn ranked(record: &Record) -> Ranking {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        rank(record, 1e-5, 30.0, &scene, &NEVER).unwrap()
    }

    #[test]
    fn an_ideal_encoder_is_simulated_as_it_is() {
        let ranking = ranked(&record(|_| 0.0));
        assert!((ranking.residual_counts - 0.29).abs() < 0.03, "{}", ranking.residual_counts);
        assert!(ranking.spearman > 0.9, "{}", ranking.spearman);
        let rows = &ranking.estimators;
        let of = |name: &str| rows.iter().find(|row| row.estimator == name).unwrap();
        // Sweeps of the scenes give the same order of these estimators.
        assert!(of("kalman-3").error_m_per_s < of("kalman-2").error_m_per_s);
        assert!(of("butterworth").error_m_per_s < of("difference").error_m_per_s);
        // The error of the plain difference comes from two roundings and from a delay of half a sample.
        let known = (2.0f64 / 12.0).sqrt() * 1e-2;
        assert!((of("difference").error_m_per_s / known - 1.0).abs() < 0.3);
        for row in rows {
            let ratio = row.simulated_error_m_per_s / row.error_m_per_s;
            assert!((0.7..1.5).contains(&ratio), "{row:?}");
        }
    }

    #[test]
    fn noise_that_no_encoder_has_shows() {
        let ranking = ranked(&record(|n| 4.0 * f64::from(n * 7919 % 101) / 101.0));
        assert!(ranking.residual_counts > 1.0);
        assert!(
            ranking.estimators.iter().all(|row| row.error_m_per_s > row.simulated_error_m_per_s)
        );
    }

    #[test]
    fn a_low_pass_both_ways_has_no_delay() {
        let wave: Vec<f64> = (0..4000).map(|n| (f64::from(n) * 0.05).sin()).collect();
        let smooth = both_ways(&wave, 0.02);
        // One pass has the gain 1 / sqrt(1 + (tan / tan)^4). Two passes have the square of it.
        let gain = 1.0 / (1.0 + (0.025f64.tan() / (std::f64::consts::PI * 0.02).tan()).powi(4));
        for n in 500..3500 {
            assert!((smooth[n] - gain * wave[n]).abs() < 1e-6, "{n}");
        }
    }
}
