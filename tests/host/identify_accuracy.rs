//! `identify` on records of known devices. Are the parameters right? Do the intervals contain the true values as often
//! as stated?

use std::f64::consts::TAU;

use crate::figure::figure;
use host_sim::{
    analysis::identify::{Drive, Estimate, Gain, Identification, Options, Record, identify},
    plant::{Plant as _, PlantStep},
    scene::{Device, NamedScene, Rounding},
};
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use rayon::prelude::*;

pub const RATE_HZ: f64 = 1e4;
pub const RESOLUTION_M: f64 = 1e-6;
pub const GAIN_N_PER_V: f64 = 0.5906;
pub const SECONDS: f64 = 2.0;
/// Voltage of a pulse in V. `PULSE_S` is its duration in s.
pub const PULSE_V: f64 = 4.0;
const PULSE_S: f64 = 0.2;

#[derive(Clone, Copy, Debug)]
pub enum Pulses {
    /// A pulse of +4 V, then a pulse of -4 V, then 0 V.
    Two,
    /// One pulse of 4 V.
    One,
    /// Alternately +4 V and -4 V to the end.
    Train,
}

#[derive(Clone, Copy, Debug)]
pub struct Made {
    pub device: Device,
    pub pulses: Pulses,
    pub noise_counts: f64,
    pub latency: f64,
    pub rounding: Rounding,
    pub seed: u64,
}

pub const PAPER: Device = Device {
    mass_kg: 0.4160,
    damping_n_s_per_m: 5.5195,
    stiffness_n_per_m: 11.0626,
    rest_position_m: 0.0517,
    start_position_m: 0.0,
};

const RESTING: Device = Device { start_position_m: PAPER.rest_position_m, ..PAPER };

pub const PLAIN: Made = Made {
    device: PAPER,
    pulses: Pulses::Two,
    noise_counts: 0.5,
    latency: 10.0,
    rounding: Rounding::Floor,
    seed: 0,
};

pub fn voltage(pulses: Pulses, row: usize) -> f64 {
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

pub fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
    let (u, v) = (random.random::<f64>(), random.random::<f64>());
    (-2.0 * (1.0 - u).ln()).sqrt() * (TAU * v).cos()
}

/// Simulates the exact plant and records it as the encoder reads it. The seed also moves the start within a count.
pub fn made(made: &Made) -> Record {
    let Made { device, pulses, noise_counts, latency, rounding, seed } = *made;
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let rows = (SECONDS * RATE_HZ) as usize;
    let plant = PlantStep::new(&device, 1.0 / RATE_HZ, latency.fract());
    let mut state = plant.at_rest(device.start_position_m + random.random::<f64>() * RESOLUTION_M);
    let force = |row: i64| {
        if row < 0 { 0.0 } else { GAIN_N_PER_V * voltage(pulses, row as usize) }
    };
    let (mut command, mut position_m) = (vec![], vec![]);
    for row in 0..rows {
        let counts = plant.position_m(&state) / RESOLUTION_M + noise_counts * normal(&mut random);
        let half = if rounding == Rounding::Round { 0.5 } else { 0.0 };
        position_m.push((counts + half).floor() * RESOLUTION_M);
        command.push(voltage(pulses, row));
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
        command,
        position_m,
        drive: Drive::default(),
        may_clip: true,
    }
}

pub fn options(made: &Made) -> Options {
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    Options {
        latency_s: made.latency / RATE_HZ,
        rounding: made.rounding,
        ..Options::of_scene(&scene, Gain::Given(GAIN_N_PER_V))
    }
}

/// The paper's device and ten random devices that a hand could hold.
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

/// Three numbers for each parameter. The first is the error divided by the half-width of the interval. The others are
/// the error and the half-width, both relative to the true value.
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

/// Identifies every device with every seed. Prints coverage and widths. Returns the coverage over all devices and
/// seeds.
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
        if seeds == 50 {
            let leave = |key: &str, value: f64| {
                figure(&format!("host/identify_accuracy/{name}/{name_of}_{key}"), value);
            };
            leave("held", held as f64);
            leave("error", median(column().map(|case| case[1])));
            leave("half_width", median(column().map(|case| case[2])));
            leave("largest", column().map(|case| case[1]).fold(0.0, f64::max));
        }
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
    if seeds == 50 {
        figure(&format!("host/identify_accuracy/{name}/pooled"), coverage);
        figure("host/identify_accuracy/records", all.len());
    }
    coverage
}

#[test]
fn intervals_hold_the_truth() {
    for (name, base) in [
        ("two pulses, noise 0.5", PLAIN),
        ("two pulses, no noise", Made { noise_counts: 0.0, ..PLAIN }),
    ] {
        let coverage = campaign(name, base, 5);
        assert!(coverage >= 0.9, "{name}: {coverage}");
    }
}

