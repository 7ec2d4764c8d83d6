//! Any record with any options gives a result or a refusal, never a panic.

use std::panic::catch_unwind;

use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use zwidth::telemetry::Flags;

use super::{
    Asked, Drive, Gain, GainAsked, Identification, Json, Made, Options, OutputScale, Record, Span,
    Term, Terms, asked::of_records, from_capture_csv, identify,
};
use crate::{
    error::Error,
    plant::{Plant as _, PlantStep},
    scene::{NamedScene, Scene, Units},
};

/// Number of cases of the short search. The environment variable `IDENTIFY_CASES` sets another number.
const CASES: u64 = 60;
const BASES: [&str; 3] = ["paper-1um", "hapkit", "smartknob"];

/// The random choices that make one case.
struct Dice(Xoshiro256PlusPlus);

impl Dice {
    fn new(case: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(case))
    }

    /// A random number, at least 0 and below 1.
    fn part(&mut self) -> f64 {
        self.0.random()
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.part()
    }

    /// A random number of either sign. Each decade between `low` and `high` has the same probability.
    fn decades(&mut self, low: f64, high: f64) -> f64 {
        let size = low * (high / low).powf(self.part());
        if self.chance(0.5) { size } else { -size }
    }

    fn chance(&mut self, of: f64) -> bool {
        self.part() < of
    }

    fn below(&mut self, end: usize) -> usize {
        self.0.random_range(0..end)
    }

    fn one<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }

    fn maybe<T>(&mut self, of: f64, value: impl FnOnce(&mut Self) -> T) -> Option<T> {
        self.chance(of).then(|| value(self))
    }

    /// A number that no real device would give.
    fn odd(&mut self) -> f64 {
        let size = self.decades(1e-300, 1e300);
        self.one(&[0.0, -0.0, 1.0, f64::NAN, f64::INFINITY, f64::MAX, 5e-324, 1e-308, size, size])
    }
}

/// A device and what drives it. The Coulomb friction of the device may vary with the position.
struct Driven {
    mass_kg: f64,
    damping: f64,
    stiffness: f64,
    friction_n: f64,
    ripple: f64,
    gain: f64,
    resolution_m: f64,
    step_s: f64,
    /// The drive's speed loop: the wanted speed in m/s, the gain in V s/m, and the share of the integral.
    loop_of: Option<[f64; 3]>,
    push_v: f64,
    /// Length of a push, in rows.
    push_rows: usize,
    /// First and last row in which the drive acts.
    driven: (usize, usize),
}

impl Driven {
    fn of(dice: &mut Dice, rows: usize, resolution_m: f64, radius_m: f64) -> Self {
        let first = if dice.chance(0.7) { dice.below(rows / 4 + 1) } else { 0 };
        let last = if dice.chance(0.3) { first + dice.below(rows + 1) } else { rows };
        let mass_kg = dice.decades(0.01, 1.0).abs();
        Self {
            mass_kg,
            damping: dice.one(&[0.0, 0.04, 1.0, 10.0]) * mass_kg,
            stiffness: dice.one(&[0.0, 0.0, 1.0, 200.0]) * mass_kg,
            friction_n: dice.one(&[0.0, 0.3, 4.0]) * dice.part() * mass_kg,
            ripple: dice.one(&[0.0, 0.1, 0.9]),
            gain: dice.one(&[1.0, 10.0, 30.0, 30.0, 30.0, -1.0]) * mass_kg,
            resolution_m,
            step_s: dice.one(&[1e-4, 1e-3, 1e-2]),
            loop_of: dice.maybe(0.5, |dice| {
                [
                    dice.between(-6.0, 6.0) * radius_m,
                    dice.decades(0.02, 0.5).abs() / radius_m,
                    dice.part(),
                ]
            }),
            push_v: dice.between(-4.0, 4.0),
            push_rows: 1 + dice.below(rows + 1),
            driven: (first, last),
        }
    }

