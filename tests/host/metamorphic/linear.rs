//! Compares the linear boundary with a second implementation. This file builds the loop as one matrix and multiplies
//! it. The test checks whether the handle's motion grows or decays.

use host_sim::{
    analysis::linear::{Boundary, Device, Elements, Loop, TransferFunction},
    numerics::double::Double,
    scene::element::{Amplifier, Arm, Mode},
};

use crate::dice::{Dice, cases};

/// The numbers have 32 digits, because with little damping the motion grows or decays by only a part in 10^15 per
/// period.
type Matrix = Vec<Vec<Double>>;

fn number(x: f64) -> Double {
    x.into()
}

fn zeros(n: usize) -> Matrix {
    vec![vec![number(0.0); n]; n]
}

fn identity(n: usize) -> Matrix {
    let mut one = zeros(n);
    (0..n).for_each(|i| one[i][i] = number(1.0));
    one
}

fn add(sum: &mut [Double], times: Double, row: &[Double]) {
    if times != number(0.0) {
        sum.iter_mut().zip(row).for_each(|(sum, x)| *sum = *sum + times * *x);
    }
}

fn product(a: &Matrix, b: &[Vec<Double>]) -> Matrix {
    let mut out = vec![vec![number(0.0); b[0].len()]; a.len()];
    for (row, out) in a.iter().zip(&mut out) {
        row.iter().zip(b).for_each(|(times, b)| add(out, *times, b));
    }
    out
}

/// Magnitudes of the entries.
fn entries(of: &Matrix) -> impl Iterator<Item = f64> {
    of.iter().flatten().map(|x| f64::from(*x).abs())
}

/// Computes `exp(A t)`. The series is summed for `t / 2^squarings`. The result is then squared `squarings` times.
fn exponential(a: &Matrix, t: f64) -> Matrix {
    let n = a.len();
    let norm = entries(a).fold(0.0, f64::max) * n as f64 * t;
    let squarings = norm.max(1e-300).log2().ceil().max(-4.0) as i32 + 4;
    let part = number(t) * number(0.5f64.powi(squarings));
    let (mut sum, mut term) = (identity(n), identity(n));
    for power in 1..20 {
        term = product(&term, a);
        let y = number(1.0 / f64::from(power));
        let of_power = y * (number(2.0) - number(f64::from(power)) * y);
        term.iter_mut().flatten().for_each(|x| *x = *x * part * of_power);
        sum.iter_mut().zip(&term).for_each(|(sum, term)| add(sum, number(1.0), term));
    }
    for _ in 0..squarings {
        sum = product(&sum, &sum);
    }
    sum
}

/// The plant with the commanded force as the last state. The other states are the handle's position, the speeds of the
/// bodies, the stretches of the other springs, and the amplifier. If no spring acts on a body, the position of this
/// body is not a state. Parts without an effect on the handle are left out.
fn plant(of: &Loop) -> Matrix {
    let Elements { amplifier, mode, arm } = of.elements;
    let device = of.device;
    let mut masses = vec![device.mass_kg];
    // Springs and dampers to a body, from the previous body or from the ground.
    let mut links = vec![(0, true, device.stiffness_n_per_m, device.damping_n_s_per_m)];
    if let Some(mode) = mode {
        masses.push(mode.mass_kg);
        links.push((1, false, mode.stiffness_n_per_m, mode.damping_n_s_per_m));
    }
    if let Some(arm) = arm {
        let hand = masses.len();
        masses.push(arm.mass_kg);
        links.push((hand, false, arm.grip_stiffness_n_per_m, arm.grip_damping_n_s_per_m));
        links.push((hand, true, arm.stiffness_n_per_m, arm.damping_n_s_per_m));
    }
    let speed = |body: usize| 1 + body;
    let states = 1 + masses.len() + links.iter().filter(|(_, _, k, _)| *k > 0.0).count();
    let mut a = vec![vec![0.0; states + 2]; states + 2];
    a[0][speed(0)] = 1.0;
    let (mut stretches, mut next) = (vec![0], speed(masses.len()));
    for (body, to_ground, k, b) in links {
        let before = (!to_ground).then(|| body - 1);
        // If springs connect all bodies from the handle to this body, the sum of the stretches is the position of this
        // body.
        let stretch = if to_ground && stretches.len() == body + 1 {
            stretches.clone()
        } else if k > 0.0 {
            a[next][speed(body)] = 1.0;
            if let Some(before) = before {
                a[next][speed(before)] = -1.0;
                stretches.push(next);
            }
            next += 1;
            vec![next - 1]
        } else {
            vec![]
        };
        for (pushed, sign) in [(Some(body), -1.0), (before, 1.0)] {
            let Some(pushed) = pushed else { continue };
            let (row, per_kg) = (&mut a[speed(pushed)], sign / masses[pushed]);
            stretch.iter().for_each(|state| row[*state] += per_kg * k);
            row[speed(body)] += per_kg * b;
            if let Some(before) = before {
                row[speed(before)] -= per_kg * b;
            }
        }
    }
    let (force, command) = (states, states + 1);
    if let Some(amplifier) = amplifier {
        let pole = std::f64::consts::TAU * amplifier.bandwidth_hz;
        a[speed(0)][force] = 1.0 / device.mass_kg;
        (a[force][force], a[force][command]) = (-pole, pole);
    } else {
        a[speed(0)][command] = 1.0 / device.mass_kg;
    }
    let (mut acting, mut at) = (vec![0], 0);
    while let Some(state) = acting.get(at) {
        let more = (0..a.len()).filter(|n| a[*state][*n] != 0.0 && !acting.contains(n));
        acting.extend(more.collect::<Vec<_>>());
        at += 1;
    }
    acting.sort_unstable();
    acting
        .iter()
        .map(|row| acting.iter().map(|column| number(a[*row][*column])).collect())
        .collect()
}

