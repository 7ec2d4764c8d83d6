//! The measures of a hit's window, in addition to the RMS of its counts. All measures together decide the verdict.
//!
//! | quantity | meaning, over the samples of the window |
//! |----------|------------------------------|
//! | RMS of the motion | true positions about their mean |
//! | at the limit | part of the outputs that are at the actuator's limit |
//! | RMS of the force | force that safety grants, after the output's rounding, about its mean |
//! | penetration ratio | K times the mean depth behind the surface (from the counts), divided by the mean force of the wall |
//! | sensation level | energy of the motion relative to the least motion that a hand feels, dB |

use std::sync::Arc;

use zwidth::experiment::{
    Hit, RmsLimit, Verdict,
    quiet::{QuietWindow, penetration_ratio},
};

use crate::{
    numerics::fft::RealSpectrum,
    scene::{Criterion, FeltCurve, PushBy, RmsOf, Scene},
};

/// Frequency band of the sensation level in Hz.
const FELT_HZ: [f64; 2] = [2.0, 1000.0];
/// Sensation level that stands for no motion at all, in dB.
const NO_MOTION_DB: f64 = -200.0;
/// Factor by which a sum must exceed a limit before it is certain to exceed it. The factor allows for rounding errors.
const SURE: f64 = 1.0 + 1e-9;

/// Sums over the samples of the window so far. The lanes use the same order of operations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Watch {
    /// First position of the window in m.
    pub origin_m: f64,
    /// Sum of the positions relative to `origin_m`, in m.
    pub sum_m: f64,
    /// Sum of the squares of the positions relative to `origin_m`, in m^2.
    pub squares: f64,
    /// Number of outputs at the actuator's limit.
    pub at_limit: f64,
    pub outputs: f64,
    /// Sum of the forces of all outputs. The forces are fractions of full scale.
    pub forces: f64,
    /// Sum of the squares of the forces of all outputs.
    pub force_squares: f64,
}

impl Watch {
    #[inline]
    pub fn sample(&mut self, position_m: f64) {
        let away_m = position_m - self.origin_m;
        self.sum_m += away_m;
        self.squares += away_m * away_m;
    }

    /// Adds an output. `output` is a fraction of full scale.
    #[inline]
    pub fn output(&mut self, output: f64) {
        if output.abs() >= 1.0 {
            self.at_limit += 1.0;
        }
        self.outputs += 1.0;
        self.forces += output;
        self.force_squares += output * output;
    }

    /// Sum of the squares of the outputs about their mean. Outputs are fractions of full scale.
    fn force_scatter(&self) -> f64 {
        (self.force_squares - self.forces * self.forces / self.outputs.max(1.0)).max(0.0)
    }