    /// Voltage and position of each row.
    fn columns(&self, rows: usize, noise: &mut Dice) -> [Vec<f64>; 2] {
        const PARTS: usize = 20;
        let (mut x, mut v, mut before, mut speed, mut sum) = (0.0_f64, 0.0_f64, 0.0, 0.0, 0.0);
        let mut columns = [vec![], vec![]];
        let noise_m = noise.one(&[0.0, 0.0, 1.0]) * self.resolution_m;
        let part_s = self.step_s / PARTS as f64;
        for row in 0..rows {
            let read = x + noise_m * noise.part();
            let count = if self.resolution_m > 0.0 {
                (read / self.resolution_m).floor() * self.resolution_m
            } else {
                read
            };
            speed += 0.3 * ((count - before) / self.step_s - speed);
            before = count;
            let is_driven = (self.driven.0..self.driven.1).contains(&row);
            let volts = match self.loop_of {
                _ if !is_driven => 0.0,
                Some([wanted, gain, share]) => {
                    sum += share * (wanted - speed) * self.step_s;
                    gain * (wanted - speed + sum)
                }
                None if ((row - self.driven.0) / self.push_rows).is_multiple_of(2) => self.push_v,
                None => 0.0,
            };
            columns[0].push(volts);
            columns[1].push(count);
            for _ in 0..PARTS {
                let force = self.gain * volts - self.stiffness * x - self.damping * v;
                let most = self.friction_n * (1.0 + self.ripple * (x * 40.0).sin());
                if v == 0.0 && force.abs() <= most {
                    continue;
                }
                let sign = if v == 0.0 { force.signum() } else { v.signum() };
                let next = v + (force - sign * most) / self.mass_kg * part_s;
                v = if next * sign < 0.0 { 0.0 } else { next };
                x += v * part_s;
            }
        }
        columns
    }
}

/// Columns of a record. If `is_odd` is true, no device could make it.
fn columns(dice: &mut Dice, resolution_m: f64, radius_m: f64, is_odd: bool) -> [Vec<f64>; 3] {
    let rows = if is_odd { dice.below(200) } else { dice.one(&[101, 200, 400, 800]) };
    let driven = Driven::of(dice, rows, resolution_m, radius_m);
    let [mut volts, mut positions] = driven.columns(rows, dice);
    let mut times: Vec<f64> = (0..rows).map(|row| row as f64 * driven.step_s).collect();
    if !is_odd {
        return [times, volts, positions];
    }
    let unit = dice.one(&[1e-6, 1e-3, 1.0]);
    match dice.below(16) {
        0 => positions.fill(unit),
        1 => volts.fill(0.0),
        2 => volts.fill(dice.between(-3.0, 3.0)),
        3 => positions.iter_mut().for_each(|x| *x = unit * dice.part()),
        4 => volts.iter_mut().for_each(|u| *u = dice.between(-3.0, 3.0)),
        5 => {
            let place = dice.below(rows + 1);
            positions.iter_mut().skip(place).for_each(|x| *x += unit);
        }
        6 => positions.iter_mut().enumerate().for_each(|(row, x)| *x = unit * row as f64),
        _ => {}
    }
    if dice.chance(0.1) {
        let times_as_large = dice.decades(1e-12, 1e12);
        let column = if dice.chance(0.5) { &mut volts } else { &mut positions };
        column.iter_mut().for_each(|value| *value *= times_as_large);
    }
    if dice.chance(0.1) {
        let offset = dice.decades(1e-9, 1e15);
        let column = dice.one(&[0, 1, 2]);
        [&mut volts, &mut positions, &mut times][column].iter_mut().for_each(|x| *x += offset);
    }
    if dice.chance(0.15) && rows > 0 {
        let (place, odd) = (dice.below(rows), dice.odd());
        let column = dice.one(&[0, 1, 2]);
        let column = [&mut volts, &mut positions, &mut times].into_iter().nth(column).unwrap();
        column[place] = if dice.chance(0.5) { odd } else { column[place.saturating_sub(1)] };
        if dice.chance(0.2) {
            column.fill(odd);
        }
    }
    if dice.chance(0.03) {
        times.reverse();
    }
    [times, volts, positions]
}

/// A record from frames of telemetry. Either a board could send these frames, or they are impossible.
fn of_telemetry(
    dice: &mut Dice,
    scale: &OutputScale,
    columns: [&[f64]; 2],
) -> Result<Record, String> {
    let force_per_v = dice.one(&[1.0, 1e8, 1e298]);
    let mut text = String::from("sample,position_counts,force_q30,command,flags\n");
    for (row, (volts, x)) in columns[0].iter().zip(columns[1]).enumerate() {
        let (sample, force, flags) = (10 * row, force_per_v * volts, Flags::ON.bits());
        text += &format!("{sample},{},{force},0,{flags}\n", (x * 1e6).floor());
    }
    from_capture_csv("made", &text, scale, Span::default())
}

