//! Tests the optional elements of scenes: refused values, elements without an effect, and properties of all elements.

use std::f64::consts::PI;

use host_sim::{
    numerics::integrator::{Integrator, STEPS_MAX},
    plant::{AnyPlant, Moment, Plant as _},
    scene::{NamedScene, Scene},
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};
use proptest::{
    prelude::*,
    test_runner::{RngAlgorithm, TestRng, TestRunner},
};
use zwidth::VelocitySettings;

mod random;

const PAPER: &str = include_str!("../../scenes/paper-1um.toml");

const AMPLIFIER: &str = "[amplifier]\nbandwidth_hz = 1500\n";
const MODE: &str = "[mode]\nmass_kg = 0.15\nstiffness_n_per_m = 6e4\ndamping_n_s_per_m = 4\n";
const BACKLASH: &str = "[backlash]\ngap_m = 1e-4\n";
const AMPLIFIER_ERROR: &str = "[amplifier_error]\ncubic = -0.1\n";
const ARM: &str = "[arm]\nmass_kg = 1.2\ndamping_n_s_per_m = 12\nstiffness_n_per_m = 20\nrest_position_m = 0.05\n\
                   grip_damping_n_s_per_m = 25\ngrip_stiffness_n_per_m = 1200\n";
const FRICTION: &str =
    "[friction]\ncoulomb_n = 0.1\nstatic_n = 0.15\nstribeck_speed_m_per_s = 0.01\n";
const OFFSET: &str = "[offset]\nforce_n = 0.3\n";
const COGGING: &str = "[cogging]\namplitude_n = 0.1\npitch_m = 0.004\nphase_rad = 0.3\n";
const SPRING: &str = "[travel]\nstop = \"spring\"\nlow_m = -0.01\nhigh_m = 0.1\nstiffness_n_per_m = 5e4\n\
                      damping_n_s_per_m = 50\n";
const RIGID: &str = "[travel]\nstop = \"rigid\"\nlow_m = -0.01\nhigh_m = 0.1\nrestitution = 0.5\n";
const ENCODER_ERROR: &str =
    "[encoder_error]\ncycle_m = 2e-5\nfirst_m = 3e-7\nsecond_m = 1e-7\nphase_rad = 0\n";
const ENCODER_NOISE: &str = "[encoder_noise]\nrms_m = 5e-7\nseed = 1\n";
const JITTER: &str = "[jitter]\npeak_s = 5e-6\nseed = 1\n";
const RK4: &str = "[integrator]\nmethod = \"rk4\"\nsteps_per_sample = 2\n";
const EULER: &str = "[integrator]\nmethod = \"semi-implicit-euler\"\nsteps_per_sample = 4\n";
const ADAPTIVE: &str = "[integrator]\nmethod = \"dormand-prince\"\nrelative_tolerance = 1e-8\n\
                        absolute_tolerance_m = 1e-12\n";

fn read(tables: &[&str]) -> Result<Scene, String> {
    let text = format!("{PAPER}\n{}", tables.join("\n"));
    NamedScene::parse("test".into(), text, "test.toml")
        .map(|named| named.scene)
        .map_err(|error| error.to_string())
}

fn hit(stiffness_n_per_m: f64, damping_n_s_per_m: f64) -> WallHit {
    let velocity = VelocitySettings::Butterworth { cutoff_hz: 1500.0 };
    WallHit { velocity, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts: 0.0 }
}

/// Runs a hit and returns all bits of every sample.
fn run(scene: &Scene, numeric: Numeric, hit: &WallHit) -> Vec<(u64, i32, u64)> {
    let mut samples = vec![];
    PreparedScene::new(scene)
        .unwrap()
        .hit(numeric, hit, |s| {
            samples.push((s.position_m.to_bits(), s.count, s.output_n.to_bits()))
        })
        .unwrap();
    samples
}

