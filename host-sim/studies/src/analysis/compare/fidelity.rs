//! Rendered against commanded impedance, `K + j w B` (Chawda, Celik, O'Malley, IEEE/ASME T-Mech 23(2),
//! 2018, plot it over the Z-width).
//!
//! The handle is moved inside each of several walls by a sine, the very loop of the scene (encoder, estimator,
//! wall, output period, latency) answers with a force, and the ratio of their Fourier coefficients is
//! the impedance. The encoder rounds as the scene says, its periodic error, noise and jitter are there,
//! and the amplifier's pole. Left out are saturation, the wall that never pulls, and the quantisation of
//! the output ([`LEFT_OUT`]); mode, arm, friction, cogging and travel limits shape the motion, which is
//! prescribed here.
//!
//! An estimator that needs a force is told the motor's as it is granted, as in the loop: the hand moves
//! the handle, and of its force nobody knows.
//!
//! **The estimator's share.** Hold and latency of the loop shift the impedance for all alike. So the
//! same loop runs beside it with the true velocity at the sample in place of the estimate; the distance
//! between the two impedances is what the estimator adds.
//!
//! **One number.** Errors grow with the frequency, so a root of a mean of squares would be that of the
//! highest one. The number is the geometric mean over all walls and [`FREQUENCIES_HZ`], evenly spaced on
//! a logarithmic scale: half the error counts the same wherever it is. What is below [`FLOOR`] counts as
//! that, since a hand tells two stiffnesses apart from some 10 % on (Jones and Hunter, Exp. Brain Res.
//! 79, 1990, have 23 %). `fidelity.csv` has every point.

use std::f64::consts::PI;

use nalgebra::Complex;
use zwidth::units::Force;

use super::Wall;
use crate::{
    error::Error,
    numerics::random,
    plant,
    scene::Scene,
    simulation::{
        controller::{Controller, Fixed},
        prepared::WallHit,
        quantiser::Quantiser,
        senses::{Full, Handle, Sensing},
    },
};

/// Impedances that were rendered: geometric means over walls and frequencies, relative to the commanded
/// one.
#[derive(Clone, Debug, PartialEq)]
pub struct Fidelity {
    /// `|rendered - commanded|`.
    pub error: f64,
    /// `|rendered - rendered with the true velocity|`: what the estimator adds.
    pub of_estimator: f64,
    /// `|rendered with the true velocity - commanded|`: what every estimator meets in this loop.
    pub of_loop: f64,
    /// What they are the means of.
    pub points: Vec<Point>,
}

/// The impedance at one wall and frequency; errors as in [`Fidelity`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// The wall.
    pub wall: Wall,
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// `|rendered - commanded|`.
    pub error: f64,
    /// `|rendered - rendered with the true velocity|`.
    pub of_estimator: f64,
    /// `|rendered with the true velocity - commanded|`.
    pub of_loop: f64,
}

/// Frequencies at which the impedance is compared, Hz: what a hand does and feels of a wall. They are
/// moved by up to a few parts in a thousand, so that no pattern of counts repeats in the record.
pub const FREQUENCIES_HZ: [f64; 7] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];
/// A smaller error counts as this one.
pub const FLOOR: f64 = 1e-3;
/// What is not part of it, for people.
pub const LEFT_OUT: &str =
    "saturation, push-only, output quantisation, mode, arm, friction, cogging, travel limits";

/// Amplitude of the motion, counts: small, as in a contact, but many counts.
const AMPLITUDE_COUNTS: f64 = 100.0;
/// Length of the record, s: two periods of 1 Hz.
const RECORD_S: f64 = 2.0;
/// Time before anything is looked at, s.
const SETTLE_S: f64 = 1.0;

/// Measures the estimator of that scene, at that cutoff, at those walls.
pub fn measure(scene: &Scene, cutoff_hz: f64, walls: &[Wall]) -> Result<Fidelity, Error> {
    let each = walls.iter().map(|wall| at_wall(scene, cutoff_hz, wall));
    let points = each.collect::<Result<Vec<_>, Error>>()?.concat();
    let mean = |of: fn(&Point) -> f64| {
        #[expect(clippy::cast_precision_loss, reason = "a handful of points")]
        let count = points.len().max(1) as f64;
        (points.iter().map(|point| of(point).max(FLOOR).ln()).sum::<f64>() / count).exp()
    };
    Ok(Fidelity {
        error: mean(|point| point.error),
        of_estimator: mean(|point| point.of_estimator),
        of_loop: mean(|point| point.of_loop),
        points,
    })
}

