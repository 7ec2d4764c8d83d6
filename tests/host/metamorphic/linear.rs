//! The linear boundary against a second text: the loop as one matrix, made and multiplied here, and whether the
//! handle's motion grows or dies in it.

use host_sim::{
    analysis::linear::{Boundary, Device, Elements, Loop, TransferFunction},
    scene::element::{Amplifier, Arm, Mode},
};

use crate::dice::{Dice, cases};

type Matrix = Vec<Vec<f64>>;

fn identity(n: usize) -> Matrix {
    (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect()
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let n = b[0].len();
    let mut out = vec![vec![0.0; n]; a.len()];
    for (row, out) in a.iter().zip(&mut out) {
        for (value, b) in row.iter().zip(b) {
            if *value != 0.0 {
                out.iter_mut().zip(b).for_each(|(sum, b)| *sum += value * b);
            }
        }
    }
    out
}

/// exp(A t) by its series, of a 2^-squarings part, squared.
fn exponential(a: &Matrix, t: f64) -> Matrix {
    let n = a.len();
    let norm = a.iter().map(|row| row.iter().map(|x| x.abs()).sum::<f64>()).fold(0.0, f64::max) * t;
    let squarings = (norm.max(1e-300).log2().ceil().max(-4.0) + 4.0) as i32;
    let part = t / 2f64.powi(squarings);
    let (mut sum, mut term) = (identity(n), identity(n));
    for power in 1..20 {
        term = product(&term, a);
        term.iter_mut().flatten().for_each(|x| *x *= part / f64::from(power));
        sum.iter_mut().flatten().zip(term.iter().flatten()).for_each(|(s, t)| *s += t);
    }
    for _ in 0..squarings {
        sum = product(&sum, &sum);
    }
    sum
}

/// The plant with the commanded force as one more state: positions and speeds of the bodies, the amplifier, the
/// command.
fn plant(of: &Loop) -> Matrix {
    let Elements { amplifier, mode, arm } = of.elements;
    let device = of.device;
    let mut masses = vec![device.mass_kg];
    // springs and dampers: from body to body, or to the ground
    let mut links = vec![(0, None, device.stiffness_n_per_m, device.damping_n_s_per_m)];
    if let Some(mode) = mode {
        masses.push(mode.mass_kg);
        links.push((0, Some(1), mode.stiffness_n_per_m, mode.damping_n_s_per_m));
    }
    if let Some(arm) = arm {
        let held = masses.len() - 1;
        masses.push(arm.mass_kg);
        links.push((held, Some(held + 1), arm.grip_stiffness_n_per_m, arm.grip_damping_n_s_per_m));
        links.push((held + 1, None, arm.stiffness_n_per_m, arm.damping_n_s_per_m));
    }
    let bodies = masses.len();
    let force = 2 * bodies;
    let command = force + usize::from(amplifier.is_some());
    let mut a = vec![vec![0.0; command + 1]; command + 1];
    for body in 0..bodies {
        a[body][bodies + body] = 1.0;
    }
    for (one, other, k, b) in links {
        for (body, sign) in [(Some(one), 1.0), (other, -1.0)] {
            let Some(body) = body else { continue };
            for (at, towards) in [(Some(one), 1.0), (other, -1.0)] {
                let Some(at) = at else { continue };
                a[bodies + body][at] -= sign * towards * k / masses[body];
                a[bodies + body][bodies + at] -= sign * towards * b / masses[body];
            }
        }
    }
    a[bodies][force] = 1.0 / device.mass_kg;
    if let Some(amplifier) = amplifier {
        let pole = std::f64::consts::TAU * amplifier.bandwidth_hz;
        (a[force][force], a[force][command]) = (-pole, pole);
    }
    a
}

/// The loop over one output period. State: the plant with the command that acts, the estimator's past positions and
/// velocities, newest first, and the commands on their way, oldest first.
fn period(of: &Loop, k: f64, b: f64) -> Matrix {
    let a = plant(of);
    let plant_states = a.len();
    let command = plant_states - 1;
    let sample_s = of.sample_s();
    let order = of.estimator.num.len().max(of.estimator.den.len()) - 1;
    let lead = of.estimator.den[0];
    let latency = of.latency_samples;
    let every = f64::from(of.period);
    let waiting = (latency / every).floor() as usize;
    let past = plant_states;
    let queue = past + 2 * order;
    let states = queue + waiting;
    let mut all = identity(states);
    // so many samples after a start of a period the command of that start takes effect, or that of an earlier one
    let turn = latency - every * (latency / every).floor();
    let advance = |all: &mut Matrix, dt: f64| {
        let step = exponential(&a, dt);
        let moved = product(&step, &all[..plant_states].to_vec());
        all[..plant_states].clone_from_slice(&moved);
    };
    let mut next = vec![0.0; states];
    for sample in 0..of.period {
        let position = all[0].clone();
        let coefficient = |of: &[f64], n: usize| of.get(n).copied().unwrap_or(0.0) / lead;
        let mut velocity: Vec<f64> =
            position.iter().map(|x| x * coefficient(&of.estimator.num, 0)).collect();
        for n in 1..=order {
            let (x, v) = (&all[past + n - 1], &all[past + order + n - 1]);
            let (num, den) = (coefficient(&of.estimator.num, n), coefficient(&of.estimator.den, n));
            velocity
                .iter_mut()
                .zip(x.iter().zip(v))
                .for_each(|(sum, (x, v))| *sum += num * x - den * v);
        }
        if sample == 0 {
            next = position.iter().zip(&velocity).map(|(x, v)| -(k * x + b * v)).collect();
        }
        if order > 0 {
            all[past..past + order].rotate_right(1);
            all[past + order..past + 2 * order].rotate_right(1);
            (all[past], all[past + order]) = (position, velocity);
        }
        let at = f64::from(sample);
        if (at..at + 1.0).contains(&turn) {
            advance(&mut all, (turn - at) * sample_s);
            if waiting == 0 {
                all[command] = next.clone();
            } else {
                all[queue..].rotate_left(1);
                all[command] = std::mem::replace(&mut all[queue + waiting - 1], next.clone());
            }
            advance(&mut all, (at + 1.0 - turn) * sample_s);
        } else {
            advance(&mut all, sample_s);
        }
    }
    all
}

/// By how much the handle's motion grows per period in the long run, whatever it starts from.
fn growth(of: &Loop, k: f64, b: f64) -> f64 {
    let mut power = period(of, k, b);
    let (mut logarithm, mut periods) = (0.0, 1.0);
    for _ in 0..36 {
        power = product(&power, &power);
        (logarithm, periods) = (2.0 * logarithm, 2.0 * periods);
        let largest = power.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs()));
        if largest == 0.0 {
            return 0.0;
        }
        power.iter_mut().flatten().for_each(|x| *x /= largest);
        logarithm += largest.ln();
    }
    // what reaches the handle, not what stays in a body that it does not feel
    let reaches = power[0].iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    ((logarithm + reaches.max(1e-300).ln()) / periods).exp()
}