    /// Sum of the squares of `samples` positions about their mean, in m^2.
    fn scatter(&self, samples: u32) -> f64 {
        (self.squares - self.sum_m * self.sum_m / f64::from(samples.max(1))).max(0.0)
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measures {
    /// Population RMS of the counts about their mean, in m.
    pub rms_m: f64,
    /// Population RMS of the true positions about their mean, in m.
    pub rms_motion_m: f64,
    /// Outputs at the actuator's limit, as a fraction of the window's outputs.
    pub at_limit_fraction: f64,
    /// Sensation level of the motion in dB. `None` if it was not computed.
    pub sensation_db: Option<f64>,
    /// Population RMS of the force in N.
    pub force_rms_n: f64,
    /// Mean force of the wall in N.
    pub wall_force_n: f64,
    /// K times the mean penetration, divided by `wall_force_n`. `None` if `wall_force_n` is 0.
    pub penetration_ratio: Option<f64>,
}

/// The wall that a hit is judged against.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stiff {
    pub stiffness_n_per_m: f64,
    /// Position of the surface in counts.
    pub surface: i32,
}

/// Judges the windows of a scene.
#[derive(Clone, Debug)]
pub struct Judge {
    criterion: Criterion,
    rms_of: RmsOf,
    limit_m: f64,
    /// Limit of the RMS of the counts for a wall that is quiet. `quiet_force` is the limit of the force's RMS, as a
    /// fraction of full scale.
    quiet_counts: RmsLimit,
    quiet_force: f64,
    /// The motor's push, as a fraction of full scale.
    push: f64,
    full_scale_n: f64,
    felt_limit_db: f64,
    resolution_m: f64,
    period: u32,
    felt: Option<Arc<Felt>>,
    /// Whether the measures are needed for more than the verdict.
    measures: bool,
    varies: bool,
}

impl Judge {
    /// The judge of a scene. The sensation level is computed only if the criterion needs it.
    pub fn of(scene: &Scene) -> Self {
        let (hit, full_scale_n) = (&scene.wall_hit, scene.full_scale_n());
        let limit_m = scene.rms_limit_m();
        let judge = Self {
            criterion: hit.criterion,
            rms_of: hit.rms_of(),
            limit_m,
            quiet_counts: RmsLimit::from_counts(limit_m / scene.encoder.resolution_m),
            quiet_force: hit.force_rms_limit_n() / full_scale_n,
            push: scene.push_n(PushBy::Motor) / full_scale_n,
            full_scale_n,
            felt_limit_db: hit.felt_limit_db,
            resolution_m: scene.encoder.resolution_m,
            period: scene.actuator.period,
            felt: None,
            measures: false,
            varies: hit.protocol.varies(),
        };
        if hit.criterion == Criterion::Felt { judge.with_felt(scene) } else { judge }
    }

    /// Computes the sensation level of every whole hit too, if the length of the window allows it.
    pub fn with_felt(mut self, scene: &Scene) -> Self {
        self.felt = Felt::of(scene).map(Arc::new);
        self
    }

    /// Computes the measures also for hits whose verdict does not need them.
    pub fn with_measures(self) -> Self {
        Self { measures: true, ..self }
    }

    /// Whether the verdict needs nothing but the counts.
    pub fn is_plain(&self) -> bool {
        let by_counts = self.criterion == Criterion::Rms && self.rms_of == RmsOf::Counts;
        by_counts && !self.varies && self.felt.is_none() && !self.measures
    }

    /// The same judge for another push of the motor. `push` is a fraction of full scale.
    pub fn about(self, push: f64) -> Self {
        Self { push, ..self }
    }

    /// Whether the measures need each position in the window, and not only sums.
    pub fn listens(&self) -> bool {
        self.felt.is_some()
    }

    /// Measures of a hit's window. `motion` has the positions in the window, if the measures need positions.
    pub fn measures(
        &self,
        hit: &Hit,
        wall: Stiff,
        watch: &Watch,
        motion: impl FnOnce() -> Vec<f64>,
    ) -> Measures {
        let samples = hit.scatter().samples();
        let outputs = f64::from(samples) / f64::from(self.period);
        let wall_force_n = (self.push - watch.forces / watch.outputs.max(1.0)) * self.full_scale_n;
        let behind = hit.scatter().mean_counts() - f64::from(wall.surface);
        let spring_n = wall.stiffness_n_per_m * behind * self.resolution_m;
        Measures {
            rms_m: hit.scatter().rms_counts() * self.resolution_m,
            rms_motion_m: libm::sqrt(watch.scatter(samples) / f64::from(samples.max(1))),
            at_limit_fraction: (watch.at_limit / outputs).min(1.0),
            sensation_db: self.felt.as_ref().map(|felt| felt.level_db(motion())),
            force_rms_n: libm::sqrt(watch.force_scatter() / watch.outputs.max(1.0))
                * self.full_scale_n,
            wall_force_n,
            penetration_ratio: penetration_ratio(spring_n, wall_force_n),
        }
    }

    /// Whether the RMS is below its limit. For counts under a constant push, integers are compared.
    fn rests(&self, measures: &Measures, counts: impl FnOnce() -> bool) -> bool {
        match self.rms_of {
            RmsOf::Counts if self.varies => measures.rms_m < self.limit_m,
            RmsOf::Counts => counts(),
            RmsOf::Motion => measures.rms_motion_m < self.limit_m,
        }
    }

