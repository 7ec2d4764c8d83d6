//! Tests that a fade has steps of at most 5 %, and that it never changes the sign of the wall's force.

use super::*;
use crate::units::Position;
use proptest::prelude::*;

/// An armed bench on which a hand holds the handle 100 counts deep in a wall of this stiffness.
pub fn in_the_wall(stiffness_n_per_m: f64) -> Bench {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.control = control(0.01, stiffness_n_per_m);
    while bench.last.unwrap().record.position < Position::from_counts(10_100) {
        bench.drag(50);
    }
    bench.run(500);
    bench
}

#[test]
fn a_wall_that_is_left_while_its_stiffness_fades_gives_nothing() {
    for (from, to) in [(0.0, 30_000.0), (30_000.0, 0.0)] {
        let mut bench = in_the_wall(from);
        bench.control = control(0.01, to);
        bench.run(20);
        assert!(bench.last.unwrap().record.flags.contains(crate::telemetry::Flags::CHANGING));
        bench.drag(-200); // out of it
        for _ in 0..10 {
            assert_eq!(bench.output, Some(Force::ZERO), "{from} {to}");
            bench.run(10);
        }
        bench.drag(101); // and in again
        assert!(bench.output.unwrap().bits() <= 0);
    }
}

#[test]
fn a_change_while_the_ramp_comes_in_steps_by_no_more_than_five_per_cent() {
    for ramp_in_s in [0.02, 0.05, 0.2] {
        let plan = SafetySettings { ramp_in_s, ..SETTINGS }.build(&DESIGN).unwrap();
        let mut bench = Bench::new();
        bench.supervisor = Supervisor::new(plan, None);
        bench.push = Force::saturating_from_bits(-(1 << 30));
        bench.held = true;
        bench.run(1);
        bench.ask(Request::Zero).unwrap();
        bench.run(20);
        bench.ask(Request::Arm).unwrap();
        let (mut last, mut n) = (Force::ZERO, 0);
        bench.held = false;
        while bench.state() == State::SignTest {
            bench.run(10);
            last = bench.output.unwrap();
        }
        bench.still = true;
        bench.held = true;
        while bench.state() != State::Armed || n < 120 {
            assert!(bench.state().is_on() && n < 1000, "{:?}", bench.fault());
            if n == 5 {
                bench.push = Force::FULL_SCALE; // a step of two full scales
            }
            bench.run(10);
            let now = bench.output.unwrap();
            let step = (now.bits() - last.bits()).abs();
            assert!(step <= SLEW + 1, "{ramp_in_s} {n}: {step}");
            (last, n) = (now, n + 1);
        }
        assert_eq!(last, Force::FULL_SCALE);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if cfg!(miri) { 1 } else { 64 }))]

    /// Gains change at any output. A hand moves the handle in and out. Outside the wall there is only the push. Inside,
    /// the force never exceeds the push.
    #[test]
    fn no_fading_gain_pulls_or_pushes_out_of_a_wall_that_is_left(
        push in -(1i32 << 29)..1 << 29,
        steps in prop::collection::vec(
            (-80i32..=80, prop::option::weighted(0.3, 0.0f64..1e5)), 1..120,
        )
    ) {
        let mut bench = in_the_wall(2000.0);
        bench.still = true;
        bench.push = Force::saturating_from_bits(push);
        bench.run(450); // faded in
        for (counts, stiffness) in steps {
            if let Some(stiffness) = stiffness {
                bench.control = control(0.01, stiffness);
            }
            bench.drag(counts);
            let force = bench.output.unwrap().bits();
            if bench.supervisor.status().contact {
                prop_assert!(force <= push, "it pulls: {force}");
            } else {
                prop_assert_eq!(force, push);
            }
        }
    }
}
