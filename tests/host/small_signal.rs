//! The stiffness at which small oscillations begin to grow in the simulated loop. The test compares this stiffness with
//! the multirate envelope of the linear analysis. The two programs share only the equations.

use std::ops::ControlFlow;

use host_sim::{
    analysis::linear::{Boundary, Device, Loop, transfer_function},
    scene::{NamedScene, Scene},
    simulation::{
        Simulation,
        controller::Fixed,
        prepared::{PreparedScene, WallHit},
    },
};
use rayon::prelude::*;

use crate::figure::figure;

/// A scene whose loop is linear. The contact is permanent and bilateral, the actuator never saturates, and a count is
/// 10 nm long. The output period stays the scene's, and the latency is `latency`.
fn scene(latency: f64, stiffness_n_per_m: f64) -> Scene {
    const DEPTH_M: f64 = 1e-3;
    const DEFLECTION_M: f64 = 1e-4;
    let mut scene = NamedScene::load("paper-1um").unwrap().scene;
    scene.encoder.resolution_m = 1e-8;
    scene.actuator.gain_n_per_v = 1000.0;
    scene.actuator.latency = latency;
    scene.wall.push_only = false;
    let rest_m = scene.wall.position_m + DEPTH_M;
    let spring_n = scene.device.stiffness_n_per_m * (rest_m - scene.device.rest_position_m);
    scene.wall_hit.push_n = stiffness_n_per_m * DEPTH_M + spring_n;
    scene.device.start_position_m = rest_m + DEFLECTION_M;
    scene
}

/// Whether the oscillation grows. The oscillation grows if its size reaches a limit, at which the handle is still in
/// the wall. The oscillation decays if its size falls below a limit near the counts. Otherwise the sizes after one
/// second and after six seconds decide.
fn grows(latency: f64, cutoff_hz: f64, damping_n_s_per_m: f64, stiffness_n_per_m: f64) -> bool {
    const LARGE_M: f64 = 6e-4;
    const SMALL_M: f64 = 1e-6;
    const CHUNKS_PER_SECOND: u32 = 5;
    let scene = scene(latency, stiffness_n_per_m);
    let chunk = scene.control.rate_hz as u32 / CHUNKS_PER_SECOND;
    let velocity = scene.velocity.at(cutoff_hz);
    let wall = WallHit { velocity, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts: 0.0 };
    let mut simulation = PreparedScene::new(&scene).unwrap().fixed(&wall).unwrap();
    let mut sizes_m = vec![];
    for _ in 0..6 * CHUNKS_PER_SECOND {
        let size_m = size_m(&mut simulation, chunk);
        if size_m > LARGE_M {
            return true;
        }
        if size_m < SMALL_M {
            return false;
        }
        sizes_m.push(size_m);
    }
    sizes_m[sizes_m.len() - 1] > sizes_m[CHUNKS_PER_SECOND as usize]
}

/// Half of the motion's range, in m.
fn size_m(simulation: &mut Simulation<Fixed>, samples: u32) -> f64 {
    let mut ends_m = [f64::INFINITY, f64::NEG_INFINITY];
    let _: ControlFlow<()> = simulation.run(samples, |sample| {
        ends_m = [ends_m[0].min(sample.position_m), ends_m[1].max(sample.position_m)];
        ControlFlow::Continue(())
    });
    (ends_m[1] - ends_m[0]) / 2.0
}

/// K at which the linear analysis predicts the limit of stability, in N/m.
fn envelope(latency: f64, cutoff_hz: f64, damping_n_s_per_m: f64) -> f64 {
    let scene = scene(latency, 1000.0);
    let settings = scene.velocity.at(cutoff_hz);
    let estimator = transfer_function(&settings, &scene.design()).unwrap().unwrap();
    let device = Device {
        mass_kg: scene.device.mass_kg,
        damping_n_s_per_m: scene.device.damping_n_s_per_m,
        stiffness_n_per_m: scene.device.stiffness_n_per_m,
    };
    let mut of = Loop::single_rate(device, scene.control.rate_hz, estimator);
    of.period = scene.actuator.period;
    of.latency_samples = latency;
    Boundary::new(&of).unwrap().at(damping_n_s_per_m).unwrap().stiffness_max
}

#[test]
fn oscillations_start_to_grow_at_the_multirate_envelope() {
    const TOLERANCE: f64 = 0.005;
    const BRACKET: f64 = 0.03;
    let mut points = vec![];
    for latency in [0.0, 0.11, 2.5, 10.0, 13.7] {
        for cutoff_hz in [100.0, 500.0, 2000.0] {
            for damping_n_s_per_m in [0.0, 20.0, 100.0] {
                points.push((latency, cutoff_hz, damping_n_s_per_m));
            }
        }
    }
    let errors: Vec<_> = points
        .par_iter()
        .filter_map(|&(latency, cutoff_hz, damping)| {
            let linear = envelope(latency, cutoff_hz, damping);
            if linear <= 0.0 {
                return None; // unstable even without a spring
            }
            let grows = |k: f64| grows(latency, cutoff_hz, damping, k);
            let mut bounds = [1.0 - BRACKET, 1.0 + BRACKET];
            let name = format!("latency {latency}, {cutoff_hz} Hz, B = {damping}");
            assert!(!grows(bounds[0] * linear), "{name}: grows 3 % below {linear}");
            assert!(grows(bounds[1] * linear), "{name}: decays 3 % above {linear}");
            while bounds[1] - bounds[0] > 2e-4 {
                let middle = f64::midpoint(bounds[0], bounds[1]);
                bounds[usize::from(grows(middle * linear))] = middle;
            }
            Some((name, linear, bounds[0] - 1.0))
        })
        .collect();
    for (name, linear, error) in &errors {
        println!("{name}: {linear:.1} N/m, simulated {:+.3} %", 100.0 * error);
    }
    assert!(errors.len() >= 20, "{}", errors.len());
    let worst = errors.iter().map(|(_, _, error)| error.abs()).fold(0.0, f64::max);
    println!("{} points, worst {:.3} %", errors.len(), 100.0 * worst);
    figure("host/small_signal/points", errors.len());
    figure("host/small_signal/worst", worst);
    assert!(worst <= TOLERANCE, "{worst}");
}
