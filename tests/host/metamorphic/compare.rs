//! Compares delay, noise and roughness of `compare` with a second implementation of the formulas.

use std::{
    f64::consts::{PI, TAU},
    sync::atomic::AtomicBool,
};

use host_sim::{
    analysis::compare::{roughness, signal},
    scene::{Rounding, Scene, element::EncoderError},
    simulation::prepared::{Numeric, PreparedScene, WallHit},
};
use zwidth::VelocitySettings;

use crate::dice::{Dice, cases};

fn measured(scene: &Scene, settings: VelocitySettings) -> signal::Signal {
    signal::measure(scene, settings).unwrap()
}

/// A second-order Butterworth after a difference, or a mean of several differences.
#[derive(Clone, Copy, Debug)]
enum Filter {
    Butterworth(f64),
    Mean(u32),
}

impl Filter {
    fn settings(self) -> VelocitySettings {
        match self {
            Self::Butterworth(cutoff_hz) => VelocitySettings::Butterworth { cutoff_hz },
            Self::Mean(1) => VelocitySettings::Difference {},
            Self::Mean(window_samples) => {
                VelocitySettings::FoawEnd { window_samples, noise_counts: 1e3 }
            }
        }
    }

    /// The filter's impulse response. Its input is the difference of the count.
    fn response(self, rate_hz: f64) -> Vec<f64> {
        match self {
            Self::Mean(n) => vec![1.0 / f64::from(n); n as usize],
            Self::Butterworth(cutoff_hz) => {
                let w = TAU * cutoff_hz / rate_hz;
                let (q, a0) = (2.0 * 2f64.sqrt() * w, 4.0 + 2.0 * 2f64.sqrt() * w + w * w);
                let (mut y, mut before) = ([0.0; 2], [0.0; 2]);
                let length = (20.0 / w) as usize + 100;
                let step = |n: usize| {
                    let x = f64::from(u8::from(n == 0));
                    let sum = w * w * (x + 2.0 * before[0] + before[1]);
                    let out = (sum - (2.0 * w * w - 8.0) * y[0] - (4.0 - q + w * w) * y[1]) / a0;
                    (y, before) = ([out, y[0]], [x, before[0]]);
                    out
                };
                (0..length).map(step).collect()
            }
        }
    }
}

fn filter(dice: &mut Dice, rate_hz: f64) -> Filter {
    if dice.coin() {
        Filter::Butterworth(rate_hz * dice.decades(0.01, 0.1))
    } else {
        Filter::Mean(1)
    }
}

#[test]
fn delay_phase_and_noise_are_those_of_the_impulse_response() {
    cases(4, |dice| {
        let mut scene = dice.scene();
        scene.output = None;
        scene.encoder.resolution_m = dice.decades(3e-7, 3e-6);
        let rate_hz = scene.control.rate_hz;
        let filter = filter(dice, rate_hz);
        let found = measured(&scene, filter.settings());
        let response = filter.response(rate_hz);
        let name = format!("{}: {filter:?} {found:?} {scene:?}", dice.name);
        let at = |hz: f64| {
            let w = TAU * hz / rate_hz;
            let (mut re, mut im) = (0.0, 0.0);
            for (n, h) in response.iter().enumerate() {
                // The difference is the velocity half a sample earlier.
                let angle = w * (n as f64 + 0.5);
                (re, im) = (re + h * angle.cos(), im - h * angle.sin());
            }
            im.atan2(re)
        };
        let slow_hz = 5e-4 * rate_hz;
        let delay_s = -at(slow_hz) / (TAU * slow_hz);
        assert!(
            (found.delay_s.hand - delay_s).abs() < 0.01 * delay_s + 0.02 / rate_hz,
            "{delay_s} {name}"
        );
        let phase = at(100.0).to_degrees();
        assert!((found.phase_100_hz_deg.hand - phase).abs() < 0.3, "{phase} {name}");
        assert_eq!(found.delay_s.hand, found.delay_s.motor);
        // At rest each count is a fair coin toss: independent, with variance 1/4. The filter gets the differences.
        let mut taps = response.clone();
        taps.push(0.0);
        let squares: f64 = (0..taps.len())
            .map(|n| (taps[n] - if n > 0 { taps[n - 1] } else { 0.0 }).powi(2))
            .sum();
        let at_rest = (0.25 * squares).sqrt() * scene.encoder.resolution_m * rate_hz;
        assert!((found.noise_at_rest_m_per_s / at_rest - 1.0).abs() < 0.03, "{at_rest} {name}");
        // In motion, the value is the worst of six speeds, counted and filtered in this file.
        let worst = [0.010_618, 0.038_197, 0.123_606, 0.381_966, 1.127_3, 2.902_7].map(|speed| {
            let count = |n: usize| (speed * n as f64).floor();
            let (first, samples) = (response.len(), 20_000);
            let error = |n: usize| {
                let sum: f64 = response
                    .iter()
                    .enumerate()
                    .map(|(i, h)| h * (count(n - i) - count(n - i - 1)))
                    .sum();
                sum - speed
            };
            ((first + 1..first + 1 + samples).map(|n| error(n).powi(2)).sum::<f64>()
                / samples as f64)
                .sqrt()
        });
        let worst = worst.into_iter().fold(0.0, f64::max) * scene.encoder.resolution_m * rate_hz;
        assert!((found.noise_in_motion_m_per_s / worst - 1.0).abs() < 0.03, "{worst} {name}");
    });
}

