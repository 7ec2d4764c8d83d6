//! Tests the requests to the supervisor, and their refusals.

use super::*;

#[test]
fn arm_tests_the_sign_then_ramps_in() {
    let mut bench = Bench::new();
    bench.run(1);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::NotZeroed));
    bench.ask(Request::Zero).unwrap();
    bench.run(20);
    assert_eq!(bench.last.unwrap().record.position.counts(), 0);
    bench.push = Force::saturating_from_bits(1 << 28);
    bench.control = control(1.0, 2000.0); // out of reach
    bench.ask(Request::Arm).unwrap();
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::On));
    let (mut forces, mut states) = (Vec::new(), Vec::new());
    for _ in 0..400 {
        bench.run(10);
        forces.push(bench.output.unwrap().bits());
        states.push(bench.state());
    }
    let count = |state| states.iter().filter(|s| **s == state).count();
    assert_eq!((count(State::SignTest), count(State::RampIn)), (100, 200));
    assert!(forces[..100].iter().all(|force| force.abs() <= SLEW));
    assert!(forces.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= SLEW));
    assert_eq!(forces[399], 1 << 28);
    let armed = FaultRecord::bare(Fault::ResetWhileArmed);
    assert_eq!(bench.updates, [MemoryUpdate::Write(armed)]);
    bench.ask(Request::Disarm).unwrap();
    bench.run(10);
    assert_eq!((bench.state(), bench.output), (State::Off, None));
    assert_eq!(bench.updates[1..], [MemoryUpdate::Erase]);
}

#[test]
fn a_turned_sign_loses_the_zero_and_is_refused_while_on() {
    let mut bench = Bench::armed();
    assert_eq!(bench.ask(Request::Turn), Err(Refusal::On));
    assert!(bench.supervisor.status().zeroed);
    bench.ask(Request::Disarm).unwrap();
    bench.ask(Request::Zero).unwrap();
    assert_eq!(bench.ask(Request::Turn), Err(Refusal::Zeroing));
    bench.run(20);
    bench.ask(Request::Turn).unwrap();
    assert!(!bench.supervisor.status().zeroed);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::NotZeroed));
}

#[test]
fn a_zero_while_armed_makes_no_step_and_no_jump() {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.control = control(0.01, 1e5);
    bench.still = true;
    bench.push = Force::saturating_from_bits(-(1 << 29));
    bench.run(200);
    let mut last = bench.output.unwrap().bits();
    assert_eq!(last, -(1 << 29));
    bench.push = Force::ZERO; // fades, and the zero comes in the midst of it
    for n in 0..15 {
        if n == 4 {
            bench.ask(Request::Zero).unwrap();
        }
        bench.run(10);
        let force = bench.output.unwrap().bits();
        assert!((force - last).abs() <= SLEW, "{n}: {last} {force}");
        last = force;
    }
    assert_eq!((bench.state(), last), (State::Armed, 0));
    assert_eq!(bench.last.unwrap().record.position.counts(), 0);
}

#[test]
fn a_zero_that_would_put_the_handle_into_the_wall_is_refused_while_armed() {
    let mut bench = Bench::armed();
    bench.velocity_m_per_s = -0.1;
    bench.run(200);
    bench.held = true;
    bench.control = control(-0.000_5, 1e5); // free here, but 500 counts deep once this place is 0
    bench.run(20);
    assert_eq!(bench.ask(Request::Zero), Err(Refusal::WallThere));
    bench.run(200);
    assert_eq!(bench.output, Some(Force::ZERO));
    bench.control = control(0.000_5, 1e5);
    bench.run(20);
    bench.ask(Request::Zero).unwrap();
    bench.control = control(-0.01, 1e5);
    bench.run(20);
    assert_eq!(bench.ask(Request::Zero), Err(Refusal::Contact));

    let mut bench = Bench::armed();
    bench.held = true;
    bench.control = control(0.0, 1e5); // the surface is at 0: the handle will be at the surface, not in the wall
    bench.position_m -= 100e-6;
    bench.run(20);
    assert_eq!(bench.ask(Request::Zero), Ok(()));
}

#[test]
fn flash_writing_is_no_fault_and_not_met_with_force_on() {
    let mut bench = Bench::armed();
    assert_eq!(bench.ask(Request::Stall(true)), Err(Refusal::On));
    bench.ask(Request::Disarm).unwrap();
    bench.inputs.supply_good = false;
    bench.run(20);
    assert_eq!(bench.ask(Request::Stall(true)), Err(Refusal::Supply));
    bench.inputs.supply_good = true;
    bench.run(20);
    bench.ask(Request::Stall(true)).unwrap();
    // The next sample may be the first sample after the stall.
    bench.offset = bench.offset.wrapping_add(5000);
    bench.run(1);
    bench.run(1);
    assert!(bench.guard.causes.is_empty());
    bench.run(18);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Stalled));
    bench.offset = bench.offset.wrapping_add(5000);
    bench.run(20);
    bench.ask(Request::Stall(false)).unwrap();
    bench.run(20);
    assert_eq!(bench.fault(), None);
    bench.offset = bench.offset.wrapping_add(5000);
    bench.run(20);
    assert_eq!(bench.fault(), Some(Fault::CountJump));
}

