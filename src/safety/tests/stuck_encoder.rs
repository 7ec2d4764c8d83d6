#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "small numbers, of a handle for the integers to watch"
)]

use std::println;

use super::{
    super::plan::{
        PUSH_S,
        tests::{DESIGN, SETTINGS},
    },
    *,
};
use crate::{Design, safety::SafetySettings};
use proptest::{
    prelude::Rng,
    test_runner::{RngAlgorithm, TestRng},
};

fn plan() -> SafetyPlan {
    SETTINGS.build(&DESIGN).unwrap()
}

/// A force that is `bits` LSB above the limit of 10 %.
fn above(bits: i32) -> Force {
    Force::saturating_from_bits(PUSH_FORCE + bits)
}

fn out() -> Force {
    Force::saturating_from_bits(-PUSH_FORCE - 1)
}

/// A force, from its part of full scale.
fn part(part: f64) -> Force {
    Force::saturating_from_bits((part * f64::from(1 << Force::FRACTION_BITS)) as i32)
}

/// Runs at most 200 outputs. Returns the output at which the check fails, if it does.
fn fails_at(mut step: impl FnMut(u32) -> (Force, bool, i32)) -> Option<u32> {
    let mut watch = StuckEncoder::default();
    (0..200).find(|&n| {
        let (force, contact, count) = step(n);
        watch.failed(&plan(), Some(force), contact, Position::from_counts(count))
    })
}

#[test]
fn a_dead_count_is_found_after_50_ms() {
    assert_eq!(fails_at(|_| (above(1), false, 7)), Some(50));
    assert_eq!(fails_at(|_| (out(), false, 7)), Some(50));
}

/// A count that moves exactly as far as the heaviest handle passes the check. With one count less the check fails.
#[test]
fn the_way_of_the_heaviest_handle_itself_is_enough() {
    for (moved, fails) in [(5, false), (4, true)] {
        let mut plan = plan();
        (plan.yields, plan.slows) = (0, 0);
        let at = Watched::at(Position::from_counts(0));
        let mut watch = StuckEncoder { inward: true, still: at, far: at, speed: 0, way: 0 };
        watch.far.outputs = plan.push_renders;
        watch.way = 5 << HEAVIEST_BITS;
        let place = Position::from_counts(moved);
        assert_eq!(watch.failed(&plan, Some(above(1)), false, place), fails, "{moved}");
    }
}

/// At slightly more than 10 % the heaviest handle does not move, so only the first check can fail.
#[test]
fn a_flicker_of_two_counts_is_no_motion_and_three_are() {
    let flicker =
        |counts: u32| move |n: u32| (above(1), false, i32::from(n % 2 == 1) * counts.cast_signed());
    assert_eq!(fails_at(flicker(2)), Some(50));
    assert_eq!(fails_at(flicker(3)), None);
}

#[test]
fn small_forces_contact_and_changes_of_direction_start_it_anew() {
    let at_limit = above(0);
    assert_eq!(fails_at(|_| (at_limit, false, 0)), None);
    assert_eq!(fails_at(|_| (above(1), true, 0)), None);
    assert_eq!(fails_at(|n| (above(1), n == 49, 0)), Some(100));
    assert_eq!(fails_at(|n| (if n < 30 { out() } else { above(1) }, false, 0)), Some(80));
    let mut watch = StuckEncoder::default();
    assert!((0..200).all(|_| !watch.failed(&plan(), None, false, Position::default())));
}

/// Computes the positions of a handle with this mass and damping at each output, in counts. It starts at rest. The
/// force on it is the part `force` of full scale, less 10 %.
fn moves(design: &Design, kg: f64, damping: f64, force: f64) -> impl FnMut(u32) -> i32 {
    let steps = 100;
    let step_s = design.period_s() / f64::from(steps);
    let net_n = (force.abs() - 0.1) * design.full_scale_n;
    let (mut x_m, mut v, mut at) = (0.0, 0.0, 0);
    let resolution_m = design.resolution_m;
    move |n| {
        for _ in at..n * steps {
            v += (net_n - damping * v) / kg * step_s;
            x_m += v * step_s;
        }
        at = n * steps;
        (x_m / resolution_m).copysign(force) as i32
    }
}

/// The handle of the plan is 8 kg and 110 N s/m.
#[test]
#[cfg_attr(miri, ignore = "handles in steps of 10 us")]
fn a_count_that_moves_less_than_the_heaviest_handle_is_found() {
    for force in [0.2, 0.5, 1.0, -0.5] {
        for (kg, damping, found) in [
            (4.0, 25.0, None),
            (7.7, 105.0, None),
            (8.4, 115.0, Some(50)),
            (20.0, 0.0, Some(50)),
            // This handle at first moves as far as the heaviest one, but not later.
            (2.0, 140.0, Some(150)),
        ] {
            let mut place = moves(&DESIGN, kg, damping, force);
            let at = fails_at(|n| (part(force), false, place(n)));
            assert_eq!(at, found, "{force} {kg} {damping}");
        }
    }
    // An encoder that drifts a count in 10 ms, in either direction.
    for sign in [1, -1] {
        let drift = |n: u32| (part(0.5), false, sign * (n / 10).cast_signed());
        assert_eq!(fails_at(drift), Some(50));
    }
    // An encoder that follows only a fiftieth of the motion from some time on.
    let mut place = moves(&DESIGN, 0.416, 5.5195, 0.5);
    let from = 70;
    let (mut kept, mut last) = (0, 0);
    let at = fails_at(|n| {
        let now = place(n);
        kept += if n < from { now - last } else { (now - last) / 50 };
        last = now;
        (part(0.5), false, kept)
    });
    assert!(at.is_some_and(|at| at - from <= 100), "{at:?}");
}