fn any(dice: &mut Dice) -> Loop {
    let rate_hz = dice.one_of(&[1e3, 1e4, 5e4]);
    let device = Device {
        mass_kg: dice.decades(0.05, 5.0),
        damping_n_s_per_m: dice.one_of(&[0.0, 1.0, 30.0]),
        stiffness_n_per_m: dice.one_of(&[0.0, 20.0, 3000.0]),
    };
    let plain = TransferFunction::finite_difference(rate_hz);
    let estimator = match dice.below(3) {
        0 => plain,
        _ => TransferFunction::paper(rate_hz, rate_hz * dice.decades(5e-3, 0.4)),
    };
    let elements = Elements {
        amplifier: dice
            .coin()
            .then(|| Amplifier { bandwidth_hz: rate_hz * dice.decades(0.02, 2.0) }),
        mode: dice.coin().then(|| Mode {
            mass_kg: dice.decades(0.02, 1.0),
            stiffness_n_per_m: dice.one_of(&[0.0, 3e4]),
            damping_n_s_per_m: dice.one_of(&[0.0, 4.0]),
        }),
        arm: dice.coin().then(|| Arm {
            mass_kg: dice.decades(0.1, 2.0),
            damping_n_s_per_m: dice.one_of(&[0.0, 10.0]),
            stiffness_n_per_m: dice.one_of(&[0.0, 300.0]),
            rest_position_m: 0.0,
            grip_damping_n_s_per_m: dice.one_of(&[0.0, 25.0]),
            grip_stiffness_n_per_m: dice.one_of(&[0.0, 1200.0]),
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

/// How far beside the boundary the motion is looked at.
const ASIDE: f64 = 0.03;

#[test]
fn the_boundary_is_where_the_motion_of_a_second_text_begins_to_grow() {
    let (mut stable, mut unstable, mut free) = (0, 0, 0);
    cases(40, |dice| {
        let of = any(dice);
        let period_s = f64::from(of.period) * of.sample_s();
        let b = dice.one_of(&[0.0, 1.0]) * of.device.mass_kg / period_s * dice.decades(1e-3, 0.5);
        let limit = Boundary::new(&of).unwrap().at(b).unwrap();
        let name = format!("{}: {of:?} B {b} {limit:?}", dice.name);
        let k = limit.stiffness_max;
        if k > 0.0 && k.is_finite() {
            let inside = growth(&of, k * (1.0 - ASIDE), b);
            assert!(inside < 1.0 + 1e-9, "{inside} {name}");
            let outside = growth(&of, k * (1.0 + ASIDE), b);
            let again = limit.further_stable.iter().any(|(low, _)| k * (1.0 + ASIDE) > *low);
            assert!(outside > 1.0 || again, "{outside} {name}");
            stable += 1;
        } else if k == 0.0 {
            let first = limit.phase_crossings.first().map_or(1.0, |c| c.stiffness_n_per_m);
            assert!(growth(&of, 0.5 * first, b) > 1.0 - 1e-9, "{name}");
            unstable += 1;
        }
        for (low, high) in &limit.further_stable {
            let middle = if high.is_finite() { (low * high).sqrt() } else { 2.0 * low };
            assert!(growth(&of, middle, b) < 1.0 + 1e-9, "{name}");
        }
        let loose = |stiffness: f64| stiffness == 0.0;
        free += u32::from(of.elements.mode.is_some_and(|mode| loose(mode.stiffness_n_per_m)));
    });
    assert!(stable > 15 && unstable > 0 && free > 3, "{stable} {unstable} {free}");
}