/// After the command `zero`, a later sample makes the position zero. Until then it is not known whether the handle will
/// be in a wall.
#[test]
fn while_a_zero_is_under_way_nothing_is_armed_and_no_wall_is_moved() {
    let mut bench = Bench::armed();
    let (from, to) = (bench.control, control(0.02, 2000.0));
    bench.ask(Request::Zero).unwrap();
    assert_eq!(bench.supervisor.may_change(&from, &to), Err(Refusal::Zeroing));
    assert_eq!(bench.supervisor.may_change(&from, &control(0.01, 1.0)), Ok(()));
    bench.run(20);
    assert_eq!(bench.supervisor.may_change(&from, &to), Ok(()));
    bench.ask(Request::Disarm).unwrap();
    bench.run(20);
    bench.ask(Request::Zero).unwrap();
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Zeroing));
    bench.run(20);
    assert_eq!(bench.ask(Request::Arm), Ok(()));
}

/// The state of the old tuning is gone with the first sample that has the new tuning.
#[test]
#[cfg_attr(miri, ignore = "every tuning of every estimator")]
fn another_tuning_starts_anew_with_its_first_sample() {
    use crate::velocity::{EstimatorName, State as Memory};
    for &name in EstimatorName::ALL {
        let Some((parameter, value)) = name.defaults().tuning() else { continue };
        for factor in [0.01, 0.1, 0.5, 2.0, 10.0, 100.0] {
            let of = |value: f64| {
                let value = if parameter.unit == "samples" { value.round() } else { value };
                let velocity = name.defaults().with_tuning(value);
                Settings {
                    velocity,
                    wall: WallSettings {
                        position_m: 0.5,
                        stiffness_n_per_m: 0.0,
                        damping_n_s_per_m: 0.0,
                        push_only: true,
                    },
                }
                .build(&DESIGN)
            };
            let (Ok(new), Ok(old)) = (of(value), of(value * factor)) else { continue };
            let mut bench = Bench::armed();
            bench.held = true;
            bench.still = true;
            bench.control = old;
            for n in 0..1503u32 {
                bench.position_m += if n % 3 == 0 { 3e-6 } else { 4e-6 };
                bench.sample();
            }
            let before = bench.sample().report.motion;
            let mut twin = Memory::at_rest(before.position);
            twin.restart_at(before.velocity);
            bench.retune(new);
            for n in 0..40u32 {
                bench.position_m += if n % 3 == 0 { 3e-6 } else { 4e-6 };
                let motion = bench.sample().report.motion;
                let fresh = new.estimator.update(&mut twin, motion.position, &Senses::NONE);
                assert_eq!(motion.velocity, fresh, "{} x {factor}, sample {n}", name.text());
            }
        }
    }
}

/// The guard gets the force that acts, which is 0 while off. It passes this force to the estimator.
#[test]
#[cfg(feature = "estimators")]
fn an_observer_under_guard_knows_the_force_last_granted() {
    let velocity = VelocitySettings::Observer { bandwidth_hz: 20.0, mass_kg: 0.4 };
    let wall = WallSettings {
        position_m: 0.5,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        push_only: true,
    };
    let late = |told: bool| {
        let mut bench = Bench::armed();
        let observer = Settings { velocity, wall }.build(&DESIGN).unwrap();
        bench.control = observer;
        bench.run(2000);
        bench.push = Force::saturating_from_bits(1 << 28); // a quarter of full scale: 370 counts in 10 ms
        let mut worst = 0.0f64;
        for _ in 0..200 {
            let step = bench.sample();
            if told {
                assert_eq!(bench.down.force, bench.output.unwrap_or_default());
            } else {
                bench.down.force = Force::ZERO;
            }
            let counts_per_sample = bench.velocity_m_per_s / 1e-6 / 1e4;
            worst = worst.max(
                (f64::from(step.report.motion.velocity.bits()) / 65_536.0 - counts_per_sample)
                    .abs(),
            );
        }
        bench.ask(Request::Disarm).unwrap();
        bench.run(10);
        assert_eq!(bench.down.force, Force::ZERO);
        worst
    };
    let (told, untold) = (late(true), late(false));
    assert!(told < 0.2 * untold, "{told} {untold}");
}

/// A handle at the surface itself is not in contact. So the surface may be moved up to the handle, but not one count
/// farther.
#[test]
fn a_wall_may_be_put_before_the_handle_and_not_over_it() {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.run(20);
    let at = bench.last.unwrap().record.position.counts();
    for (counts, expected) in [(at + 1, Ok(())), (at, Ok(())), (at - 1, Err(Refusal::Contact))] {
        let wall = control(f64::from(counts) * 1e-6, 2000.0);
        assert_eq!(wall.wall.surface().counts(), counts);
        assert_eq!(bench.supervisor.may_change(&bench.control, &wall), expected, "{}", counts - at);
    }
}

/// Checks the flags in the record of each output, from off to armed and during a change of the wall.
#[test]
fn flags_tell_armed_and_changing() {
    use crate::telemetry::Flags;
    let flags = |bench: &Bench| {
        let flags = bench.last.unwrap().record.flags;
        [Flags::ON, Flags::ARMED, Flags::CHANGING].map(|flag| flags.contains(flag))
    };
    let mut bench = Bench::new();
    bench.run(20);
    assert_eq!(flags(&bench), [false; 3]);
    bench.ask(Request::Zero).unwrap();
    bench.run(20);
    bench.ask(Request::Arm).unwrap();
    bench.run(20);
    assert_eq!(flags(&bench), [true, false, false]);
    let mut bench = Bench::armed();
    assert_eq!(flags(&bench), [true, true, false]);
    bench.push = Force::FULL_SCALE;
    bench.run(20);
    assert_eq!(flags(&bench), [true, true, true]);
}
