//! `identify` against records of known devices: are the parameters right, and are the intervals honest?
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "a test fails loudly"
)]

use std::f64::consts::TAU;

use host_sim::{
    identify::{Estimate, Gain, Identification, Options, Record, identify},
    plant::PlantStep,
    scene::{Device, NamedScene, Rounding},
};
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use rayon::prelude::*;

const RATE_HZ: f64 = 1e4;
const RESOLUTION_M: f64 = 1e-6;
const GAIN_N_PER_V: f64 = 0.5906;
const SECONDS: f64 = 2.0;
/// Pulse, V and s.
const PULSE_V: f64 = 4.0;
const PULSE_S: f64 = 0.2;

/// Shape of the voltage.
#[derive(Clone, Copy, Debug)]
enum Pulses {
    /// +4 V, then -4 V, then nothing.
    Two,
    /// One pulse of 4 V.
    One,
    /// +4 V and -4 V in turn to the end.
    Train,
}

/// How a record is made.
#[derive(Clone, Copy, Debug)]
struct Made {
    device: Device,
    pulses: Pulses,
    noise_counts: f64,
    latency: f64,
    rounding: Rounding,
    seed: u64,
}

const PAPER: Device = Device {
    mass_kg: 0.4160,
    damping_n_s_per_m: 5.5195,
    stiffness_n_per_m: 11.0626,
    rest_position_m: 0.0517,
    start_position_m: 0.0,
};

const PLAIN: Made = Made {
    device: PAPER,
    pulses: Pulses::Two,
    noise_counts: 0.5,
    latency: 10.0,
    rounding: Rounding::Floor,
    seed: 0,
};

fn voltage(pulses: Pulses, row: usize) -> f64 {
    let time_s = row as f64 / RATE_HZ - 0.1;
    let turn = (time_s / PULSE_S).floor();
    match (pulses, turn) {
        (_, turn) if turn < 0.0 => 0.0,
        (Pulses::One | Pulses::Two, 0.0) => PULSE_V,
        (Pulses::Two, 1.0) => -PULSE_V,
        (Pulses::Train, turn) => PULSE_V * if turn % 2.0 == 0.0 { 1.0 } else { -1.0 },
        _ => 0.0,
    }
}

fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
    let (u, v) = (random.random::<f64>(), random.random::<f64>());
    (-2.0 * (1.0 - u).ln()).sqrt() * (TAU * v).cos()
}

/// The record of the exact plant through the encoder. The seed moves the start within a count too.
fn made(made: &Made) -> Record {
    let Made { device, pulses, noise_counts, latency, rounding, seed } = *made;
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let rows = (SECONDS * RATE_HZ) as usize;
    let plant = PlantStep::new(&device, 1.0 / RATE_HZ, latency.fract());
    let mut state = plant.at_rest(device.start_position_m + random.random::<f64>() * RESOLUTION_M);
    let force = |row: i64| {
        if row < 0 { 0.0 } else { GAIN_N_PER_V * voltage(pulses, row as usize) }
    };
    let (mut voltage_v, mut position_m) = (vec![], vec![]);
    for row in 0..rows {
        let counts = plant.position_m(&state) / RESOLUTION_M + noise_counts * normal(&mut random);
        let half = if rounding == Rounding::Round { 0.5 } else { 0.0 };
        position_m.push((counts + half).floor() * RESOLUTION_M);
        voltage_v.push(voltage(pulses, row));
        let late = row as i64 - latency as i64;
        state = if latency.fract() > 0.0 {
            plant.advance_split(&state, force(late - 1), force(late))
        } else {
            plant.advance(&state, force(late))
        };
    }
    Record {
        name: "made".into(),
        start_s: 0.0,
        step_s: 1.0 / RATE_HZ,
        voltage_v,
        position_m,
        may_clip: true,
    }
}

fn options(made: &Made) -> Options {
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    Options {
        latency_s: made.latency / RATE_HZ,
        rounding: made.rounding,
        ..Options::of_scene(&scene, Gain::Given(GAIN_N_PER_V))
    }
}

/// The paper's device and ten random ones that a hand could hold.
fn devices() -> Vec<Device> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(2026);
    let mut between = |low: f64, high: f64| low * (high / low).powf(random.random::<f64>());
    let others = (0..10).map(|_| Device {
        mass_kg: between(0.05, 2.0),
        damping_n_s_per_m: between(0.5, 20.0),
        stiffness_n_per_m: between(5.0, 500.0),
        rest_position_m: between(0.01, 0.1),
        start_position_m: between(0.01, 0.1),
    });
    let mut all = vec![PAPER];
    all.extend(others);
    all
}

const NAMES: [&str; 4] = ["m", "b", "k", "x0"];

/// Error over half-width of each parameter, and error and half-width relative to the true value.
fn judged(found: &Identification, device: &Device) -> [[f64; 3]; 4] {
    let spring = found.spring.unwrap();
    [
        (found.mass_kg, device.mass_kg),
        (found.damping_n_s_per_m, device.damping_n_s_per_m),
        (spring.stiffness_n_per_m, device.stiffness_n_per_m),
        (spring.rest_position_m, device.rest_position_m),
    ]
    .map(|(estimate, truth): (Estimate, f64)| {
        let error = (estimate.value - truth).abs();
        [error / estimate.half_width, error / truth, estimate.half_width / truth]
    })
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Identifies every device with every seed; prints coverage and widths, returns the pooled coverage.
fn campaign(name: &str, base: Made, seeds: u64) -> f64 {
    let cases: Vec<(Device, u64)> = devices()
        .into_iter()
        .flat_map(|device| (0..seeds).map(move |seed| (device, seed)))
        .collect();
    let all: Vec<[[f64; 3]; 4]> = cases
        .par_iter()
        .map(|&(device, seed)| {
            let case = Made { device, seed: seed + 1000, ..base };
            let found = identify(&[made(&case)], &options(&case));
            let found = found.unwrap_or_else(|error| panic!("{case:?}: {error}"));
            let [mass, ..] = judged(&found, &device);
            assert!(mass[1] < 0.01, "{case:?}: mass off by {:.2} %", 100.0 * mass[1]);
            judged(&found, &device)
        })
        .collect();
    let mut inside = 0;
    for (index, name_of) in NAMES.iter().enumerate() {
        let column = || all.iter().map(|case| case[index]);
        let held = column().filter(|case| case[0] <= 1.0).count();
        inside += held;
        println!(
            "{name}: {name_of:>2} in its interval {held} of {}; median error {:.2e}, median half-width {:.2e}, largest error {:.2e} (relative)",
            all.len(),
            median(column().map(|case| case[1])),
            median(column().map(|case| case[2])),
            column().map(|case| case[1]).fold(0.0, f64::max),
        );
    }
    let coverage = inside as f64 / (4 * all.len()) as f64;
    println!("{name}: pooled {:.1} %", 100.0 * coverage);
    coverage
}

#[test]
fn intervals_hold_the_truth() {
    for (name, base, seeds) in [
        ("two pulses, noise 0.5", PLAIN, 10),
        ("two pulses, no noise", Made { noise_counts: 0.0, ..PLAIN }, 10),
        ("two pulses, noise 0.1", Made { noise_counts: 0.1, ..PLAIN }, 10),
        ("one pulse, noise 0.5", Made { pulses: Pulses::One, ..PLAIN }, 10),
        ("train, no noise", Made { pulses: Pulses::Train, noise_counts: 0.0, ..PLAIN }, 10),
    ] {
        let coverage = campaign(name, base, seeds);
        assert!(coverage >= 0.9, "{name}: {coverage}");
    }
}
