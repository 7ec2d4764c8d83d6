//! Compares the rendered impedance with the commanded impedance `K + j w B`. Chawda, Celik and O'Malley (IEEE/ASME
//! T-Mech 23(2), 2018) plot the fidelity over the Z-width.
//!
//! A sine moves the handle inside each of several walls. The loop of the scene (encoder, estimator, wall, output
//! period, latency) responds with a force. The ratio of the Fourier coefficients of force and motion is the impedance.
//!
//! The encoder's rounding, periodic error, noise and jitter, and the amplifier's pole, are included. Saturation, the
//! rule that the wall never pulls, and the quantisation of the output are not included ([`LEFT_OUT`]). An amplifier
//! error is not included either, because the impedance would depend on the force. Other elements, for example mode, arm
//! or friction, would only change the motion. But here the motion is prescribed.
//!
//! An estimator that needs a force gets the motor's force when it is granted, as in the loop. The hand moves the
//! handle, and the estimator does not get the force of the hand.
//!
//! **The estimator's share.** Hold and latency of the loop change the impedance by the same amount for all estimators.
//! So a second loop uses the true velocity at each sample instead of the estimate. The distance between the impedances
//! of both loops is the error of the estimator.
//!
//! **One number.** Errors grow with the frequency, so the highest frequency would dominate an RMS. The result is the
//! geometric mean over all walls and [`FREQUENCIES_HZ`], which are evenly spaced on a logarithmic scale. So if an
//! estimator halves the error, the effect on the mean is the same at each frequency. An error below [`FLOOR`] is set to
//! [`FLOOR`], because a hand distinguishes two stiffnesses only if they differ by more than some 10 % (Jones and
//! Hunter, Exp. Brain Res. 79, 1990: 23 %). `fidelity.csv` has every point.

use std::{f64::consts::PI, sync::atomic::AtomicBool};

use nalgebra::Complex;

use super::Wall;
use zwidth::VelocitySettings;

use crate::{
    analysis::rendered::{Sine, unlimited},
    error::Error,
    interrupt,
    scene::Scene,
};

/// Errors of the rendered impedances, relative to the commanded impedance. Each error is a geometric mean over walls
/// and frequencies.
#[derive(Clone, Debug, PartialEq)]
pub struct Fidelity {
    /// Total error: `|rendered - commanded|`. The other two errors are parts of it.
    pub error: f64,
    /// Error that comes from the estimator: `|rendered - rendered with the true velocity|`.
    pub of_estimator: f64,
    /// Error that comes from the loop: `|rendered with the true velocity - commanded|`. It is equal for every
    /// estimator.
    pub of_loop: f64,
    /// Errors at each wall and frequency. The fields above are the means of these errors.
    pub points: Vec<Point>,
}

/// The impedance at one wall and one frequency. Its errors are those of [`Fidelity`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    pub wall: Wall,
    pub frequency_hz: f64,
    pub error: f64,
    pub of_estimator: f64,
    pub of_loop: f64,
}

/// Frequencies at which the impedances are compared, in Hz. The range covers the motion of a hand and its touch at a
/// wall. Each frequency is shifted by up to a few parts in a thousand, so that no pattern of counts repeats during the
/// measurement.
pub const FREQUENCIES_HZ: [f64; 7] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];
/// Smallest relative error. Smaller errors are set to it.
pub const FLOOR: f64 = 1e-3;
/// Names of the elements that the computed impedance does not include.
pub const LEFT_OUT: &str = "saturation, push-only, output quantisation, amplifier error, mode, backlash, arm, friction, cogging, travel limits";

