//! A second implementation of the sampled loop: a device, an actuator with any delay in samples, an output every few
//! samples, an encoder, a filter, a wall. This implementation uses only the scene from the simulator.

use host_sim::{
    scene::{Rounding, Scene, VelocityTable},
    simulation::{
        Sample,
        prepared::{Numeric, WallHit},
    },
};
use zwidth::{units::Force, velocity::EstimatorName};

use crate::dice::{cases, trace};

/// Moves the device for `time_s` under a constant force. Returns the distance from the rest position, and the speed.
/// Both follow from the power series of the equation of motion. The steps are so short that twenty terms are exact up
/// to rounding.
fn moved(scene: &Scene, [mut x, mut v]: [f64; 2], force_n: f64, time_s: f64) -> [f64; 2] {
    let device = &scene.device;
    let steps = 4;
    let h = time_s / f64::from(steps);
    for _ in 0..steps {
        // x = sum of c[n] h^n: (n + 1) (n + 2) m c[n + 2] + (n + 1) b c[n + 1] + k c[n] is F for n = 0, and 0
        // otherwise.
        let mut c = [0.0; 22];
        (c[0], c[1]) = (x, v);
        for n in 0..20 {
            let (one, two) = (n as f64 + 1.0, n as f64 + 2.0);
            let force_n = if n == 0 { force_n } else { 0.0 };
            let damped = device.damping_n_s_per_m * one * c[n + 1];
            c[n + 2] =
                (force_n - damped - device.stiffness_n_per_m * c[n]) / (device.mass_kg * one * two);
        }
        (x, v) = (0.0, 0.0);
        for n in (0..22).rev() {
            x = x * h + c[n];
            if n > 0 {
                v = v * h + n as f64 * c[n];
            }
        }
    }
    [x, v]
}

/// Runs the loop. Returns the count at every sample, and the force on the handle at the end of the sample. In each
/// sample the handle is also moved by `nudge_m`, with alternating sign.
fn loop_of(scene: &Scene, hit: &WallHit, nudge_m: f64, samples: usize) -> Vec<(i32, f64)> {
    let resolution_m = scene.encoder.resolution_m;
    let (rate_hz, full_n) = (scene.control.rate_hz, scene.full_scale_n());
    let half = if scene.encoder.rounding == Rounding::Round { 0.5 } else { 0.0 };
    let count = |x: f64| ((x + scene.device.rest_position_m) / resolution_m + half).floor();
    let surface = (scene.wall.position_m / resolution_m).round();
    // The core's number format sets the push.
    let bits = f64::from(Force::FULL_SCALE.bits());
    let push_n = (scene.wall_hit.push_n / full_n * bits).round() / bits * full_n;
    // Butterworth by the bilinear transform, s = 2 (1 - z^-1) / (1 + z^-1) per sample.
    let cutoff_hz = hit.velocity.cutoff_hz();
    let w = std::f64::consts::TAU * cutoff_hz.unwrap_or_default() / rate_hz;
    let filtered = cutoff_hz.is_some();
    let s2 = 2f64.sqrt();
    let (mut before, mut inputs, mut outputs) = (0.0, [0.0; 2], [0.0; 2]);
    let start_m = scene.device.start_position_m + hit.start_offset_counts * resolution_m;
    let mut state = [start_m - scene.device.rest_position_m, 0.0];
    let (period, latency) = (scene.actuator.period as usize, scene.actuator.latency);
    let (mut asked, mut acting, mut log) = (vec![], 0.0, vec![]);
    for n in 0..samples {
        let here = count(state[0]);
        let difference = if n == 0 { 0.0 } else { here - before };
        before = here;
        let velocity = if filtered {
            let sum = difference + 2.0 * inputs[0] + inputs[1];
            let (a0, a1, a2) =
                (4.0 + 2.0 * s2 * w + w * w, 2.0 * w * w - 8.0, 4.0 - 2.0 * s2 * w + w * w);
            (w * w * sum - a1 * outputs[0] - a2 * outputs[1]) / a0
        } else {
            difference
        };
        (inputs, outputs) = ([difference, inputs[0]], [velocity, outputs[0]]);
        if n % period == 0 {
            let depth_m = (here - surface) * resolution_m;
            let speed = velocity * resolution_m * rate_hz;
            let mut wall_n = 0.0;
            if depth_m > 0.0 {
                wall_n = hit.stiffness_n_per_m * depth_m + hit.damping_n_s_per_m * speed;
                if scene.wall.push_only {
                    wall_n = wall_n.max(0.0);
                }
            }
            let force_n = (push_n - wall_n).clamp(-full_n, full_n);
            asked.push((n as f64 + latency, force_n));
        }
        // Commands that act from this sample to the next: the command in effect, and a command that takes effect in
        // between.
        let (mut from, until) = (n as f64, n as f64 + 1.0);
        while let Some(&(at, force_n)) = asked.first().filter(|(at, _)| *at < until) {
            state = moved(scene, state, acting, (at - from) / rate_hz);
            (from, acting) = (at, force_n);
            asked.remove(0);
        }
        state = moved(scene, state, acting, (until - from) / rate_hz);
        state[0] += if n % 2 == 0 { nudge_m } else { -nudge_m };
        log.push((here as i32, acting));
    }
    log
}

#[test]
fn the_loop_is_that_of_a_second_text() {
    let (mut whole, mut all) = (0, 0);
    cases(15, |dice| {
        let mut scene = dice.scene();
        scene.output = None;
        let filter = match dice.coin() {
            true => EstimatorName::Difference.defaults(),
            false => EstimatorName::Butterworth.defaults(),
        };
        scene.velocity = VelocityTable::from(filter).with_cutoff(None);
        let hit = WallHit { start_offset_counts: dice.between(0.1, 0.4), ..dice.wall(&scene) };
        let full_n = scene.full_scale_n();
        let simulated = trace(&scene, &hit, Numeric::F64);
        let nudged = |nudge_m| loop_of(&scene, &hit, nudge_m, simulated.len());
        // Some walls are chaotic. So the implementations must agree only until rounding affects the second
        // implementation.
        let [second, before, behind] = [0.0, -1e-13, 1e-13].map(nudged);
        let near =
            |(a, b): (&(i32, f64), &(i32, f64))| a.0 == b.0 && (a.1 - b.1).abs() < 1e-10 * full_n;
        let known =
            |other: &[(i32, f64)]| second.iter().zip(other).take_while(|b| near(*b)).count();
        let known = known(&before).min(known(&behind));
        for (sample, (count, force_n)) in simulated.iter().zip(&second).take(known) {
            let name = format!("{}: sample {} of {scene:?} {hit:?}", dice.name, sample.index);
            assert_eq!(sample.count, *count, "{name}");
            let off_n = sample.output_n - force_n;
            assert!(off_n.abs() < 1e-10 * full_n, "{off_n} {name}");
        }
        whole += u32::from(known == simulated.len());
        let surface = (scene.wall.position_m / scene.encoder.resolution_m).round() as i32;
        let touches = |sample: &Sample| sample.count > surface;
        assert!(simulated[..known].iter().any(touches), "no contact in {scene:?}");
        all += 1;
    });
    assert!(2 * whole > all, "{whole} of {all} runs are predictable to their end");
}