    /// Whether handle and force are quiet, and the wall has the commanded stiffness.
    fn is_quiet(&self, hit: &Hit, wall: Stiff, measures: &Measures) -> bool {
        let rests = self.rests(measures, || hit.scatter().is_below(self.quiet_counts));
        let Measures { force_rms_n, wall_force_n, penetration_ratio, .. } = *measures;
        let count_n = wall.stiffness_n_per_m * self.resolution_m;
        let window = QuietWindow { force_rms_n, wall_force_n, penetration_ratio, count_n };
        rests && window.is_quiet(self.quiet_force * self.full_scale_n)
    }

    /// The verdict from a whole window.
    pub fn verdict(&self, hit: &Hit, wall: Stiff, measures: &Measures) -> Verdict {
        let counts = hit.verdict();
        if counts == Verdict::NoContact {
            return counts;
        }
        let quiet = self.rests(measures, || counts == Verdict::Stable);
        let stable = match self.criterion {
            Criterion::Rms => quiet,
            Criterion::Unsaturated => quiet && measures.at_limit_fraction == 0.0,
            Criterion::Felt => measures.sensation_db.is_some_and(|db| db < self.felt_limit_db),
            Criterion::Quiet => self.is_quiet(hit, wall, measures),
        };
        if stable { Verdict::Stable } else { Verdict::Unstable }
    }

    /// The verdict before the end of the window, if it is already certain. Otherwise `None`. With a sensation level,
    /// the verdict is never certain before the end, because later samples may have more weight.
    pub fn certain_verdict(&self, hit: &Hit, watch: &Watch, window: u32) -> Option<Verdict> {
        let by_counts = || hit.certain_verdict();
        let moves = || {
            let needed = self.limit_m * self.limit_m * f64::from(window) * SURE;
            watch.scatter(hit.scatter().samples()) > needed
        };
        let unstable =
            |certain: bool| (hit.contact_samples() > 0 && certain).then_some(Verdict::Unstable);
        let by_motion = || unstable(moves());
        let by_rms = || match self.rms_of {
            RmsOf::Counts => by_counts(),
            RmsOf::Motion => by_motion(),
        };
        match self.criterion {
            Criterion::Rms => by_rms(),
            Criterion::Unsaturated if hit.contact_samples() > 0 && watch.at_limit > 0.0 => {
                Some(Verdict::Unstable)
            }
            Criterion::Unsaturated => by_rms(),
            Criterion::Felt => None,
            Criterion::Quiet => {
                let moves = match self.rms_of {
                    RmsOf::Counts => hit.scatter().must_reach(self.quiet_counts, window),
                    RmsOf::Motion => moves(),
                };
                let outputs = f64::from(window.div_ceil(self.period));
                let needed = self.quiet_force * self.quiet_force * outputs * SURE;
                unstable(moves || watch.force_scatter() > needed)
            }
        }
    }
}

/// A threshold curve, prepared for windows of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct Felt(Band);

/// Energy of a signal in a frequency band, with a weight for each frequency. It is prepared for windows of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    spectrum: RealSpectrum,
    /// The values of Hann's window function.
    window: Vec<f64>,
    /// First bin of the band.
    first: usize,
    /// Weight of the power in each bin.
    weights: Vec<f64>,
}

impl Felt {
    /// Prepares the threshold curve of a scene. `None` if the scene's windows are too short or too long.
    pub fn of(scene: &Scene) -> Option<Self> {
        let (hit, [least_s, most_s]) = (&scene.wall_hit, scene.felt_window_s());
        let plan = scene.hit_settings().build(&scene.design()).ok()?;
        (least_s..=most_s)
            .contains(&hit.window_s)
            .then(|| Self::new(&hit.felt, plan.window as usize, scene.control.rate_hz))
    }

