//! Compares the whole loop with analytical results. The tests cover the limit of oscillation, a latency that is no
//! whole number of samples, results that scaling must not change, and the size of fixed-point effects.

use std::ops::ControlFlow;

use host_sim::{
    scene::{NamedScene, Scene},
    simulation::{
        Sample, Simulation,
        controller::Controller,
        prepared::{Numeric, PreparedScene, WallHit},
        twin,
    },
};
use zwidth::VelocitySettings;

fn paper() -> Scene {
    NamedScene::load("paper-1um").unwrap().scene
}

fn hit(cutoff_hz: f64, stiffness_n_per_m: f64, damping_n_s_per_m: f64) -> WallHit {
    let velocity = VelocitySettings::Butterworth { cutoff_hz };
    WallHit { velocity, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts: 0.0 }
}

/// RMS of the position about its mean, over `samples` samples.
fn rms_m<C: Controller + Copy>(simulation: &mut Simulation<C>, samples: u32) -> f64 {
    let mut positions_m = Vec::with_capacity(samples as usize);
    let _: ControlFlow<()> = simulation.run(samples, |sample| {
        positions_m.push(sample.position_m);
        ControlFlow::Continue(())
    });
    let n = f64::from(samples);
    let mean = positions_m.iter().sum::<f64>() / n;
    (positions_m.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// A scene in which the real loop is linear. The handle is deep in a bilateral spring wall. Each sample has an output
/// without latency. Counts are 10 nm long, and the actuator never saturates.
fn linear_scene(rate_hz: f64, stiffness_n_per_m: f64) -> Scene {
    const DEPTH_M: f64 = 1e-3;
    const DEFLECTION_M: f64 = 1e-4;
    let mut scene = paper();
    scene.control.rate_hz = rate_hz;
    scene.sweep.cutoffs_hz = vec![0.1 * rate_hz];
    scene.encoder.resolution_m = 1e-8;
    scene.actuator.gain_n_per_v = 1000.0;
    scene.actuator.limit_v = 10.0;
    scene.actuator.period = 1;
    scene.actuator.latency = 0.0;
    scene.wall.push_only = false;
    // The push that holds the handle at DEPTH_M behind the surface.
    let rest_m = scene.wall.position_m + DEPTH_M;
    let spring_n = scene.device.stiffness_n_per_m * (rest_m - scene.device.rest_position_m);
    scene.wall_hit.push_n = stiffness_n_per_m * DEPTH_M + spring_n;
    scene.device.start_position_m = rest_m + DEFLECTION_M;
    scene
}

/// Runs the loop for six seconds. Returns the amplitude in the last second divided by the amplitude in the first.
fn growth(numeric: Numeric, rate_hz: f64, stiffness_n_per_m: f64) -> f64 {
    fn ratio<C: Controller + Copy>(mut simulation: Simulation<C>, second: u32) -> f64 {
        let early = rms_m(&mut simulation, second);
        rms_m(&mut simulation, 4 * second);
        rms_m(&mut simulation, second) / early
    }
    let prepared = PreparedScene::new(&linear_scene(rate_hz, stiffness_n_per_m)).unwrap();
    let hit = hit(0.1 * rate_hz, stiffness_n_per_m, 0.0);
    let second = rate_hz as u32;
    match numeric {
        Numeric::Fixed => ratio(prepared.fixed(&hit).unwrap(), second),
        _ => ratio(prepared.twin(&hit, twin::Rounding::Exact).unwrap(), second),
    }
}

#[test]
fn oscillations_grow_above_and_decay_below_the_analytic_stiffness() {
    const TOLERANCE: f64 = 1e-4;
    // Exact eigenvalues of mass, damper, spring and zero-order hold, computed by another program.
    for (rate_hz, analytic) in [(1e4, 110_414.42), (1e3, 11_063.49)] {
        for numeric in [Numeric::Fixed, Numeric::F64] {
            let mut bounds = [analytic * 0.9, analytic * 1.12]; // the exact limit is not in the middle of these bounds
            assert!(growth(numeric, rate_hz, bounds[0]) < 1.0);
            assert!(growth(numeric, rate_hz, bounds[1]) > 1.0);
            while bounds[1] - bounds[0] > 2e-5 * analytic {
                let middle = (bounds[0] + bounds[1]) / 2.0;
                bounds[usize::from(growth(numeric, rate_hz, middle) > 1.0)] = middle;
            }
            let error = f64::midpoint(bounds[0], bounds[1]) / analytic - 1.0;
            println!("{rate_hz} Hz, {numeric:?}: {bounds:.1?} N/m, {:+.4} %", error * 100.0);
            for (end, stiffness) in ["below", "above"].into_iter().zip(bounds) {
                crate::figure::figure(
                    &format!("host/closed_loop/{rate_hz}/{numeric:?}_{end}"),
                    stiffness,
                );
            }
            assert!(error.abs() < TOLERANCE, "{rate_hz} Hz, {numeric:?}: {bounds:?}");
        }
    }
}

/// Advances the plant by `dt`, with a Taylor series of twenty terms. This function uses no code of the simulator.
fn taylor(scene: &Scene, [x, v]: [f64; 2], force_n: f64, dt: f64) -> [f64; 2] {
    let device = &scene.device;
    let accelerate = |x: f64, v: f64, force_n: f64| {
        (force_n - device.damping_n_s_per_m * v - device.stiffness_n_per_m * x) / device.mass_kg
    };
    // Each derivative of (x, v) gives the next derivative. The force is constant, so the force enters only once.
    let (mut dx, mut dv) = (v, accelerate(x, v, force_n));
    let (mut sum, mut term) = ([x, v], dt);
    for n in 2..22 {
        sum = [sum[0] + dx * term, sum[1] + dv * term];
        (dx, dv) = (dv, accelerate(dx, dv, 0.0));
        term *= dt / f64::from(n);
    }
    sum
}

#[test]
fn a_fractional_latency_is_exact() {
    /// Largest difference by rounding, in m, between two ways to compute the same 60,000 steps. The loop is stable, so
    /// errors decay.
    const POSITION_ERROR_MAX_M: f64 = 1e-12;
    for latency in [0.3, 10.3, 7.75] {
        let mut scene = paper();
        scene.actuator.latency = latency;
        let prepared = PreparedScene::new(&scene).unwrap();
        let mut simulation = prepared.fixed(&hit(500.0, 4000.0, 30.0)).unwrap();
        let sample_s = 1.0 / scene.control.rate_hz;
        let whole = latency.floor() as usize;
        let split_s = latency.fract() * sample_s;
        let mut state = [scene.device.start_position_m - scene.device.rest_position_m, 0.0];
        let mut commands: Vec<f64> = vec![];
        let mut acting_n = 0.0;
        for n in 0..60_000 {
            let Sample { position_m, rendered, .. } = simulation.step();
            let expected_m = state[0] + scene.device.rest_position_m;
            let error_m = position_m - expected_m;
            assert!(error_m.abs() < POSITION_ERROR_MAX_M, "{latency}: {error_m:e} m at {n}");
            // The commanded force at each sample. It stays constant from output to output.
            let held = rendered.map(|r| r.output * scene.full_scale_n());
            commands.push(held.unwrap_or_else(|| commands.last().copied().unwrap_or(0.0)));
            let new_n = if n >= whole { commands[n - whole] } else { 0.0 };
            state = taylor(&scene, state, acting_n, split_s);
            state = taylor(&scene, state, new_n, sample_s - split_s);
            acting_n = new_n;
        }
    }
}

#[test]
fn scaling_forces_or_lengths_by_a_power_of_two_changes_no_bit() {
    fn run(scene: &Scene, hit: &WallHit) -> Vec<Sample> {
        let mut simulation = PreparedScene::new(scene).unwrap().fixed(hit).unwrap();
        (0..30_000).map(|_| simulation.step()).collect()
    }
    let scene = paper();
    let wall = hit(1500.0, 60_000.0, 200.0);
    let reference = run(&scene, &wall);
    for factor in [0.25, 2.0, 8.0] {
        let mut forces = scene.clone();
        forces.device.mass_kg *= factor;
        forces.device.damping_n_s_per_m *= factor;
        forces.device.stiffness_n_per_m *= factor;
        forces.actuator.gain_n_per_v *= factor;
        forces.wall_hit.push_n *= factor;
        let stiffer = hit(1500.0, 60_000.0 * factor, 200.0 * factor);
        for (scaled, plain) in run(&forces, &stiffer).iter().zip(&reference) {
            assert_eq!(scaled.position_m.to_bits(), plain.position_m.to_bits());
            assert_eq!(scaled.output_n, plain.output_n * factor);
        }
        let mut lengths = scene.clone();
        lengths.device.mass_kg /= factor;
        lengths.device.damping_n_s_per_m /= factor;
        lengths.device.stiffness_n_per_m /= factor;
        lengths.device.rest_position_m *= factor;
        lengths.device.start_position_m *= factor;
        lengths.encoder.resolution_m *= factor;
        lengths.wall.position_m *= factor;
        lengths.wall_hit.rms_limit_m *= factor;
        let softer = hit(1500.0, 60_000.0 / factor, 200.0 / factor);
        for (scaled, plain) in run(&lengths, &softer).iter().zip(&reference) {
            assert_eq!(scaled.count, plain.count);
            assert_eq!(scaled.position_m, plain.position_m * factor);
        }
    }
}

#[test]
fn commands_take_effect_after_their_latency_and_nothing_acts_before_the_first() {
    for (latency, first_effect) in [(0.0, 0), (10.0, 10), (3.0, 3), (25.0, 25)] {
        let mut scene = paper();
        scene.actuator.latency = latency;
        let mut simulation =
            PreparedScene::new(&scene).unwrap().fixed(&hit(500.0, 2000.0, 10.0)).unwrap();
        for n in 0..100 {
            let acting_n = simulation.step().output_n;
            assert_eq!(acting_n != 0.0, n >= first_effect, "latency {latency}, sample {n}");
        }
    }
}

#[test]
fn quantised_outputs_come_near_the_ideal_one_as_their_resolution_grows() {
    use host_sim::scene::Quantisation;
    let run = |output| {
        let mut scene = paper();
        scene.output = output;
        let prepared = PreparedScene::new(&scene).unwrap();
        let wall = hit(500.0, 4000.0, 30.0);
        let fixed = prepared.hit(Numeric::Fixed, &wall, |_| ()).unwrap();
        let twin = prepared.hit(Numeric::F64, &wall, |_| ()).unwrap();
        assert_eq!(fixed.verdict, twin.verdict, "{output:?}");
        fixed.mean_m
    };
    let ideal_m = run(None);
    // The rest position may differ by one code of force divided by the wall's stiffness.
    for (output, codes) in [
        (Quantisation::Dac { bits: 12 }, 2047.0),
        (Quantisation::Pwm { steps: 4500 }, 4500.0),
        (Quantisation::Dac { bits: 24 }, 8_388_607.0),
    ] {
        let off_m = (run(Some(output)) - ideal_m).abs();
        let code_m = 5.906 / codes / 4000.0;
        assert!(off_m < code_m + 1e-7, "{output:?}: {off_m:e} m, one code is {code_m:e} m");
    }
}

#[test]
fn core_and_twin_agree_on_every_force_while_they_see_the_same_counts() {
    // The velocity is rounded to 2^-16 counts per sample. Multiplied by B, it becomes an error of the force. The
    // filter's own shaped error is a few times as large.
    let tolerance = |damping: f64| damping * 1e-6 * 1e4 / 5.906 * 4.0 / 65_536.0 + 1e-8;
    for output in [None, Some(host_sim::scene::Quantisation::Dac { bits: 16 })] {
        for damping in [0.0, 20.0, 200.0] {
            let mut scene = paper();
            scene.output = output;
            scene.wall.push_only = false;
            let prepared = PreparedScene::new(&scene).unwrap();
            let wall = hit(1500.0, 8000.0, damping);
            let mut core = prepared.fixed(&wall).unwrap();
            let mut twin = prepared.twin(&wall, twin::Rounding::Exact).unwrap();
            let code = output.map_or(0.0, |_| 1.0 / 32_767.0);
            let mut compared = 0;
            for _ in 0..60_000 {
                let (a, b) = (core.step(), twin.step());
                if a.count != b.count {
                    break; // from here on the two loops differ
                }
                if let (Some(a), Some(b)) = (a.rendered, b.rendered) {
                    assert!((a.force - b.force).abs() <= tolerance(damping), "{a:?} {b:?}");
                    assert!((a.output - b.output).abs() <= tolerance(damping) + code);
                    compared += 1;
                }
            }
            assert!(compared > 180, "{compared} outputs before the counts part");
        }
    }
}