#[test]
fn rounding_and_units_of_the_encoder_change_no_figure_in_counts() {
    cases(3, |dice| {
        let mut scene = dice.scene();
        scene.encoder.rounding = Rounding::Floor;
        // Every device reaches a speed of 100 counts per sample.
        scene.wall_hit.push_n = 0.0;
        (scene.actuator.gain_n_per_v, scene.device.mass_kg) = (1e4, 0.02);
        let settings = match dice.below(3) {
            0 => VelocitySettings::TimeStamps { span_samples: 1 + dice.below(20) },
            1 => VelocitySettings::Difference {},
            _ => VelocitySettings::TrackingLoop { bandwidth_hz: 0.02 * scene.control.rate_hz },
        };
        let plain = measured(&scene, settings);
        let mut rounded = scene.clone();
        rounded.encoder.rounding = Rounding::Round;
        let mut larger = scene.clone();
        larger.encoder.resolution_m *= 4.0;
        let mut flawless = scene.clone();
        let (first_m, second_m, phase_rad) = (0.0, 0.0, 0.4);
        flawless.encoder_error = Some(EncoderError { cycle_m: 1e-4, first_m, second_m, phase_rad });
        for (other, times) in [(rounded, 1.0), (larger, 4.0), (flawless, 1.0)] {
            let found = measured(&other, settings);
            let name = format!("{}: {settings:?} {plain:?} {found:?} {other:?}", dice.name);
            let near = |one: f64, other: f64, within: f64| {
                (one - other).abs() <= within * one.abs() + 1e-9
            };
            assert!(
                near(times * plain.noise_at_rest_m_per_s, found.noise_at_rest_m_per_s, 1e-9),
                "{name}"
            );
            assert!(
                near(times * plain.noise_in_motion_m_per_s, found.noise_in_motion_m_per_s, 2e-3),
                "{name}"
            );
            assert!(near(plain.phase_100_hz_deg.hand, found.phase_100_hz_deg.hand, 2e-3), "{name}");
        }
    });
}

/// RMS of the part of a signal above 100 Hz. This function removes the mean, applies a Hann window, and sums sines and
/// cosines for each frequency.
fn rough(signal: &[f64], rate_hz: f64) -> f64 {
    let n = signal.len() as f64;
    let mean = signal.iter().sum::<f64>() / n;
    let window = |i: usize| (PI * i as f64 / n).sin().powi(2);
    let power: f64 = (0..signal.len()).map(|i| window(i).powi(2)).sum();
    let mut sum = 0.0;
    for bin in 0..signal.len() {
        let mirrored = bin.min(signal.len() - bin) as f64;
        if mirrored * rate_hz / n <= 100.0 {
            continue;
        }
        let (mut re, mut im) = (0.0, 0.0);
        for (i, value) in signal.iter().enumerate() {
            let angle = TAU * ((bin * i) % signal.len()) as f64 / n;
            (re, im) = (
                re + (value - mean) * window(i) * angle.cos(),
                im + (value - mean) * window(i) * angle.sin(),
            );
        }
        sum += re * re + im * im;
    }
    (sum / n / power).sqrt()
}

#[test]
fn roughness_is_the_sum_of_the_frequencies_above_100_hz() {
    cases(2, |dice| {
        let mut scene = dice.scene();
        scene.actuator.period = 10;
        scene.control.rate_hz = 1e4;
        scene.wall_hit.window_s = dice.between(0.2, 0.4);
        let wall =
            WallHit { damping_n_s_per_m: 5.0, stiffness_n_per_m: 2000.0, ..dice.wall(&scene) };
        let prepared = PreparedScene::new(&scene).unwrap();
        let found =
            roughness::measure(&prepared, Numeric::Fixed, &wall, &AtomicBool::new(false)).unwrap();
        assert_eq!(found.roughness_n.len(), 16);
        let mut all = true;
        for (hit, roughness_n) in (0..16u32).zip(&found.roughness_n) {
            let hit = WallHit { start_offset_counts: f64::from(hit) / 16.0, ..wall };
            let mut forces_n = vec![];
            let first = (scene.wall_hit.settle_s * 1e4).round() as u64;
            let report = prepared.hit(Numeric::Fixed, &hit, |sample| {
                if sample.index >= first && sample.index % 10 == 0 {
                    forces_n.push(sample.rendered.unwrap().output * scene.full_scale_n());
                }
            });
            all &= report.unwrap().is_stable();
            let second = rough(&forces_n, 1e3);
            let near = (roughness_n - second).abs() <= 1e-9 * second + 1e-12;
            assert!(near, "{}: {roughness_n} {second} {scene:?}", dice.name);
        }
        assert_eq!(found.stable, all);
    });
}