#[test]
fn every_element_is_read_and_runs() {
    let wall = hit(20_000.0, 100.0);
    let plain = run(&read(&[]).unwrap(), Numeric::Fixed, &wall);
    for tables in [
        vec![AMPLIFIER],
        vec![MODE],
        vec![ARM],
        vec![OFFSET],
        vec![AMPLIFIER, MODE, ARM, OFFSET],
        vec![AMPLIFIER_ERROR],
        vec![MODE, BACKLASH, RK4],
        vec![FRICTION, RK4],
        vec![COGGING, ADAPTIVE],
        vec![SPRING, EULER],
        vec![RIGID, RK4],
        vec![ENCODER_ERROR],
        vec![ENCODER_NOISE],
        vec![JITTER],
        vec![RK4],
        vec![
            AMPLIFIER,
            MODE,
            ARM,
            FRICTION,
            COGGING,
            SPRING,
            ENCODER_ERROR,
            ENCODER_NOISE,
            JITTER,
            BACKLASH,
            AMPLIFIER_ERROR,
            ADAPTIVE,
        ],
    ] {
        let scene = read(&tables).unwrap();
        let samples = run(&scene, Numeric::Fixed, &wall);
        assert_eq!(samples.len(), plain.len());
        assert_eq!(samples, run(&scene, Numeric::Fixed, &wall), "{tables:?}: not deterministic");
        let differs = samples.iter().zip(&plain).any(|(a, b)| a != b);
        // The handle does not reach the stops here.
        assert_eq!(differs, !tables.contains(&RIGID) || tables.contains(&RK4), "{tables:?}");
        for sample in &samples {
            assert!(f64::from_bits(sample.0).abs() < 0.2, "{tables:?}");
        }
    }
}

/// A constant force stretches the spring like a shifted rest position, also with an amplifier, an arm or an integrator.
/// A device without a spring gets the acceleration of the force.
#[test]
fn an_offset_is_a_rest_position_that_is_farther() {
    for tables in [
        vec![],
        vec![AMPLIFIER],
        vec![MODE],
        vec![AMPLIFIER, ARM],
        vec![RK4],
        vec![FRICTION, ADAPTIVE],
    ] {
        let plant = |scene: &Scene| {
            let plant = AnyPlant::of(scene, 1e-4, 0.0);
            let mut state = plant.at_rest(0.0);
            let mut positions_m = vec![];
            for n in 0..20_000 {
                state = plant.advance(&state, if n / 2000 % 2 == 0 { 2.0 } else { -1.0 });
                positions_m.push(plant.position_m(&state));
            }
            positions_m
        };
        let pushed = read(&[&tables[..], &[OFFSET]].concat()).unwrap();
        let mut moved = read(&tables).unwrap();
        moved.device.rest_position_m += 0.3 / moved.device.stiffness_n_per_m;
        let [one, other, plain] = [&pushed, &moved, &read(&tables).unwrap()].map(plant);
        let apart = one.iter().zip(&other).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let acts = one.iter().zip(&plain).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-8 && acts > 1e-3, "{tables:?}: {apart:e} {acts:e}");
    }
    let mut free = read(&[OFFSET]).unwrap();
    (free.device.stiffness_n_per_m, free.device.damping_n_s_per_m) = (0.0, 0.0);
    let plant = AnyPlant::of(&free, 1e-4, 0.0);
    let mut state = plant.at_rest(0.0);
    for _ in 0..1000 {
        state = plant.advance(&state, 0.0);
    }
    let speed = 0.3 / free.device.mass_kg * 0.1;
    assert!((plant.speed_m_per_s(&state) / speed - 1.0).abs() < 1e-12);
}

/// An amplifier with an error moves the device like an ideal amplifier with other commands.
#[test]
fn an_amplifier_error_is_another_command() {
    let given_n = |command_n: f64| command_n * (1.0 - 0.1 * (command_n / 5.9).powi(2));
    for tables in [vec![], vec![AMPLIFIER, MODE], vec![JITTER], vec![JITTER, FRICTION, ADAPTIVE]] {
        let [with, plain] = [&[&tables[..], &[AMPLIFIER_ERROR]].concat(), &tables].map(|tables| {
            let mut scene = read(tables).unwrap();
            scene.actuator.gain_n_per_v = 5.9 / scene.actuator.limit_v;
            AnyPlant::of(&scene, 1e-4, 0.3)
        });
        let (mut here, mut there) = (with.at_rest(0.0), plain.at_rest(0.0));
        for index in 0..3000 {
            let [before_n, after_n] =
                [index, index + 1].map(|n: u32| f64::from(n / 40 * 7 % 13) - 5.9);
            let [force_n, later_n] = [before_n, after_n].map(given_n);
            let index = u64::from(index);
            let moments = [
                Moment { index, before_n, after_n },
                Moment { index, before_n: force_n, after_n: later_n },
            ];
            let near = |one: f64, other: f64| (one - other).abs() < 1e-12;
            assert!(near(with.reading_m(&here, &moments[0]), plain.reading_m(&there, &moments[1])));
            assert!(near(with.force_n(&here, before_n), plain.force_n(&there, force_n)));
            here = with.advance_split(&here, before_n, after_n);
            there = plain.advance_split(&there, force_n, later_n);
            here = with.advance(&here, after_n);
            there = plain.advance(&there, later_n);
            assert!(near(with.position_m(&here), plain.position_m(&there)), "{tables:?} {index}");
        }
    }
}