fn record(dice: &mut Dice, base: &Scene, resolution_m: f64) -> Result<Record, String> {
    let units = base.units;
    let (radius_m, is_odd) = (units.radius_m(), dice.chance(0.3));
    let [times, mut command, position_m] = columns(dice, resolution_m, radius_m, is_odd);
    if is_odd && dice.chance(0.4) {
        // A record that another program could make.
        let step_s =
            if dice.chance(0.2) { dice.odd() } else { times.get(1).copied().unwrap_or(1.0) };
        let may_clip = dice.chance(0.5);
        let start_s = times.first().copied().unwrap_or_default();
        if dice.chance(0.1) {
            command.truncate(dice.below(200));
        }
        return Ok(Record {
            name: "made".into(),
            start_s,
            step_s,
            drive: Drive::Voltage,
            command,
            position_m,
            may_clip,
        });
    }
    if is_odd && dice.chance(0.2) {
        let scale = OutputScale::of_scene(base, resolution_m.max(1e-6))?;
        return of_telemetry(dice, &scale, [&command, &position_m]);
    }
    let position = if units.is_rotary() { "position_rad" } else { "position_m" };
    let mut text = format!("time_s,voltage_v,{position}\n");
    for ((time_s, volts), x) in times.iter().zip(&command).zip(&position_m) {
        let position = if units.is_rotary() { x / radius_m } else { *x };
        text += &format!("{time_s},{volts},{position}\n");
    }
    let span = Span {
        from_s: dice.maybe(0.1, |dice| dice.between(-1.0, 2.0)),
        to_s: dice.maybe(0.1, |dice| dice.between(-1.0, 2.0)),
    };
    Record::from_csv("made", &text, span, units, resolution_m)
}

fn terms(dice: &mut Dice) -> Terms {
    match dice.below(5) {
        0 => Terms::NONE,
        1 | 2 => Terms::Auto,
        _ => {
            let chances = Term::ALL.map(|_| dice.chance(0.4));
            Terms::these(|term| {
                Term::ALL.into_iter().zip(chances).any(|(one, is)| is && one == term)
            })
        }
    }
}

fn asked(dice: &mut Dice) -> Asked {
    if dice.chance(0.05) {
        return Asked {
            latency: Some(dice.odd()),
            resolution: Some(dice.odd()),
            ..plausible(dice)
        };
    }
    plausible(dice)
}

fn plausible(dice: &mut Dice) -> Asked {
    Asked {
        is_based: dice.chance(0.7),
        latency: Some(dice.one(&[0.0, 0.0, 0.0, 0.5, 3.0])),
        fit_latency: dice.chance(0.3),
        spring: dice.chance(0.4),
        terms: terms(dice),
        rest_position: dice.maybe(0.2, |dice| dice.between(-0.1, 0.1)),
        encoder_cycle: dice.maybe(0.2, |dice| dice.decades(1e-8, 1.0).abs()),
        resolution: None,
        span: Span::default(),
    }
}

fn gain(dice: &mut Dice) -> GainAsked {
    let size = dice.decades(1e-3, 1e2).abs();
    match dice.below(20) {
        0 => GainAsked { added_mass: Some(size), ..GainAsked::default() },
        1 => GainAsked {
            calibration_mass: Some(size),
            calibration_voltage: Some(dice.between(-1.0, 3.0)),
            ..GainAsked::default()
        },
        2 => GainAsked { gain: Some(dice.odd()), ..GainAsked::default() },
        _ => GainAsked { gain: Some(size), ..GainAsked::default() },
    }
}