/// The loop over one output period. The state has three parts. The first is the plant with the acting command. The
/// second is the estimator's past positions and velocities, the newest first. The third is the commands that do not act
/// yet, the oldest first.
fn period(of: &Loop, k: f64, b: f64) -> Matrix {
    let a = plant(of);
    let plant_states = a.len();
    let command = plant_states - 1;
    let sample_s = of.sample_s();
    let order = of.estimator.num.len().max(of.estimator.den.len()) - 1;
    assert_eq!(of.estimator.den[0], 1.0);
    let latency = of.latency_samples;
    let every = f64::from(of.period);
    let waiting = (latency / every).floor() as usize;
    let past = plant_states;
    let queue = past + 2 * order;
    let states = queue + waiting;
    let mut all = identity(states);
    // Delay in samples from the start of a period to the effect of a command from this start or from an earlier start.
    let turn = latency - every * (latency / every).floor();
    let whole = exponential(&a, sample_s);
    let parts = [turn.fract(), 1.0 - turn.fract()].map(|part| exponential(&a, part * sample_s));
    let advance = |all: &mut Matrix, step: &Matrix| {
        let moved = product(step, &all[..plant_states]);
        all[..plant_states].clone_from_slice(&moved);
    };
    let mut next = vec![];
    for sample in 0..of.period {
        let position = all[0].clone();
        let coefficient = |of: &[f64], n: usize| number(of.get(n).copied().unwrap_or(0.0));
        let none = number(0.0);
        let mut velocity = vec![none; states];
        add(&mut velocity, coefficient(&of.estimator.num, 0), &position);
        for n in 1..=order {
            add(&mut velocity, coefficient(&of.estimator.num, n), &all[past + n - 1]);
            let v = none - coefficient(&of.estimator.den, n);
            add(&mut velocity, v, &all[past + order + n - 1]);
        }
        if sample == 0 {
            next = vec![none; states];
            add(&mut next, number(-k), &position);
            add(&mut next, number(-b), &velocity);
        }
        if order > 0 {
            all[past..past + order].rotate_right(1);
            all[past + order..past + 2 * order].rotate_right(1);
            (all[past], all[past + order]) = (position, velocity);
        }
        if f64::from(sample) == turn.floor() {
            advance(&mut all, &parts[0]);
            all.push(next.clone());
            all[command] = all.remove(queue);
            advance(&mut all, &parts[1]);
        } else {
            advance(&mut all, &whole);
        }
    }
    all
}

/// The binary logarithm of the long-term growth of motion per period. The growth is computed over 2^80 periods, so the
/// effect of the start is below the last digit.
fn growth(of: &Loop, k: f64, b: f64) -> f64 {
    let mut power = period(of, k, b);
    let (mut exponent, mut periods) = (0.0, 1.0);
    for _ in 0..80 {
        power = product(&power, &power);
        let largest = entries(&power).fold(0.0, f64::max);
        if largest == 0.0 {
            return f64::NEG_INFINITY;
        }
        let taken = largest.log2().round();
        power.iter_mut().flatten().for_each(|x| *x = *x * number((-taken).exp2()));
        // Whole numbers are not rounded if motion neither grows nor decays.
        (exponent, periods) = (2.0 * exponent + taken, 2.0 * periods);
    }
    exponent / periods
}