/// At every output period the check takes 50 ms, with the same handle.
#[test]
#[cfg_attr(miri, ignore = "handles in steps of 1 us")]
fn the_handle_is_the_same_at_every_period() {
    for period in [1, 2, 5, 10] {
        let design = Design { period, ..DESIGN };
        let plan = SETTINGS.build(&design).unwrap();
        let most = (PUSH_S / design.period_s()).round() as u32;
        let fails = |kg: f64, damping: f64| {
            let mut watch = StuckEncoder::default();
            let mut place = moves(&design, kg, damping, 0.5);
            (0..6 * most).find(|&n| {
                let position = Position::from_counts(place(n));
                watch.failed(&plan, Some(part(0.5)), false, position)
            })
        };
        assert_eq!(fails(7.7, 105.0), None, "{period}");
        assert_eq!(fails(8.4, 115.0), Some(most), "{period}");
    }
}

#[test]
fn no_plan_overflows_it() {
    let lightest = *SafetySettings::HEAVIEST_MASS_KG.start();
    for (heaviest_mass_kg, resolution_m) in [(lightest, 1e-8), (1e6, 1e-3)] {
        for (period, rate_hz) in [(1, 1e4), (125, 1e4), (625, 5e4)] {
            let design = Design { period, resolution_m, rate_hz, ..DESIGN };
            let speed = resolution_m * design.rate_hz;
            let settings = SafetySettings {
                heaviest_mass_kg,
                speed_max_m_per_s: speed,
                speed_believable_m_per_s: speed,
                travel_low_m: -resolution_m,
                travel_high_m: resolution_m,
                ..SETTINGS
            };
            let plan = settings.build(&design).unwrap();
            let mut watch = StuckEncoder::default();
            let push = Some(Force::FULL_SCALE);
            let found = (0..600).filter(|_| watch.failed(&plan, push, false, Position::default()));
            assert!(found.count() > 50);
        }
    }
}

/// The motor pushes until the handle is at the wall, or for a second. Returns whether this is found as a push without
/// motion, and the time until then, in s. The handle is the paper's, with Coulomb friction. An arm holds it: a mass
/// with damper and spring to the ground, as a scene's `[arm]`. The grip between handle and arm is a spring and damper,
/// relaxed at the start. The mass, the dampings and the grip's stiffness go from a third of the smaller to three times
/// the larger value of the simulator's two arms. The integrator is semi-implicit Euler at 10 kHz.
fn push(random: &mut TestRng) -> (bool, f64) {
    const STEP_S: f64 = 1e-4;
    const MASS_KG: f64 = 0.416;
    const DAMPING: f64 = 5.5195;
    let plan = plan();
    let mut between = |low: f64, high: f64| {
        low * f64::powf(high / low, f64::from(random.next_u32()) / f64::from(u32::MAX))
    };
    let force = between(0.15, 1.0);
    let full_n = DESIGN.full_scale_n;
    let friction_n = between(0.001, 0.08) * full_n;
    let way_m = between(0.002, 0.04);
    let (arm_kg, arm_damping) = (between(0.17, 3.3), between(1.7, 15.0));
    let (grip, grip_damping) = (between(300.0, 9e3), between(5.0, 75.0));
    // A spring that keeps the handle from the wall acts like a hand.
    let stiffness = between(0.01, 0.5) * (force * full_n - friction_n) / way_m;
    let (mut x_m, mut v, mut hand_m, mut hand_v) = (0.0, 0.0, 0.0, 0.0);
    let mut watch = StuckEncoder::default();
    for n in 0..10_000 {
        if n % 10 == 0 {
            let position = Position::from_counts((x_m / DESIGN.resolution_m).floor() as i32);
            if watch.failed(&plan, Some(part(force)), x_m >= way_m, position) {
                return (true, f64::from(n) * STEP_S);
            }
        }
        if x_m >= way_m {
            return (false, f64::from(n) * STEP_S);
        }
        let grip_n = grip * (x_m - hand_m) + grip_damping * (v - hand_v);
        let rest_n = force * full_n - grip_n - DAMPING * v;
        let slips = v.abs() > 1e-9 || rest_n.abs() > friction_n;
        let friction =
            if v.abs() > 1e-9 { friction_n.copysign(v) } else { friction_n.copysign(rest_n) };
        let was = v;
        v += if slips { (rest_n - friction) / MASS_KG * STEP_S } else { 0.0 };
        v = if was * v < 0.0 { 0.0 } else { v };
        x_m += v * STEP_S;
        hand_v += (grip_n - stiffness * hand_m - arm_damping * hand_v) / arm_kg * STEP_S;
        hand_m += hand_v * STEP_S;
    }
    (false, 1.0)
}

fn false_alarms(hours: f64, seed: u8) -> u32 {
    let mut random = TestRng::from_seed(RngAlgorithm::ChaCha, &[seed; 32]);
    let (mut time_s, mut pushes, mut alarms) = (0.0, 0, 0);
    while time_s < hours * 3600.0 {
        let (alarm, took_s) = push(&mut random);
        time_s += took_s;
        pushes += 1;
        alarms += u32::from(alarm);
    }
    println!("{alarms} false alarms in {hours} hours, {pushes} pushes");
    alarms
}

#[test]
#[cfg_attr(miri, ignore = "an hour of motion")]
fn a_hand_and_friction_raise_no_alarm() {
    assert_eq!(false_alarms(0.2, 1), 0);
}

#[test]
#[ignore = "a day of motion"]
fn a_hand_and_friction_raise_no_alarm_in_a_day() {
    assert!(false_alarms(24.0, 2) <= 1);
}