/// The result of a case. All reports of the result are made too, because they must not panic either.
fn answer(case: u64) -> Result<Identification, Error> {
    let dice = &mut Dice::new(case);
    let base = NamedScene::load(dice.one(&BASES))?;
    let units = base.scene.units;
    let gain = gain(dice);
    let count =
        if gain.added_mass.is_some() { 2 } else { dice.one(&[1, 1, 1, 1, 1, 1, 1, 1, 2, 3]) };
    let asked = asked(dice);
    let mut options = asked.options(&base.scene, units)?;
    let resolution_m = dice.one(&[0.0, 1e-6, 1e-5, 3.927e-4]) * units.radius_m();
    if dice.chance(0.95) {
        options.resolution_m = resolution_m;
    }
    let records = if dice.chance(0.01) { 0 } else { count };
    let records: Result<Vec<_>, _> =
        (0..records).map(|_| record(dice, &base.scene, resolution_m)).collect();
    let mut records = records.map_err(Error::Input)?;
    // This choice uses a second random generator. So older cases do not change.
    let drive =
        Dice::new(!case).one(&[Drive::Voltage, Drive::Voltage, Drive::Force, Drive::Current]);
    records.iter_mut().for_each(|record| record.drive = drive);
    // A log of the force needs no gain. A few cases give one, and are refused.
    let gain =
        if drive == Drive::Force && !case.is_multiple_of(8) { GainAsked::default() } else { gain };
    let options = of_records(options, (&asked, &gain), &base.scene, units, &records)?;
    let found = identify(&records, &options).map_err(Error::Input)?;
    let _ = toml::to_string(&Json::new(&records, &found, &options));
    let _ = Made::new(&base, &found, &options)?.named(&base.name);
    assert!(found.fits[0].rows(&records[0]).count() > 0);
    Ok(found)
}

#[test]
fn any_record_with_any_options_is_answered_or_refused() {
    let cases = std::env::var("IDENTIFY_CASES").map_or(CASES, |text| text.parse().unwrap());
    let mut answered = 0;
    let mut fails = vec![];
    for case in 0..cases {
        match catch_unwind(|| answer(case)) {
            Ok(found) => answered += u64::from(found.is_ok()),
            Err(_) => fails.push(case),
        }
    }
    println!("{answered} of {cases} answered");
    assert!(fails.is_empty(), "cases {fails:?} panic");
    assert!(answered * 20 > cases);
}

/// A knob in a speed loop. The friction of the knob varies with its angle. The fit of the encoder's error once found
/// that friction holds the knob at the first row, but then continued with a layout that still had a first speed.
#[test]
fn a_start_that_friction_holds_is_no_panic_beside_the_error_of_the_encoder() {
    const RADIUS_M: f64 = AXIS_M;
    let (mut x, mut v, mut before, mut speed, mut sum) = (0.0_f64, 0.0_f64, 0.0, 0.0, 0.0);
    let (mut command, mut position_m) = (vec![], vec![]);
    for row in 0..401 {
        let count = (x / COUNT_RAD).floor() * COUNT_RAD;
        speed += 0.3 * ((count - before) * 100.0 - speed);
        before = count;
        let error = if row >= 50 { 6.0 } else { 0.0 } - speed;
        sum += 0.01 * error;
        let volts = 0.4 * error + sum;
        command.push(volts);
        position_m.push(count * RADIUS_M);
        for _ in 0..100 {
            let friction = 0.05 * (1.0 + 0.1 * x.sin());
            if v <= 0.0 && GAIN_N_M_PER_V * volts <= friction {
                continue;
            }
            let next = v + 1e-4 * (GAIN_N_M_PER_V * volts - 5e-4 * v - friction) / 0.0128;
            x += 5e-5 * (v + next);
            v = next.max(0.0);
        }
    }
    let (name, start_s, step_s) = ("made".into(), 0.0, 0.01);
    let record = Record {
        name,
        start_s,
        step_s,
        command,
        position_m,
        drive: Drive::Voltage,
        may_clip: true,
    };
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let options = Options {
        latency_s: 0.0,
        spring: false,
        resolution_m: COUNT_RAD * RADIUS_M,
        ..Options::of_scene(&scene, Gain::Given(GAIN_N_M_PER_V / RADIUS_M))
    };
    // A friction that varies once per turn is no encoder error. If the motion has one direction, the effect is the same
    // as cogging.
    let found = identify(&[record], &options).unwrap();
    let is_named = found.warnings.iter().any(|warning| warning.contains("not modelled"));
    let is_known = is_named || found.terms.cogging.is_some();
    assert!(found.terms.phase.is_none() && is_known, "{:?} {:?}", found.terms, found.warnings);
    let inertia = 0.0128 / (RADIUS_M * RADIUS_M);
    assert!(found.mass_kg.holds(inertia), "{:?} {inertia}", found.mass_kg);
}