fn any(dice: &mut Dice) -> Loop {
    let rate_hz = dice.one_of(&[1e3, 1e4, 5e4]);
    let some = |dice: &mut Dice, low, high| if dice.coin() { 0.0 } else { dice.decades(low, high) };
    let device = Device {
        mass_kg: dice.decades(0.05, 5.0),
        damping_n_s_per_m: some(dice, 0.1, 100.0),
        stiffness_n_per_m: some(dice, 10.0, 1e4),
    };
    let plain = TransferFunction::finite_difference(rate_hz);
    let estimator = match dice.below(3) {
        0 => plain,
        _ => TransferFunction::paper(rate_hz, rate_hz * dice.decades(5e-3, 0.4)).unwrap(),
    };
    let elements = Elements {
        amplifier: dice
            .coin()
            .then(|| Amplifier { bandwidth_hz: rate_hz * dice.decades(0.02, 2.0) }),
        mode: dice.coin().then(|| Mode {
            mass_kg: dice.decades(0.02, 1.0),
            stiffness_n_per_m: some(dice, 100.0, 1e5),
            damping_n_s_per_m: some(dice, 1.0, 100.0),
        }),
        arm: dice.coin().then(|| Arm {
            mass_kg: dice.decades(0.1, 2.0),
            damping_n_s_per_m: some(dice, 1.0, 30.0),
            stiffness_n_per_m: some(dice, 100.0, 1e4),
            rest_position_m: 0.0,
            grip_damping_n_s_per_m: some(dice, 1.0, 100.0),
            grip_stiffness_n_per_m: some(dice, 100.0, 1e4),
        }),
    };
    let period = dice.one_of(&[1, 2, 5, 10]);
    let latency_samples = match dice.below(3) {
        0 => 0.0,
        1 => f64::from(dice.below(12)),
        _ => dice.between(0.0, 12.0),
    };
    Loop { device, elements, rate_hz, period, latency_samples, estimator }
}

/// Relative distances from the boundary at which the motion is checked. The first is relative to the boundary. The
/// second is relative to the loop's own stiffnesses, whose difference is K.
const ASIDE: [f64; 2] = [1e-4, 1e-14];

#[test]
fn the_boundary_is_where_the_motion_of_a_second_text_begins_to_grow() {
    let (mut stable, mut unstable, mut free) = (0, 0, 0);
    cases(200, |dice| {
        let of = any(dice);
        let period_s = f64::from(of.period) * of.sample_s();
        let b = dice.one_of(&[0.0, 1.0]) * of.device.mass_kg / period_s * dice.decades(1e-3, 0.5);
        let limit = Boundary::new(&of).unwrap().at(b).unwrap();
        let name = format!("{}: {of:?} B {b} {limit:?}", dice.name);
        let device = of.device;
        let own = device.stiffness_n_per_m
            + (device.damping_n_s_per_m + device.mass_kg / period_s) / period_s;
        let k = limit.stiffness_max;
        if k > 0.0 && k.is_finite() {
            let aside = ASIDE[0] * k + ASIDE[1] * own;
            let inside = growth(&of, k - aside, b);
            assert!(inside < 0.0, "{inside:e} {name}");
            let outside = growth(&of, k + aside, b);
            let again = limit.further_stable.iter().any(|(low, _)| k + aside > *low);
            assert!(outside > 0.0 || again, "{outside:e} {name}");
            stable += 1;
        } else if k == 0.0 {
            let first = limit.phase_crossings.first().map_or(own, |c| c.stiffness_n_per_m);
            let inside = growth(&of, 0.5 * first, b);
            assert!(inside > 0.0, "{inside:e} {name}");
            unstable += 1;
        }
        for (low, high) in &limit.further_stable {
            let middle = if high.is_finite() { (low * high).sqrt() } else { 2.0 * low };
            let growth = growth(&of, middle, b);
            assert!(growth < 0.0, "{growth:e} {name}");
        }
        free += u32::from(of.elements.mode.is_some_and(|mode| mode.stiffness_n_per_m == 0.0));
    });
    assert!(stable > 100 && unstable > 20 && free > 20, "{stable} {unstable} {free}");
}