#[test]
#[ignore = "2750 records take minutes; the short one runs always"]
fn intervals_hold_the_truth_in_every_kind_of_record() {
    let quiet = Made { noise_counts: 0.0, ..PLAIN };
    for (name, base) in [
        ("two pulses, noise 0.5", PLAIN),
        ("one pulse, noise 0.5", Made { pulses: Pulses::One, ..PLAIN }),
        ("two pulses, noise 0.1", Made { noise_counts: 0.1, ..PLAIN }),
        ("two pulses, no noise", quiet),
        ("train, no noise", Made { pulses: Pulses::Train, ..quiet }),
    ] {
        let coverage = campaign(name, base, 50);
        assert!(coverage >= 0.93, "{name}: {coverage}");
    }
}

fn cut(record: &Record, seconds: f64) -> Record {
    let rows = (seconds * RATE_HZ) as usize;
    Record {
        command: record.command[..rows].to_vec(),
        position_m: record.position_m[..rows].to_vec(),
        ..record.clone()
    }
}

#[test]
fn a_hopeless_record_is_refused_with_the_reason() {
    let good = made(&PLAIN);
    let opts = options(&PLAIN);
    let with = |change: &dyn Fn(usize, &mut f64, &mut f64)| {
        let mut record = good.clone();
        for row in 0..record.len() {
            let (volts, position_m) = (&mut record.command[row], &mut record.position_m[row]);
            change(row, volts, position_m);
        }
        record
    };
    let of = |device: Device| made(&Made { device, ..PLAIN });
    let noise = made(&Made { pulses: Pulses::One, ..PLAIN });
    let cases: [(&str, Record, Options, &str); 14] = [
        (
            "no excitation",
            with(&|_, volts, _| *volts = 1.0),
            opts,
            "no excitation: the voltage stays at 1 V",
        ),
        (
            "no motion",
            with(&|_, _, x| *x = 7e-6),
            opts,
            "no motion: the position moves by 0 counts",
        ),
        (
            "held by hand",
            with(&|row, _, x| *x = ((row * 7919 % 40) as f64) * 1e-6),
            opts,
            "describe this record",
        ),
        (
            "saturated",
            with(&|_, volts, _| *volts *= 2.5),
            opts,
            "at or beyond actuator.limit_v of 10 V",
        ),
        ("before the pulse", cut(&good, 0.09), opts, "no excitation"),
        ("too short", cut(&of(RESTING), 0.12), opts, "the record does not show the"),
        (
            "reversed",
            with(&|_, volts, _| *volts = -*volts),
            opts,
            "does not accelerate with the voltage",
        ),
        (
            "overdamped",
            of(Device { mass_kg: 1e-3, damping_n_s_per_m: 2e3, stiffness_n_per_m: 50.0, ..PAPER }),
            opts,
            "the record does not show the mass",
        ),
        ("no spring", of(Device { stiffness_n_per_m: 0.0, ..PAPER }), opts, "--no-spring"),
        (
            "a stop",
            with(&|_, _, x| *x = x.min(0.03)),
            opts,
            "of the motion, at least 99 % are needed",
        ),
        (
            "another handle",
            Record { command: noise.command.iter().rev().copied().collect(), ..good.clone() },
            opts,
            "of the motion",
        ),
        (
            "another encoder",
            with(&|_, _, x| *x = (*x * 1e6).round() * 2e-6),
            opts,
            "moves in steps of 2 counts",
        ),
        (
            "no counts",
            with(&|row, _, x| *x += 3e-7 * row as f64),
            opts,
            "give the encoder's --resolution",
        ),
        (
            "negative gain",
            good.clone(),
            Options { gain: Gain::Given(-0.59), ..opts },
            "--gain is -0.59",
        ),
    ];
    for (name, record, options, wanted) in cases {
        let Err(error) = identify(&[record], &options) else { panic!("{name}: not refused") };
        println!("{name}: {error}");
        assert!(error.contains(wanted), "{name}: {error} should say {wanted}");
    }
    let latency_s = 1.995;
    let error = identify(std::slice::from_ref(&good), &Options { latency_s, ..opts }).unwrap_err();
    assert!(error.contains("after the latency"), "{error}");
    let added = Options { gain: Gain::AddedMass { mass_kg: 0.2 }, ..opts };
    let error = identify(std::slice::from_ref(&good), &added).unwrap_err();
    assert!(error.contains("--added-mass needs two records"), "{error}");
    let error = identify(&[good.clone(), good.clone()], &added).unwrap_err();
    println!("same mass: {error}");
    assert!(error.contains("does not show more mass") || error.contains("do not show the gain"));
}