/// A pulse on a mass with damper and spring. The positions have noise. In the record, the voltage is `late_rows` rows
/// late.
fn pulses(seed: u64, late_rows: usize) -> Record {
    const ROWS: usize = 2000;
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let plant = PlantStep::new(&scene.device, 1e-3, 0.0);
    let dice = &mut Dice::new(seed);
    let voltage = |row: usize| if (200..500).contains(&row) { 4.0 } else { 0.0 };
    let mut state = plant.at_rest(scene.device.rest_position_m);
    let (mut command, mut position_m) = (vec![], vec![]);
    for row in 0..ROWS {
        command.push(voltage(row.saturating_sub(late_rows)));
        position_m.push(plant.position_m(&state) + 1e-7 * dice.between(-1.0, 1.0));
        state = plant.advance(&state, voltage(row));
    }
    Record {
        name: "made".into(),
        start_s: 0.0,
        step_s: 1e-3,
        drive: Drive::Voltage,
        command,
        position_m,
        may_clip: true,
    }
}

fn with_latency(fit_latency: bool) -> Options {
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    Options {
        latency_s: 0.0,
        fit_latency,
        resolution_m: 0.0,
        terms: Terms::NONE,
        ..Options::of_scene(&scene, Gain::Given(1.0))
    }
}

#[test]
fn a_latency_that_is_0_to_its_interval_is_held_there_with_all_else() {
    let mut held = 0;
    for seed in 0..8 {
        let record = pulses(seed, 0);
        let found = identify(std::slice::from_ref(&record), &with_latency(true)).unwrap();
        assert!(found.latency_s.value >= 0.0);
        if found.warnings.iter().any(|warning| warning.contains("held at 0")) {
            held += 1;
            assert!(found.latency_s.value == 0.0 && found.latency_s.half_width > 0.0);
            // The first rows are left out, because a fitted latency may need commands from before the record.
            let first = found.fits[0].first;
            let rest = Record {
                start_s: record.time_s(first),
                command: record.command[first..].to_vec(),
                position_m: record.position_m[first..].to_vec(),
                ..record
            };
            let given = identify(&[rest], &with_latency(false)).unwrap();
            assert!((found.mass_kg.value / given.mass_kg.value - 1.0).abs() < 1e-9);
        }
    }
    println!("{held} of 8 are held");
    assert!((1..8).contains(&held));
}

#[test]
fn a_handle_that_moves_before_its_voltage_is_refused() {
    let error = identify(&[pulses(0, 5)], &with_latency(true)).unwrap_err();
    assert!(error.contains("the latency comes out negative, -5.0"), "{error}");
}

/// Radius of the axis, in m.
const AXIS_M: f64 = 0.02;
/// Size of a count of the axis in rad (16,000 counts per turn), and gain of its motor.
const COUNT_RAD: f64 = std::f64::consts::TAU / 16_000.0;
const GAIN_N_M_PER_V: f64 = 0.387;

/// The exact motion of an axis with Coulomb friction. A proportional loop controls the speed of the axis. The speed is
/// filtered at 100 Hz. The loop ends at `stop`. The first parameters are the inertia in kg m^2, the damping in N m
/// s/rad and the friction in N m.
fn axis([inertia, damping, friction]: [f64; 3], gain: f64, rows: usize, stop: usize) -> Record {
    fn advance([j, b, f]: [f64; 3], [x, v]: [f64; 2], torque: f64, left_s: f64) -> [f64; 2] {
        if v == 0.0 && torque.abs() <= f {
            return [x, 0.0];
        }
        let sign = if v == 0.0 { torque } else { v }.signum();
        let end = (torque - sign * f) / b;
        let decays = (-b / j * left_s).exp();
        let after = end + (v - end) * decays;
        if sign * after >= 0.0 {
            return [x + end * left_s + (v - end) * (1.0 - decays) * j / b, after];
        }
        let turn_s = (1.0 - v / end).ln() * j / b;
        advance([j, b, f], [x + end * turn_s + v * j / b, 0.0], torque, left_s - turn_s)
    }
    let (mut state, mut before, mut speed) = ([0.0; 2], 0.0, 0.0);
    let (mut command, mut position_m) = (vec![], vec![]);
    for row in 0..rows {
        let angle = (state[0] / COUNT_RAD).floor() * COUNT_RAD;
        speed += 0.3 * ((angle - before) * 100.0 - speed);
        before = angle;
        let wanted = if row >= 50 { 6.0 } else { 0.0 };
        let volts = if row < stop { gain * (wanted - speed) } else { 0.0 };
        command.push(volts);
        position_m.push(angle * AXIS_M);
        state = advance([inertia, damping, friction], state, GAIN_N_M_PER_V * volts, 0.01);
    }
    let (name, start_s, step_s) = ("made".into(), 0.0, 0.01);
    Record { name, start_s, step_s, command, position_m, drive: Drive::Voltage, may_clip: true }
}