#[test]
fn errors_of_size_zero_change_no_bit() {
    let wall = hit(60_000.0, 300.0);
    let zeroes = [
        JITTER.replace("5e-6", "0"),
        OFFSET.replace("0.3", "0"),
        AMPLIFIER_ERROR.replace("-0.1", "0"),
        ENCODER_NOISE.replace("5e-7", "0"),
        ENCODER_ERROR.replace("3e-7", "0").replace("1e-7", "0"),
    ];
    for numeric in [Numeric::Fixed, Numeric::F64] {
        for base in [vec![], vec![AMPLIFIER, MODE]] {
            let plain = run(&read(&base).unwrap(), numeric, &wall);
            for zero in &zeroes {
                let mut tables = base.clone();
                tables.push(zero);
                assert_eq!(run(&read(&tables).unwrap(), numeric, &wall), plain, "{zero}");
            }
        }
        let none = BACKLASH.replace("1e-4", "0");
        let [with, without] = [&[MODE, RK4, &none][..], &[MODE, RK4]]
            .map(|tables| run(&read(tables).unwrap(), numeric, &wall));
        assert_eq!(with, without, "{none}");
    }
}

#[test]
fn an_amplifier_far_above_the_rate_changes_nothing_but_the_last_digits() {
    // This amplifier is 16 ns late. The exact step accepts any time constant.
    let stiff = read(&["[amplifier]\nbandwidth_hz = 1e7\n"]).unwrap();
    let wall = hit(2000.0, 20.0);
    let report = |scene: &Scene| {
        PreparedScene::new(scene).unwrap().hit(Numeric::F64, &wall, |_| ()).unwrap()
    };
    let (with, without) = (report(&stiff), report(&read(&[]).unwrap()));
    assert_eq!(with.verdict, without.verdict);
    assert!((with.mean_m - without.mean_m).abs() < 2e-6, "{with:?} {without:?}");
}

#[test]
fn noise_differs_between_seeds_and_starts_and_not_between_walls() {
    let readings = |seed: &str, start_offset_counts: f64, stiffness: f64| {
        let scene =
            read(&[&ENCODER_NOISE.replace("seed = 1", seed).replace("5e-7", "5e-6")]).unwrap();
        let prepared = PreparedScene::new(&scene).unwrap();
        let mut simulation =
            prepared.fixed(&WallHit { start_offset_counts, ..hit(stiffness, 0.0) }).unwrap();
        // The samples before the handle reaches the wall.
        (0..500)
            .map(|_| {
                let sample = simulation.step();
                i64::from(sample.count) - (sample.position_m * 1e6).floor() as i64
            })
            .collect::<Vec<_>>()
    };
    let noise = readings("seed = 1", 0.0, 2000.0);
    assert_eq!(noise, readings("seed = 1", 0.0, 50_000.0));
    assert_ne!(noise, readings("seed = 2", 0.0, 2000.0));
    assert_ne!(noise, readings("seed = 1", 0.25, 2000.0));
    let mean = noise.iter().sum::<i64>() as f64 / 500.0;
    let rms = (noise.iter().map(|n| (*n as f64 - mean).powi(2)).sum::<f64>() / 500.0).sqrt();
    // The RMS is expected from 5 counts of noise and the quantiser's variance of 1/12. The spread of an RMS over 500
    // samples is 3.2 %.
    assert!((rms - 5.0).abs() < 0.65 && mean.abs() < 1.0, "{rms} {mean}");
}

#[test]
fn late_readings_see_the_commands_that_act_meanwhile() {
    for latency in ["0.5", "10.0", "10.3"] {
        let text = format!("{PAPER}\n{}", JITTER.replace("5e-6", "4e-5"))
            .replace("latency = 10.0", &format!("latency = {latency}"))
            .replace("resolution_m = 1e-6", "resolution_m = 1e-8"); // a command moves the handle by 10 nm in that time
        let scene = NamedScene::parse("test".into(), text, "test.toml").unwrap().scene;
        assert_eq!(scene.actuator.latency.to_string(), latency.trim_end_matches(".0"));
        let mut simulation =
            PreparedScene::new(&scene).unwrap().fixed(&hit(20_000.0, 100.0)).unwrap();
        let (mut before_n, mut late, mut turns) = (0.0, 0, 0);
        for index in 0..20_000 {
            let state = *simulation.state();
            let sample = simulation.step();
            let moment = Moment { index, before_n, after_n: sample.output_n };
            let reading_m = simulation.plant().reading_m(&state, &moment);
            assert_eq!(
                sample.count,
                (reading_m / 1e-8).floor() as i32,
                "{latency}: sample {index}"
            );
            late += u32::from(reading_m != sample.position_m);
            turns += u32::from(before_n != sample.output_n);
            before_n = sample.output_n;
        }
        assert!(late > 15_000 && turns > 100, "{late} {turns}");
    }
}