/// Most of the record is at rest without noise. The record has a constant error of up to half a count. Averaging does
/// not remove this error.
#[test]
#[ignore = "100 records; CI runs it"]
fn a_record_that_rests_keeps_honest_intervals() {
    let seeds = 100;
    let all: Vec<[[f64; 2]; 4]> = (0..seeds)
        .into_par_iter()
        .map(|seed| {
            // Every position within a count, also at its edge.
            let rest_position_m = PAPER.rest_position_m + seed as f64 / seeds as f64 * RESOLUTION_M;
            let device = Device {
                start_position_m: rest_position_m,
                rest_position_m,
                stiffness_n_per_m: 400.0,
                damping_n_s_per_m: 20.0,
                ..PAPER
            };
            let case = Made { device, noise_counts: 0.0, pulses: Pulses::One, seed, ..PLAIN };
            let found = identify(&[made(&case)], &options(&case)).unwrap();
            assert!(found.residual.is_bound_by_quantisation());
            assert!(found.warnings.iter().any(|warning| warning.contains("quantisation")));
            let spring = found.spring.unwrap();
            [
                (found.mass_kg, device.mass_kg),
                (found.damping_n_s_per_m, device.damping_n_s_per_m),
                (spring.stiffness_n_per_m, device.stiffness_n_per_m),
                (spring.rest_position_m, device.rest_position_m),
            ]
            .map(|(estimate, truth)| {
                let error = (estimate.value - truth).abs();
                [error / estimate.half_width, error / estimate.white_half_width]
            })
        })
        .collect();
    let [stated, white] = [0, 1].map(|kind| {
        for (index, name) in NAMES.iter().enumerate() {
            let ratios = || all.iter().map(|case| case[index][kind]);
            let held = ratios().filter(|ratio| *ratio <= 1.0).count();
            let kind = ["stated", "white"][kind];
            println!(
                "{kind}: {name} held {held} of {seeds}, median error {:.2} half-widths",
                median(ratios())
            );
        }
        let held = all.iter().flatten().filter(|ratios| ratios[kind] <= 1.0).count();
        held as f64 / (4 * all.len()) as f64
    });
    println!(
        "at rest: {:.1} % in the stated intervals, {:.1} % in those of white noise",
        100.0 * stated,
        100.0 * white
    );
    figure("host/identify_accuracy/at rest/stated", stated);
    assert!(stated >= 0.9);
}

#[test]
fn the_gain_follows_from_an_added_mass() {
    let added_kg = 0.2;
    let all: Vec<[f64; 2]> = (0..20)
        .into_par_iter()
        .map(|seed| {
            let light = Made { seed: 2 * seed, ..PLAIN };
            let heavy = Device { mass_kg: PAPER.mass_kg + added_kg, ..PAPER };
            let heavy = Made { device: heavy, seed: 2 * seed + 1, ..PLAIN };
            let options =
                Options { gain: Gain::AddedMass { mass_kg: added_kg }, ..options(&PLAIN) };
            let found = identify(&[made(&light), made(&heavy)], &options).unwrap();
            let gain = found.gain_n_per_v;
            let error = (gain.value - GAIN_N_PER_V).abs();
            assert!(judged(&found, &PAPER)[0][1] < 1e-2);
            [error / gain.half_width, error / GAIN_N_PER_V]
        })
        .collect();
    let held = all.iter().filter(|case| case[0] <= 1.0).count();
    let largest = all.iter().map(|case| case[1]).fold(0.0, f64::max);
    println!("gain in its interval {held} of 20, largest error {largest:.1e} relative");
    assert!(held >= 16 && largest < 1e-4);
}

#[test]
fn the_latency_is_found_from_a_wrong_first_value() {
    for latency in [0.0, 0.37, 10.0, 23.6] {
        let case = Made { latency, ..PLAIN };
        let options = Options { fit_latency: true, latency_s: 1e-3, ..options(&case) };
        let found = identify(&[made(&case)], &options).unwrap();
        let error = found.latency_s.value * RATE_HZ - latency;
        println!(
            "latency {latency}: off by {error:+.5} +- {:.5} samples",
            found.latency_s.half_width * RATE_HZ
        );
        assert!(error.abs() < 2.0 * found.latency_s.half_width * RATE_HZ);
        assert!(judged(&found, &PAPER)[0][1] < 1e-4);
    }
}

#[test]
fn a_sensor_that_rounds_and_one_without_counts_have_no_offset() {
    let rounded = Made { rounding: Rounding::Round, ..PLAIN };
    let found = identify(&[made(&rounded)], &options(&rounded)).unwrap();
    assert!(judged(&found, &PAPER).iter().all(|one| one[0] < 2.0));
    // The error is the offset itself: half a count of the rest position.
    let wrong = Options { rounding: Rounding::Floor, ..options(&rounded) };
    let off = identify(&[made(&rounded)], &wrong).unwrap().spring.unwrap().rest_position_m;
    let own = found.spring.unwrap().rest_position_m;
    assert!(((off.value - own.value) / RESOLUTION_M - 0.5).abs() < 1e-3);
    assert!(own.half_width < 0.1 * RESOLUTION_M);
}