fn at_wall(scene: &Scene, cutoff_hz: f64, at: &Wall) -> Result<Vec<Point>, Error> {
    let wall = &at.hit(cutoff_hz);
    let (k, b) = (wall.stiffness_n_per_m, wall.damping_n_s_per_m);
    let scene = unlimited(scene, wall);
    let mut points = vec![];
    let output_hz = scene.control.rate_hz / f64::from(scene.actuator.period);
    for about_hz in FREQUENCIES_HZ {
        // whole periods in a number of outputs that has no factor in common with theirs (2 and 5)
        let periods = (RECORD_S * about_hz).round();
        let mut outputs = (RECORD_S * output_hz).round();
        while outputs % 2.0 == 0.0 || outputs % 5.0 == 0.0 {
            outputs -= 1.0;
        }
        let frequency_hz = periods * output_hz / outputs;
        let commanded = Complex::new(k, 2.0 * PI * frequency_hz * b);
        let [rendered, ideal] = impedances(&scene, wall, frequency_hz, outputs)?;
        let off = [rendered - commanded, rendered - ideal, ideal - commanded];
        let [error, of_estimator, of_loop] = off.map(|off| off.norm() / commanded.norm());
        points.push(Point { wall: *at, frequency_hz, error, of_estimator, of_loop });
    }
    Ok(points)
}

/// The scene with an actuator that nothing here saturates.
fn unlimited(scene: &Scene, wall: &WallHit) -> Scene {
    let mut scene = scene.clone();
    let depth_m = 4.0 * AMPLITUDE_COUNTS * scene.encoder.resolution_m;
    let [.., highest_hz] = FREQUENCIES_HZ;
    let fastest = 2.0 * PI * highest_hz * AMPLITUDE_COUNTS * scene.encoder.resolution_m;
    // noise may add a count per sample to the velocity, several times over
    let noise = 10.0 * scene.encoder.resolution_m * scene.control.rate_hz;
    let most_n = wall.stiffness_n_per_m * depth_m + wall.damping_n_s_per_m * (fastest + noise);
    scene.actuator.limit_v *= (2.0 * most_n / scene.full_scale_n()).max(1.0);
    scene.output = None;
    scene.wall.push_only = false; // it would clip at high B, where velocity outweighs depth
    scene
}

/// The encoder under a prescribed motion.
struct Encoder<'a> {
    scene: &'a Scene,
    /// Tells this motion's noise from that of others.
    hit: u64,
}

impl Encoder<'_> {
    fn count(&self, sample: u64, position_m: impl Fn(f64) -> f64) -> i32 {
        let scene = self.scene;
        #[expect(clippy::cast_precision_loss, reason = "below 2^32")]
        let mut time = sample as f64;
        if let Some(jitter) = &scene.jitter {
            time += jitter.delay_s(jitter.level(self.hit, sample)) * scene.control.rate_hz;
        }
        let shown_m = plant::Sensing::of(scene).shown_m(position_m(time), self.hit, sample);
        Quantiser::of(&scene.encoder).count(shown_m)
    }
}