#[test]
fn refusals_name_key_value_and_range() {
    for (tables, expected) in [
        (
            vec!["[amplifier]\nbandwidth_hz = 0\n"],
            "amplifier.bandwidth_hz is 0, allowed 1 to 10000000",
        ),
        (vec!["[amplifier]\nbandwidth_hz = 10\nx = 1\n"], "unknown field `x`"),
        (vec![&MODE.replace("0.15", "0")], "mode.mass_kg is 0, allowed 0.001 to 100"),
        (vec![&ARM.replace("= 12\n", "= -1\n")], "arm.damping_n_s_per_m is -1, allowed 0 to"),
        (vec![FRICTION], "[integrator] is missing"),
        (vec![MODE, BACKLASH], "[integrator] is missing"),
        (vec![BACKLASH, RK4], "[mode] is missing, needed with backlash"),
        (
            vec![MODE, &BACKLASH.replace("1e-4", "-1e-4"), RK4],
            "backlash.gap_m is -0.0001, allowed 0 to 1",
        ),
        (
            vec![&AMPLIFIER_ERROR.replace("-0.1", "-0.4")],
            "amplifier_error.cubic is -0.4, allowed -0.3 to 1",
        ),
        (vec![COGGING], "[integrator] is missing"),
        (vec![SPRING], "[integrator] is missing"),
        (vec![&FRICTION.replace("0.15", "0.05"), RK4], "friction.static_n is 0.05, allowed 0.1 to"),
        (vec![&COGGING.replace("0.004", "0"), RK4], "cogging.pitch_m is 0, allowed"),
        (vec![&SPRING.replace("-0.01", "0.2"), RK4], "travel.low_m is 0.2, allowed -1000 to 0.1"),
        (
            vec![&SPRING.replace("-0.01", "0.01"), RK4],
            "device.start_position_m is 0, allowed 0.01 to 0.1",
        ),
        (vec![&RIGID.replace("0.5", "1"), RK4], "travel.restitution is 1, allowed 0 to 0.99"),
        (
            vec![&ENCODER_ERROR.replace("3e-7", "1"), RK4],
            "encoder_error.first_m is 1, allowed 0 to",
        ),
        (
            vec![&OFFSET.replace("0.3", "2e5")],
            "offset.force_n is 200000, allowed -100000 to 100000",
        ),
        (vec![&ENCODER_NOISE.replace("5e-7", "-1")], "encoder_noise.rms_m is -1, allowed 0 to 1"),
        (vec![&ENCODER_NOISE.replace("5e-7", "nan")], "encoder_noise.rms_m is NaN, allowed 0 to 1"),
        (vec![&JITTER.replace("5e-6", "1e-4")], "jitter.peak_s is 0.0001, allowed 0 to"),
        // 50 kN s/m on 0.416 kg gives a time constant of 8 us. This time constant is too short for two steps of
        // Runge-Kutta in 100 us, but not for seven.
        (
            vec![&SPRING.replace("damping_n_s_per_m = 50", "damping_n_s_per_m = 5e4"), RK4],
            "integrator.steps_per_sample is 2, allowed 5 to 10000: the fastest time constant is 8.3e-6 s",
        ),
        // Time constants far below 1 us are refused with the reason. Without friction the step is exact.
        (vec!["[amplifier]\nbandwidth_hz = 1e7\n", FRICTION, RK4], "1.6e-8 s"),
        (
            vec!["[amplifier]\nbandwidth_hz = 1e7\n", FRICTION, ADAPTIVE],
            "without non-linear elements and [integrator] the step is exact",
        ),
        // A test of eigenvalues alone would accept this device. The plant itself has no motion with such a strong
        // damping, but its Euler steps have one.
        (
            vec![
                "[mode]\nmass_kg = 0.625\nstiffness_n_per_m = 1\ndamping_n_s_per_m = 1\n",
                "[arm]\nmass_kg = 0.098\ndamping_n_s_per_m = 6940\nstiffness_n_per_m = 2.8e7\n\
                 rest_position_m = 0.05\ngrip_damping_n_s_per_m = 1\ngrip_stiffness_n_per_m = 1.1e8\n",
                SPRING,
                EULER,
            ],
            "integrator.steps_per_sample is 4, allowed 5 to 10000",
        ),
        (vec![FRICTION, "[integrator]\nmethod = \"verlet\"\n"], "unknown variant `verlet`"),
    ] {
        let message = read(&tables).unwrap_err();
        assert!(message.contains(expected), "{message}\n{expected}");
    }
    assert!(read(&["[amplifier]\nbandwidth_hz = 1e7\n"]).is_ok());
}