fn of_axis(record: &Record) -> Result<Identification, String> {
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let options = Options {
        latency_s: 0.0,
        spring: false,
        resolution_m: COUNT_RAD * AXIS_M,
        ..Options::of_scene(&scene, Gain::Given(GAIN_N_M_PER_V / AXIS_M))
    };
    identify(std::slice::from_ref(record), &options)
}

/// Checks that inertia, damping and friction of an axis are inside their intervals. It also checks that the fit finds
/// no other term.
fn holds(record: &Record, truth: [f64; 3]) {
    let found = of_axis(record).unwrap();
    let terms = &found.terms;
    assert!(
        terms.lag_s.is_none() && terms.offset_n.is_none() && terms.phase.is_none(),
        "{terms:?}"
    );
    let [inertia, damping, friction] = truth;
    let square = AXIS_M * AXIS_M;
    for (estimate, truth) in [
        (found.mass_kg, inertia / square),
        (found.damping_n_s_per_m, damping / square),
        (terms.friction_n.unwrap(), friction / AXIS_M),
    ] {
        assert!(estimate.holds(truth), "{estimate:?} {truth}");
    }
}

#[test]
fn friction_is_found_in_a_record_that_ends_in_a_long_rest() {
    let truth = [0.0192, 5e-4, 0.05];
    holds(&axis(truth, 1.0, 1501, 750), truth);
}

#[test]
fn no_error_of_the_encoder_is_found_that_its_rows_cannot_show() {
    let truth = [0.0192, 5e-4, 0.05];
    holds(&axis(truth, 1.0, 1100, 1100), truth);
}

/// In this loop, friction has almost the same effect as inertia. The two effects differ by only 1 %.
#[test]
fn intervals_hold_a_friction_that_looks_like_inertia() {
    let truth = [0.0192, 0.005, 0.02];
    holds(&axis(truth, 0.2, 201, 201), truth);
}

#[test]
fn lost_counts_are_named_with_their_row() {
    let mut record = axis([0.0192, 5e-4, 0.05], 1.0, 800, 800);
    let none = of_axis(&record).unwrap();
    assert!(
        none.warnings.iter().all(|warning| !warning.contains("steps by")),
        "{:?}",
        none.warnings
    );
    record.position_m[400..].iter_mut().for_each(|x| *x -= 4.0 * COUNT_RAD * AXIS_M);
    let found = of_axis(&record).unwrap();
    let wanted = "steps by -4 counts at 4.0000 s (row 400 of the record, from 0)";
    assert!(found.warnings.iter().any(|warning| warning.contains(wanted)), "{:?}", found.warnings);
}

/// A motion in one direction cannot distinguish an offset from friction.
#[test]
fn the_term_that_a_record_does_not_show_is_the_one_that_is_named() {
    let record = axis([0.0192, 5e-4, 0.05], 1.0, 800, 800);
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let terms = Terms::these(|term| matches!(term, Term::Friction | Term::Offset));
    let options = Options {
        latency_s: 0.0,
        spring: false,
        resolution_m: COUNT_RAD * AXIS_M,
        terms,
        ..Options::of_scene(&scene, Gain::Given(GAIN_N_M_PER_V / AXIS_M))
    };
    let error = identify(&[record], &options).unwrap_err();
    assert!(error.contains("offset"), "{error}");
}