    /// Prepares a threshold curve for windows of `samples` samples.
    pub fn new(curve: &FeltCurve, samples: usize, rate_hz: f64) -> Self {
        Self(Band::new(samples, rate_hz, FELT_HZ, |hz| 1.0 / curve.threshold_m(hz).powi(2)))
    }

    /// Sensation level of the motion, in dB above the threshold.
    pub fn level_db(&self, positions_m: Vec<f64>) -> f64 {
        (10.0 * libm::log10(self.0.energy(positions_m))).max(NO_MOTION_DB)
    }
}

impl Band {
    /// Prepares the band between two frequencies in Hz, for windows of `samples` samples. `weight` gives the weight of
    /// each frequency.
    pub fn new(
        samples: usize,
        rate_hz: f64,
        [from_hz, to_hz]: [f64; 2],
        weight: impl Fn(f64) -> f64,
    ) -> Self {
        let turn = core::f64::consts::TAU / samples.max(1) as f64;
        let window: Vec<f64> =
            (0..samples).map(|n| 0.5 - 0.5 * libm::cos(turn * n as f64)).collect();
        let spectrum = RealSpectrum::new(window.len());
        let length = spectrum.length() as f64;
        let hz = |bin: usize| bin as f64 * rate_hz / length;
        let within = |bin: &usize| (from_hz..=to_hz).contains(&hz(*bin));
        let bins: Vec<usize> = (1..spectrum.length() / 2).filter(within).collect();
        // 2 for both halves of the spectrum, divided by the energy of the window function
        let energy: f64 = window.iter().map(|w| w * w).sum();
        let per_power = 2.0 / (length * energy);
        let weights = bins.iter().map(|bin| per_power * weight(hz(*bin))).collect();
        Self { spectrum, window, first: bins.first().copied().unwrap_or(0), weights }
    }

    /// Weighted mean square of the values about their mean.
    pub fn energy(&self, mut values: Vec<f64>) -> f64 {
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        for (value, window) in values.iter_mut().zip(&self.window) {
            *value = (*value - mean) * window;
        }
        let bins = self.first..self.first + self.weights.len();
        let powers = self.spectrum.powers(&values, bins);
        powers.iter().zip(&self.weights).map(|(power, w)| power * w).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::{SQRT_2, TAU};

    fn tone(hz: f64, rms_m: f64, phase: f64) -> Vec<f64> {
        let at = |n: u32| SQRT_2 * rms_m * libm::sin(TAU * hz * f64::from(n) / 1e4 + phase);
        (0..20_000).map(at).collect()
    }

    #[test]
    fn a_tone_at_the_threshold_is_at_0_db_at_any_phase() {
        let curve = FeltCurve::default();
        let felt = Felt::new(&curve, 20_000, 1e4);
        for hz in
            [5.0, 7.3, 12.0, 18.7, 19.0, 20.3, 21.1, 33.3, 50.0, 100.1, 179.9, 180.2, 250.0, 499.9]
        {
            for phase in [0.0, 0.7, 1.6, 2.5] {
                let level_db = felt.level_db(tone(hz, curve.threshold_m(hz), phase));
                assert!(level_db.abs() < 0.1, "{hz} Hz, {phase}: {level_db}");
            }
        }
    }

    #[test]
    fn two_tones_add_as_energy_and_a_rest_does_not_count() {
        let curve = FeltCurve::default();
        let felt = Felt::new(&curve, 20_000, 1e4);
        let (a, b) = (tone(60.0, 3e-6, 0.3), tone(210.0, 0.4e-6, 1.1));
        let both: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a + b + 0.07).collect();
        let energy = |db: f64| 10f64.powf(db / 10.0);
        let [a, b, both] = [a, b, both].map(|motion| energy(felt.level_db(motion)));
        assert!((both / (a + b) - 1.0).abs() < 1e-4, "{a} {b} {both}");
        assert_eq!(felt.level_db(vec![0.07; 20_000]), NO_MOTION_DB);
        // frequencies outside the band: below 2 Hz and above 1000 Hz
        assert!(felt.level_db(tone(1500.0, 1e-6, 0.0)) < -60.0);
    }
}