/// Measures the rendered impedance at these walls, with the estimator `velocity`.
///
/// # Errors
/// A parameter is out of range, or `stop` was set.
pub fn measure(
    scene: &Scene,
    velocity: VelocitySettings,
    walls: &[Wall],
    stop: &AtomicBool,
) -> Result<Fidelity, Error> {
    let each = walls.iter().map(|wall| at_wall(scene, velocity, wall, stop));
    let points = each.collect::<Result<Vec<_>, Error>>()?.concat();
    let mean = |of: fn(&Point) -> f64| {
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

fn at_wall(
    scene: &Scene,
    velocity: VelocitySettings,
    at: &Wall,
    stop: &AtomicBool,
) -> Result<Vec<Point>, Error> {
    let wall = &at.hit(velocity);
    let (k, b) = (wall.stiffness_n_per_m, wall.damping_n_s_per_m);
    let scene = unlimited(scene, wall, FREQUENCIES_HZ[FREQUENCIES_HZ.len() - 1]);
    let mut points = vec![];
    for about_hz in FREQUENCIES_HZ {
        interrupt::unless(stop)?;
        let sine = Sine::new(&scene, wall, about_hz);
        let frequency_hz = sine.frequency_hz;
        let commanded = Complex::new(k, 2.0 * PI * frequency_hz * b);
        let [rendered, ideal] = impedances(&sine)?;
        let off = [rendered - commanded, rendered - ideal, ideal - commanded];
        let [error, of_estimator, of_loop] = off.map(|off| off.norm() / commanded.norm());
        points.push(Point { wall: *at, frequency_hz, error, of_estimator, of_loop });
    }
    Ok(points)
}

/// Ratio of force to motion at one frequency, in N/m. It is computed from their Fourier coefficients. The first value
/// is with the estimator, the second value is with the true velocity.
fn impedances(sine: &Sine<'_>) -> Result<[Complex<f64>; 2], Error> {
    let wall = sine.wall;
    let mut sums = [Complex::new(0.0, 0.0); 2];
    sine.run(|output| {
        let ideal_n = -wall.stiffness_n_per_m * output.depth_m
            - wall.damping_n_s_per_m * output.speed_m_per_s;
        for (sum, force_n) in sums.iter_mut().zip([output.force_n, ideal_n]) {
            *sum += output.acts * force_n;
        }
    })?;
    // The wall pushes back, so the sign changes.
    Ok(sums.map(|sum| -sine.force_n(sum) / sine.motion()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        NamedScene, Rounding,
        element::{Amplifier, EncoderError, EncoderNoise, Jitter},
    };

    const WALL: Wall = Wall { stiffness_n_per_m: 20_000.0, damping_n_s_per_m: 50.0 };

    fn paper() -> Scene {
        NamedScene::load("paper-1um").unwrap().scene
    }

    fn of(scene: &Scene, cutoff_hz: f64, walls: &[Wall]) -> Fidelity {
        measure(scene, scene.velocity.at(cutoff_hz), walls, &AtomicBool::new(false)).unwrap()
    }

    fn at_4000(scene: &Scene) -> Fidelity {
        of(scene, 4000.0, &[WALL])
    }

    /// Geometric mean of the relative errors at all frequencies. Errors below the floor are set to the floor.
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
        // The force is late by 1.5 ms. There are no other errors.
        let of_loop = mean(|hz| 2.0 * (PI * hz * 1.5e-3).sin());
        assert!((late.of_loop / of_loop - 1.0).abs() < 0.02, "{late:?} {of_loop}");
        // The estimator's delay of 0.1 ms acts only on B.
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
        let [one, other] = [WALL, soft].map(|wall| of(&scene, 300.0, &[wall]));
        let both = of(&scene, 300.0, &[WALL, soft]);
        let middle = (one.of_estimator * other.of_estimator).sqrt();
        assert!(other.of_estimator > 1.3 * one.of_estimator, "{other:?}");
        assert!((both.of_estimator / middle - 1.0).abs() < 1e-12);
        assert_eq!(both.points.len(), 14);
        // An error that is ten times larger at one frequency does not make the mean ten times larger.
        let product: f64 = one.points.iter().map(|p| p.of_estimator.max(FLOOR)).product();
        assert!((one.of_estimator / product.powf(1.0 / 7.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_force_that_an_observer_is_told_does_not_depend_on_the_actuators_range() {
        let mut scene = paper();
        scene.velocity = VelocitySettings::Observer { bandwidth_hz: 0.0, mass_kg: 0.416 }.into();
        let small = of(&scene, 150.0, &[WALL]);
        scene.actuator.limit_v *= 50.0;
        let large = of(&scene, 150.0, &[WALL]);
        assert!((small.error / large.error - 1.0).abs() < 1e-3, "{small:?} {large:?}");
        // The observer in continuous time, with the estimate V^ and the true velocity V: V^ = V + H (U - A), H = (s^2 +
        // 3 w s) / (s + w)^3. A is the acceleration. U is the motor's force divided by the mass, -(K X + B V^) / m. The
        // hold delays U by half a period.
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
        // The count is read later than the controller assumes. So the count is newer when the force acts, and the error
        // is smaller.
        assert!(late.of_loop < plain.of_loop - 1e-3, "{late:?}");
        let rounded = with(|scene| scene.encoder.rounding = Rounding::Round);
        assert!(rounded != plain && (rounded.error - plain.error).abs() < 1e-3, "{rounded:?}");
    }
}