/// A device without a spring in open loop, integrated in steps of 2 us. The parameters are mass, damping, friction,
/// rise of friction, speed of its fall, and amplitude and pitch of the cogging. The second list has the amplifier's
/// cubic error, the drag, and the friction per metre.
fn rough(
    [mass, damping, friction, rise, fall, cogging, pitch]: [f64; 7],
    [cubic, drag, per_m]: [f64; 3],
) -> Record {
    const COUNT_M: f64 = 1e-6;
    let (mut x, mut v, mut forces, mut positions): (f64, f64, Vec<f64>, Vec<f64>) =
        (0.0, 0.0, vec![], vec![]);
    for row in 0..4000 {
        let force = [0.0, 1.0, 0.4, -0.8, 0.0, 0.7, -1.0, -0.3][row / 250 % 8];
        forces.push(force);
        positions.push((x / COUNT_M).floor() * COUNT_M);
        for _ in 0..500 {
            let net = force
                + cubic * force.powi(3)
                + cogging * (std::f64::consts::TAU * x / pitch + 0.5).sin();
            let held = friction + rise;
            if v == 0.0 && net.abs() <= held {
                continue;
            }
            let sign = if v == 0.0 { net.signum() } else { v.signum() };
            let rate = |v: f64| {
                (net - damping * v
                    - drag * v * v.abs()
                    - sign * (friction + per_m * x + rise * (-(v / fall).powi(2)).exp()))
                    / mass
            };
            let next = v + 2e-6 * rate(v + 1e-6 * rate(v));
            x += 1e-6 * (v + next);
            v = if next * sign < 0.0 { 0.0 } else { next };
        }
    }
    Record {
        name: "made".into(),
        start_s: 0.0,
        step_s: 1e-3,
        command: forces,
        position_m: positions,
        drive: Drive::Force,
        may_clip: false,
    }
}

fn of_rough(record: Record) -> super::Identification {
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let options = Options {
        latency_s: 0.0,
        spring: false,
        resolution_m: 1e-6,
        ..Options::of_scene(&scene, Gain::Force)
    };
    identify(&[record], &options).unwrap()
}

#[test]
fn friction_that_falls_with_the_speed_is_found() {
    let found = of_rough(rough([0.4, 2.0, 0.1, 0.05, 0.01, 0.0, 1.0], [0.0; 3]));
    println!("{:?} {:?}", found.terms, found.warnings);
    let curve = found.terms.stribeck.unwrap();
    for (estimate, truth) in [
        (found.mass_kg, 0.4),
        (found.damping_n_s_per_m, 2.0),
        (found.terms.friction_n.unwrap(), 0.1),
        (curve.speed_m_per_s, 0.01),
    ] {
        assert!((estimate.value / truth - 1.0).abs() < 0.02, "{truth}: {estimate:?}");
    }
    assert!(found.terms.cogging.is_none());
}

#[test]
fn cogging_is_found_with_its_pitch() {
    let found = of_rough(rough([0.4, 2.0, 0.0, 0.0, 1.0, 0.1, 5e-3], [0.0; 3]));
    println!("{:?} {:?}", found.terms, found.warnings);
    let cogging = found.terms.cogging.unwrap();
    for (estimate, truth) in [
        (found.mass_kg, 0.4),
        (found.damping_n_s_per_m, 2.0),
        (cogging.amplitude_n, 0.1),
        (cogging.pitch_m, 5e-3),
        (cogging.phase_rad, 0.5),
    ] {
        assert!((estimate.value / truth - 1.0).abs() < 0.01, "{truth}: {estimate:?}");
    }
    assert!(found.terms.stribeck.is_none() && found.terms.phase.is_none());
}

#[test]
fn an_amplifier_that_is_not_linear_is_named() {
    let found = of_rough(rough([0.4, 2.0, 0.1, 0.0, 1.0, 0.0, 1.0], [0.1, 0.0, 0.0]));
    let named = |warning: &String| warning.contains("an amplifier that is not linear");
    assert!(found.warnings.iter().any(named), "{:?}", found.warnings);
}

