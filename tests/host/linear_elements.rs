//! Runs the simulated loop with linear elements, and compares its limit of oscillation with the linear analysis.

use std::ops::ControlFlow;

use host_sim::{
    analysis::linear::{Boundary, Device, Elements, Loop, TransferFunction},
    scene::{
        NamedScene, Scene,
        element::{Amplifier, Arm, Mode},
    },
    simulation::{
        prepared::{PreparedScene, WallHit},
        twin,
    },
};
use zwidth::VelocitySettings;

const AMPLIFIER: Amplifier = Amplifier { bandwidth_hz: 400.0 };
const MODE: Mode = Mode { mass_kg: 0.15, stiffness_n_per_m: 6e4, damping_n_s_per_m: 4.0 };
const WALL_M: f64 = 0.07;
/// Depth of the handle at rest behind the surface of the wall, in m. The handle never leaves the wall.
const DEPTH_M: f64 = 1e-3;
/// Distance of the start from the rest position, in m.
const DEFLECTION_M: f64 = 1e-4;
const ARM: Arm = Arm {
    mass_kg: 1.2,
    damping_n_s_per_m: 12.0,
    stiffness_n_per_m: 250.0,
    rest_position_m: WALL_M + DEPTH_M,
    grip_damping_n_s_per_m: 25.0,
    grip_stiffness_n_per_m: 1200.0,
};

struct Point {
    elements: Elements,
    cutoff_hz: f64,
    damping_n_s_per_m: f64,
    period: u32,
    latency: f64,
}

fn envelope(point: &Point) -> f64 {
    let estimator = TransferFunction::paper(1e4, point.cutoff_hz).unwrap();
    let of = Loop {
        elements: point.elements,
        period: point.period,
        latency_samples: point.latency,
        ..Loop::single_rate(Device::PAPER, 1e4, estimator)
    };
    Boundary::new(&of).unwrap().at(point.damping_n_s_per_m).unwrap().stiffness_max
}

/// A scene in which the handle is deep in a wall without a surface. A count is 10 nm, and the actuator never saturates.
fn scene(point: &Point, stiffness_n_per_m: f64) -> Scene {
    let mut scene = NamedScene::load("paper-1um").unwrap().scene;
    scene.encoder.resolution_m = 1e-8;
    scene.actuator.gain_n_per_v = 10_000.0;
    scene.actuator.period = point.period;
    scene.actuator.latency = point.latency;
    scene.wall.push_only = false;
    scene.wall.position_m = WALL_M;
    let rest_m = WALL_M + DEPTH_M;
    let spring_n = scene.device.stiffness_n_per_m * (rest_m - scene.device.rest_position_m);
    scene.wall_hit.push_n = stiffness_n_per_m * DEPTH_M + spring_n;
    scene.device.start_position_m = rest_m + DEFLECTION_M;
    (scene.amplifier, scene.mode, scene.arm) =
        (point.elements.amplifier, point.elements.mode, point.elements.arm);
    scene
}

/// Amplitude in the sixth second divided by the amplitude in the third second.
fn growth(point: &Point, stiffness_n_per_m: f64) -> f64 {
    let prepared = PreparedScene::new(&scene(point, stiffness_n_per_m)).unwrap();
    let hit = WallHit {
        velocity: VelocitySettings::Butterworth { cutoff_hz: point.cutoff_hz },
        stiffness_n_per_m,
        damping_n_s_per_m: point.damping_n_s_per_m,
        start_offset_counts: 0.0,
    };
    let mut simulation = prepared.twin(&hit, twin::Rounding::Exact).unwrap();
    let mut positions_m = vec![];
    let _: ControlFlow<()> = simulation.run(60_000, |sample| {
        positions_m.push(sample.position_m);
        ControlFlow::Continue(())
    });
    let rms = |second: usize| {
        let part = &positions_m[10_000 * second..10_000 * (second + 1)];
        let mean = part.iter().sum::<f64>() / 1e4;
        (part.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 1e4).sqrt()
    };
    rms(5) / rms(2)
}

#[test]
fn growth_and_decay_change_places_at_the_envelope() {
    /// Relative distance from the envelope at which the motion must clearly grow or decay.
    const ASIDE: f64 = 0.005;
    let (amplifier, mode, arm) = (Some(AMPLIFIER), Some(MODE), Some(ARM));
    let none = Elements::default();
    let sets = [
        Elements { amplifier, ..none },
        Elements { mode, ..none },
        Elements { arm, ..none },
        Elements { amplifier, mode, ..none },
        Elements { mode, arm, ..none },
        Elements { amplifier, mode, arm },
    ];
    let (mut points, mut moved) = (0, 0);
    for elements in sets {
        for (cutoff_hz, damping_n_s_per_m, period, latency) in [
            (500.0, 20.0, 10, 0.0),
            (1500.0, 60.0, 10, 10.0),
            (1000.0, 40.0, 1, 3.3),
            (200.0, 0.0, 10, 4.5),
        ] {
            let point = Point { elements, cutoff_hz, damping_n_s_per_m, period, latency };
            let limit = envelope(&point);
            let plain = envelope(&Point { elements: none, ..point });
            let (below, above) =
                (growth(&point, limit * (1.0 - ASIDE)), growth(&point, limit * (1.0 + ASIDE)));
            println!(
                "{elements:?} {cutoff_hz} Hz B {damping_n_s_per_m}: {limit:.0} N/m (plain {plain:.0}): {below:.3} {above:.3}"
            );
            assert!(limit > 0.0 && below < 1.0 && above > 1.0);
            points += 1;
            moved += u32::from((limit / plain - 1.0).abs() > 0.02);
        }
    }
    crate::figure::figure("host/linear_elements/points", points);
    assert!(moved > 20, "the elements hardly matter: {moved}");
}