/// Force against the motion over motion at one frequency, N/m, over a record of so many outputs: of the
/// estimator, and of the true velocity in its place.
fn impedances(
    scene: &Scene,
    wall: &WallHit,
    frequency_hz: f64,
    record: f64,
) -> Result<[Complex<f64>; 2], Error> {
    let design = scene.design();
    let (resolution_m, rate_hz) = (design.resolution_m, design.rate_hz);
    let settings = scene.settings(wall.cutoff_hz, wall.stiffness_n_per_m, wall.damping_n_s_per_m);
    let surface = settings.build(&design).map_err(Error::input)?.wall.surface().counts();
    let omega = 2.0 * PI * frequency_hz / rate_hz;
    let centre = f64::from(surface) + 2.0 * AMPLITUDE_COUNTS;
    let position_m =
        |sample: f64| (centre + AMPLITUDE_COUNTS * (omega * sample).sin()) * resolution_m;
    let speed_m_per_s =
        |sample: f64| AMPLITUDE_COUNTS * omega * (omega * sample).cos() * resolution_m * rate_hz;
    let handle = |sample: f64| Handle {
        position_m: position_m(sample),
        speed_m_per_s: speed_m_per_s(sample),
    };
    let encoder = Encoder { scene, hit: random::bits(frequency_hz.to_bits(), 0) };
    let first = encoder.count(0, position_m);
    let mut core = Fixed::new(&settings, &design, Force::ZERO, first).map_err(Error::input)?;
    let mut senses = Full::new(scene);
    let latency = scene.actuator.latency;
    let period = f64::from(design.period);
    let settle = (SETTLE_S * rate_hz / period).round() * period;
    let end = settle + record * period;
    let half_step = period / 2.0;
    let mut sums = [Complex::new(0.0, 0.0); 2];
    let (mut index, mut sample) = (0u64, 0.0);
    while sample < end {
        let count = encoder.count(index, position_m);
        if core.sample(count, senses.senses()) {
            let rendered = core.render();
            senses.granted(rendered.force);
            let force_n = rendered.output * design.full_scale_n;
            if sample >= settle {
                let depth_m = f64::from(count - surface) * resolution_m;
                let ideal_n = -wall.stiffness_n_per_m * depth_m
                    - wall.damping_n_s_per_m * speed_m_per_s(sample);
                // A held step of force acts as if it came at the middle of its hold, with the
                // gain of a hold.
                let acts = Complex::from_polar(1.0, -omega * (sample + latency + half_step));
                for (sum, force_n) in sums.iter_mut().zip([force_n, ideal_n]) {
                    *sum += acts * force_n;
                }
            }
        }
        senses.moved(handle(sample), handle(sample + 1.0));
        (index, sample) = (index + 1, sample + 1.0);
    }
    // x = A sin = A (e - e*) / 2j: its coefficient is A / 2j; the wall pushes back, hence the sign
    let hold = (omega * half_step).sin() / (omega * half_step);
    let motion = Complex::new(0.0, -AMPLITUDE_COUNTS * resolution_m / 2.0);
    let lag = scene.amplifier.map_or(Complex::new(1.0, 0.0), |amplifier| {
        Complex::new(1.0, frequency_hz / amplifier.bandwidth_hz).inv()
    });
    Ok(sums.map(|sum| -(sum / record * hold * lag) / motion))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        NamedScene, Rounding,
        element::{Amplifier, EncoderError, EncoderNoise, Jitter},
    };
    use zwidth::VelocitySettings;

    const WALL: Wall = Wall { stiffness_n_per_m: 20_000.0, damping_n_s_per_m: 50.0 };

    fn paper() -> Scene {
        NamedScene::load("paper-1um").unwrap().scene
    }

    fn at_4000(scene: &Scene) -> Fidelity {
        measure(scene, 4000.0, &[WALL]).unwrap()
    }

    /// The geometric mean, with its floor, of a relative error at each frequency.
    fn mean(error: impl Fn(f64) -> f64) -> f64 {
        let logs = FREQUENCIES_HZ.map(|hz| error(hz).max(FLOOR).ln());
        (logs.iter().sum::<f64>() / 7.0).exp()
    }

    #[test]
    fn a_fast_loop_renders_what_is_commanded_and_a_late_one_does_not() {
        let mut scene = paper();
        let late = at_4000(&scene);
        scene.actuator.latency = 0.0;
        scene.actuator.period = 1;
        let fast = at_4000(&scene);
        assert!(fast.error < 0.1 * late.error, "{fast:?} {late:?}");
        // late by 1.5 ms, and nothing else
        let of_loop = mean(|hz| 2.0 * (PI * hz * 1.5e-3).sin());
        assert!((late.of_loop / of_loop - 1.0).abs() < 0.02, "{late:?} {of_loop}");
        // the estimator's delay of 0.1 ms acts on B only
        let share = mean(|hz| {
            let w = 2.0 * PI * hz;
            1.06e-4 * w * (50.0 * w) / 20_000f64.hypot(50.0 * w)
        });
        assert!((late.of_estimator / share - 1.0).abs() < 0.1, "{late:?} {share}");
    }

    #[test]
    fn every_wall_and_frequency_counts_alike() {
        let scene = paper();
        let soft = Wall { stiffness_n_per_m: 2000.0, damping_n_s_per_m: 50.0 };
        let [one, other] = [WALL, soft].map(|wall| measure(&scene, 300.0, &[wall]).unwrap());
        let both = measure(&scene, 300.0, &[WALL, soft]).unwrap();
        let middle = (one.of_estimator * other.of_estimator).sqrt();
        assert!(other.of_estimator > 1.3 * one.of_estimator, "{other:?}");
        assert!((both.of_estimator / middle - 1.0).abs() < 1e-12);
        assert_eq!(both.points.len(), 14);
        // one frequency ten times worse is not ten times worse in all
        let product: f64 = one.points.iter().map(|p| p.of_estimator.max(FLOOR)).product();
        assert!((one.of_estimator / product.powf(1.0 / 7.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_force_that_an_observer_is_told_does_not_depend_on_the_actuators_range() {
        let mut scene = paper();
        scene.velocity = VelocitySettings::Observer { bandwidth_hz: 0.0, mass_kg: 0.416 }.into();
        let small = measure(&scene, 150.0, &[WALL]).unwrap();
        scene.actuator.limit_v *= 50.0;
        let large = measure(&scene, 150.0, &[WALL]).unwrap();
        assert!((small.error / large.error - 1.0).abs() < 1e-3, "{small:?} {large:?}");
        // By its equations, in continuous time: V^ = V + H (U - A), H = (s^2 + 3 w s) / (s + w)^3, A the
        // acceleration, U the motor's force over the mass, -(K X + B V^) / m, half a period late by its hold.
        let (k, b, w) = (20_000.0, 50.0, 2.0 * PI * 150.0);
        for point in small.points {
            let s = Complex::new(0.0, 2.0 * PI * point.frequency_hz);
            let held = (s * -0.5e-3).exp();
            let h = (s * s + s * 3.0 * w) / ((s + w) * (s + w) * (s + w));
            let velocity = (s - h * (held * k / 0.416 + s * s)) / (h * held * b / 0.416 + 1.0);
            let theory = ((velocity - s) * b).norm() / (s * b + k).norm();
            let near = (point.of_estimator / theory - 1.0).abs() < 0.1;
            assert!(near || theory < 2e-3, "{point:?} {theory}");
        }
    }

    #[test]
    fn elements_of_the_scene_that_act_between_handle_and_force_are_there() {
        let plain = at_4000(&paper());
        let with = |edit: fn(&mut Scene)| {
            let mut scene = paper();
            edit(&mut scene);
            at_4000(&scene)
        };
        let lag = with(|scene| scene.amplifier = Some(Amplifier { bandwidth_hz: 200.0 }));
        assert!(lag.of_loop > 1.2 * plain.of_loop, "{lag:?}");
        let error = EncoderError { cycle_m: 2e-4, first_m: 5e-6, second_m: 0.0, phase_rad: 0.0 };
        let wrong = |scene: &mut Scene, error| scene.encoder_error = Some(error);
        let mut scene = paper();
        wrong(&mut scene, error);
        assert!((at_4000(&scene).error - plain.error).abs() > 1e-3);
        let noisy = with(|scene| scene.encoder_noise = Some(EncoderNoise { rms_m: 2e-6, seed: 1 }));
        assert!((noisy.of_estimator - plain.of_estimator).abs() > 1e-3, "{noisy:?} {plain:?}");
        let late = with(|scene| scene.jitter = Some(Jitter { peak_s: 9e-5, seed: 1 }));
        // read later than the controller thinks: less old when the force acts
        assert!(late.of_loop < plain.of_loop - 1e-3, "{late:?}");
        let rounded = with(|scene| scene.encoder.rounding = Rounding::Round);
        assert!(rounded != plain && (rounded.error - plain.error).abs() < 1e-3, "{rounded:?}");
    }
}