#[test]
fn drag_is_named() {
    let found = of_rough(rough([0.4, 2.0, 0.0, 0.0, 1.0, 0.0, 1.0], [0.0, 0.3, 0.0]));
    assert!(
        found.warnings.iter().any(|warning| warning.contains("drag")),
        "{:?} {:?}",
        found.warnings,
        found.terms
    );
}

#[test]
fn friction_that_depends_on_the_position_is_named() {
    let found = of_rough(rough([0.4, 2.0, 0.1, 0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 0.5]));
    let named = |warning: &String| warning.contains("friction that depends on the position");
    assert!(found.warnings.iter().any(named), "{:?} {:?}", found.warnings, found.terms);
}

/// A motor drives a second mass through a gap. The encoder is on the motor.
#[test]
fn backlash_before_a_second_mass_is_named() {
    const STEP_S: f64 = 5e-4;
    const PARTS: u32 = 25;
    const COUNT_M: f64 = 8e-6;
    const GAP_M: f64 = 1.2e-4;
    let (motor_kg, load_kg, spring, damper) = (0.04, 0.1, 3.5e5, 75.0);
    let ([mut x, mut v], [mut load_x, mut load_v]) = ([0.0_f64; 2], [0.0_f64; 2]);
    let rows = (0..4_000).map(|row: u32| {
        let force = 0.5 * [1.0, -1.0, 0.0, -1.0, 1.0, 0.5][row as usize / 200 % 6];
        let seen = (x / COUNT_M).floor() * COUNT_M;
        for _ in 0..PARTS {
            let apart = x - load_x;
            let pressed = apart - apart.clamp(-0.5 * GAP_M, 0.5 * GAP_M);
            let damps = if pressed == 0.0 { 0.0 } else { damper * (v - load_v) };
            let contact = spring * pressed + damps;
            v += STEP_S / f64::from(PARTS) * (force - 0.5 * v - contact) / motor_kg;
            load_v += STEP_S / f64::from(PARTS) * contact / load_kg;
            x += STEP_S / f64::from(PARTS) * v;
            load_x += STEP_S / f64::from(PARTS) * load_v;
        }
        format!("{},{force},{seen}\n", f64::from(row) * STEP_S)
    });
    let text = "time_s,force_n,position_m\n".to_owned() + &rows.collect::<String>();
    let record = Record::from_csv("log", &text, Span::default(), Units::Linear, COUNT_M).unwrap();
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let options = Options {
        latency_s: 0.0,
        resolution_m: COUNT_M,
        spring: false,
        ..Options::of_scene(&scene, Gain::Force)
    };
    let found = identify(&[record], &options).unwrap();
    let named =
        |warning: &String| warning.contains("likely missing: backlash before a second mass");
    assert!(found.warnings.iter().any(named), "{:?} {:?}", found.warnings, found.terms);
}

/// Drag is no term of the model, so the residual is weighed as a force. Position and speed at the start are fitted to
/// the positions even then.
#[test]
fn a_fit_of_forces_still_begins_where_the_record_does() {
    let (step_s, mass_kg, drag) = (1e-3, 1.0, 20.0);
    let (mut x, mut v) = (0.0_f64, 0.02_f64);
    let rows = (0..6_000).map(|row| {
        let volts = 4.0 * (2.3 * f64::from(row) * step_s).sin();
        let seen = x;
        for _ in 0..50 {
            v += step_s / 50.0 * (volts - 0.5 * v - drag * v * v.abs()) / mass_kg;
            x += step_s / 50.0 * v;
        }
        format!("{},{volts},{seen}\n", f64::from(row) * step_s)
    });
    let text = "time_s,force_n,position_m\n".to_owned() + &rows.collect::<String>();
    let record = Record::from_csv("log", &text, Span::default(), Units::Linear, 0.0).unwrap();
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let options = Options {
        latency_s: 0.0,
        resolution_m: 0.0,
        spring: false,
        terms: Terms::NONE,
        ..Options::of_scene(&scene, Gain::Force)
    };
    let found = identify(&[record], &options).unwrap();
    assert!(found.warnings.iter().any(|warning| warning.contains("weighs it as the force")));
    let fit = &found.fits[0];
    let mean_m = fit.residual_m.iter().sum::<f64>() / fit.residual_m.len() as f64;
    assert!(mean_m.abs() < 1e-3 * fit.rms_m(), "{mean_m} {}", fit.rms_m());
}
