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

/// Impedances that were rendered: geometric means over walls and frequencies, relative to the commanded
/// one.
#[derive(Clone, Debug, PartialEq)]
pub struct Fidelity {
    /// The whole error: `|rendered - commanded|`.
    pub error: f64,
    /// `|rendered - rendered with the true velocity|`: error by the estimator.
    pub of_estimator: f64,
    /// `|rendered with the true velocity - commanded|`: error by the loop, the same for every estimator.
    pub of_loop: f64,
    /// Errors at each wall and frequency, whose means the fields above are.
    pub points: Vec<Point>,
}

/// The impedance at one wall and frequency; errors as in [`Fidelity`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    pub wall: Wall,
    pub frequency_hz: f64,
    /// The whole error: `|rendered - commanded|`.
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

/// Measures that filter in that scene at those walls.
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

/// Force against the motion over motion at one frequency, N/m: of the estimator, and of the true velocity in its place.
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
    // the wall pushes back, hence the sign
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
        let [one, other] = [WALL, soft].map(|wall| of(&scene, 300.0, &[wall]));
        let both = of(&scene, 300.0, &[WALL, soft]);
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
        let small = of(&scene, 150.0, &[WALL]);
        scene.actuator.limit_v *= 50.0;
        let large = of(&scene, 150.0, &[WALL]);
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
