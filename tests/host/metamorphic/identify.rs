//! Tests symmetries of `identify`. Records in other units, or that are reversed, shifted or repeated, must give the
//! same device.

use host_sim::{
    analysis::identify::{Drive, Estimate, Gain, Identification, Options, Record, Terms, identify},
    plant::{Plant as _, PlantStep},
    scene::{Device, Rounding},
};

use crate::dice::{Dice, cases};

const RATE_HZ: f64 = 2e3;
const RESOLUTION_M: f64 = 1.0 / 1_048_576.0; // whole counts are exact in binary

fn record(dice: &mut Dice) -> (Record, Options) {
    let device = Device {
        mass_kg: dice.between(0.2, 0.8),
        damping_n_s_per_m: dice.between(3.0, 8.0),
        stiffness_n_per_m: dice.between(8.0, 40.0),
        rest_position_m: dice.between(-0.02, 0.02),
        start_position_m: 0.0,
    };
    let gain = 0.5;
    let plant = PlantStep::new(&device, 1.0 / RATE_HZ, 0.0);
    let mut state = plant.at_rest(device.start_position_m);
    let (mut command, mut position_m) = (vec![], vec![]);
    for row in 0..4000 {
        let volt = match row / 400 {
            1 | 4 => 4.0,
            2 | 7 => -4.0,
            _ => 0.0,
        };
        let counts = plant.position_m(&state) / RESOLUTION_M + 0.5 * dice.normal();
        position_m.push(counts.round() * RESOLUTION_M);
        command.push(volt);
        state = plant.advance(&state, gain * volt);
    }
    let record = Record {
        name: "made".into(),
        start_s: 0.0,
        step_s: 1.0 / RATE_HZ,
        command,
        position_m,
        drive: Drive::default(),
        may_clip: true,
    };
    let options = Options {
        gain: Gain::Given(gain),
        latency_s: 0.0,
        fit_latency: false,
        spring: true,
        resolution_m: RESOLUTION_M,
        rounding: Rounding::Round,
        limit_v: 10.0,
        terms: Terms::Auto,
        rest_position_m: None,
        cycle_m: None,
    };
    (record, options)
}

fn estimates(found: &Identification) -> [Estimate; 4] {
    let spring = found.spring.unwrap();
    [found.mass_kg, found.damping_n_s_per_m, spring.stiffness_n_per_m, spring.rest_position_m]
}

/// Checks for each parameter that `other = times * one + more`, within a fraction of the interval. Here `one` and
/// `other` are the two estimates. The width of the interval must become `times * width` times as large.
#[track_caller]
fn same(
    name: &str,
    one: &Identification,
    other: &Identification,
    times: [f64; 4],
    more: [f64; 4],
    width: f64,
) {
    for (n, (one, other)) in estimates(one).into_iter().zip(estimates(other)).enumerate() {
        let expected = one.value * times[n] + more[n];
        let interval = one.half_width * times[n].abs();
        assert!(
            (other.value - expected).abs() < 0.02 * interval,
            "{name}: parameter {n}: {one:?} {other:?}"
        );
        let ratio = other.half_width / interval;
        assert!((ratio / width - 1.0).abs() < 0.05, "{name}: width of {n}: {one:?} {other:?}");
    }
}

#[test]
fn other_units_signs_and_places_are_the_same_device() {
    cases(3, |dice| {
        let (plain, options) = record(dice);
        let found = identify(std::slice::from_ref(&plain), &options).unwrap();
        let none = [0.0; 4];
        let with = |edit: &dyn Fn(&mut Record, &mut Options)| {
            let (mut record, mut options) = (plain.clone(), options);
            edit(&mut record, &mut options);
            identify(&[record], &options).unwrap()
        };
        let name = |what: &str| format!("{}: {what}", dice.name);
        let each =
            |values: &mut Vec<f64>, times: f64| values.iter_mut().for_each(|value| *value *= times);
        // An amplifier of twice the gain needs half the voltage.
        let other = with(&|record, options| {
            each(&mut record.command, 0.5);
            options.gain = Gain::Given(1.0);
            options.limit_v = 5.0;
        });
        same(&name("voltage"), &found, &other, [1.0; 4], none, 1.0);
        // Twice the force for the same motion means twice the mass, damping and stiffness.
        let other = with(&|_, options| options.gain = Gain::Given(1.0));
        same(&name("gain"), &found, &other, [2.0, 2.0, 2.0, 1.0], none, 1.0);
        let other = with(&|record, _| {
            each(&mut record.command, -1.0);
            each(&mut record.position_m, -1.0);
        });
        same(&name("mirror"), &found, &other, [1.0, 1.0, 1.0, -1.0], none, 1.0);
        let far_m = 4096.0 * RESOLUTION_M;
        let other = with(&|record, _| record.position_m.iter_mut().for_each(|x| *x += far_m));
        same(&name("shift"), &found, &other, [1.0; 4], [0.0, 0.0, 0.0, far_m], 1.0);
        let other = with(&|record, options| {
            each(&mut record.position_m, 2.0);
            options.resolution_m *= 2.0;
        });
        same(&name("length"), &found, &other, [0.5, 0.5, 0.5, 2.0], none, 1.0);
        let other = with(&|record, _| record.step_s *= 2.0);
        same(&name("time"), &found, &other, [4.0, 2.0, 1.0, 1.0], none, 1.0);
        let other = with(&|record, _| record.start_s += 100.0);
        same(&name("later"), &found, &other, [1.0; 4], none, 1.0);
        let half_a_count = with(&|record, options| {
            record.position_m.iter_mut().for_each(|x| *x -= RESOLUTION_M);
            options.rounding = Rounding::Floor;
        });
        let less = [0.0, 0.0, 0.0, -0.5 * RESOLUTION_M];
        same(&name("floor"), &found, &half_a_count, [1.0; 4], less, 1.0);
        // A repeated record gives the same values with intervals that are smaller by the root of two. The search for
        // terms is off, since noise that repeats exactly would be evidence of a term.
        let plainly = Options { terms: Terms::NONE, ..options };
        let once = identify(std::slice::from_ref(&plain), &plainly).unwrap();
        let twice = identify(&[plain.clone(), plain.clone()], &plainly).unwrap();
        same(&name("twice"), &once, &twice, [1.0; 4], none, 0.5f64.sqrt());
    });
}
