//! Tests which faults are found, how soon, and how they end.

use super::*;

#[test]
#[cfg_attr(miri, ignore = "arms four times in closed loop")]
fn a_turned_motor_and_a_dead_encoder_do_not_get_past_arm() {
    for (motor, dead) in [(-1.0, false), (1.0, true)] {
        let mut bench = Bench::new();
        (bench.motor, bench.dead) = (motor, dead);
        bench.run(1);
        bench.ask(Request::Zero).unwrap();
        bench.run(20);
        bench.ask(Request::Arm).unwrap();
        bench.run(11);
        assert!(bench.samples_until_off() <= 1010);
        assert_eq!(bench.fault(), Some(Fault::SignTestFailed));
        assert!(!bench.supervisor.status().zeroed);
        (bench.motor, bench.dead) = (1.0, false);
        bench.recover();
    }
}

#[test]
fn a_count_jump_is_off_with_the_same_sample() {
    let mut bench = Bench::armed();
    bench.offset = bench.offset.wrapping_add(600);
    let step = bench.sample();
    assert!(step.report.present.contains(Fault::CountJump) && bench.output.is_none());
    // The task `sample` alone keeps the output off, whatever `render` writes meanwhile.
    for _ in 0..50 {
        let step = bench.sample();
        assert!(step.cut || step.due);
    }
    let status = bench.supervisor.status();
    let record = status.fault.unwrap();
    assert_eq!((record.fault, record.sample), (Fault::CountJump, step.report.motion.sample));
    assert!(!status.zeroed);
    assert_eq!(bench.updates.last(), Some(&MemoryUpdate::Write(record)));
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Faulted(Fault::CountJump)));
    bench.recover();
    assert!(!bench.sample().cut);
}

#[test]
fn arm_is_refused_in_the_wall_whether_wall_or_handle_went_there() {
    let mut bench = Bench::new();
    bench.held = true;
    bench.run(1);
    bench.ask(Request::Zero).unwrap();
    bench.run(20);
    bench.control = control(-0.01, 2000.0);
    bench.run(20);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Contact));
    bench.control = control(0.01, 2000.0);
    bench.run(20);
    bench.held = false;
    bench.ask(Request::Arm).unwrap();
}

/// With a cutoff of 0.5 Hz the velocity of a fast handle is estimated late.
#[test]
fn high_speed_is_found_from_the_counts_whatever_the_cutoff() {
    let mut bench = Bench::armed();
    let settings = Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz: 0.5 },
        wall: WallSettings {
            position_m: 1.0,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        },
    };
    bench.control = settings.build(&DESIGN).unwrap();
    bench.run(200);
    bench.velocity_m_per_s = 1.5;
    assert!(bench.samples_until_off() <= 20, "one output period and what is left of the last");
    assert_eq!(bench.fault(), Some(Fault::OverSpeed));
}

#[test]
fn high_speed_is_a_fault_with_force_and_none_without() {
    let mut bench = Bench::new();
    bench.velocity_m_per_s = 1.5;
    bench.run(100);
    assert_eq!(bench.fault(), None);
    let mut bench = Bench::armed();
    bench.velocity_m_per_s = 1.5;
    assert!(bench.samples_until_off() <= 10); // the estimate follows within the filter's delay
    bench.run(10);
    assert_eq!(bench.fault(), Some(Fault::OverSpeed));
    bench.velocity_m_per_s = 0.0;
    bench.run(100);
    bench.recover();
}

#[test]
fn out_of_range_needs_a_zero_before_clear() {
    let mut bench = Bench::new();
    bench.offset = (1 << 30) + 1;
    bench.sampler = GuardedSampler::new(bench.offset, CounterWidth::Bits32);
    bench.run(20);
    assert_eq!(bench.fault(), Some(Fault::OutOfRange));
    assert_eq!(bench.ask(Request::Clear), Err(Refusal::CausePresent(Fault::OutOfRange)));
    bench.ask(Request::Zero).unwrap();
    bench.run(20);
    bench.recover();
}

#[test]
fn a_missing_output_is_off_when_the_next_is_due_and_a_stuck_task_is_named() {
    let mut bench = Bench::armed();
    while !bench.sample().due {}
    bench.missing = 1; // this output is lost; the due sample after it shows that
    assert_eq!(bench.samples_until_off(), 20);
    bench.run(20);
    assert_eq!(bench.fault(), Some(Fault::LateRender));
    bench.recover();
    while !bench.sample().due {}
    bench.missing = 30;
    assert_eq!(
        bench.samples_until_off(),
        21,
        "found at the second due sample, cut by the next one"
    );
    bench.run(400);
    let status = bench.supervisor.status();
    assert_eq!(status.fault.unwrap().fault, Fault::LateRender);
    assert!(status.causes.contains(Fault::StuckRender));
    bench.recover();
}

/// One output is lost, and the task `render` computes the next output four samples late. Before `render` runs, a sample
/// notes the lost output in the guard. So the guard's note is newer than the sample from which `render` computes the
/// output.
#[test]
fn a_late_output_is_named_with_the_sample_at_which_it_was_missed() {
    let mut bench = Bench::armed();
    while !bench.sample().due {}
    bench.missing = 1;
    bench.run(10);
    bench.delay = 4;
    bench.run(9);
    let Step { report: SampleReport { motion: missed, .. }, due, .. } = bench.sample();
    assert!(due);
    bench.run(4);
    let record = bench.supervisor.status().fault.unwrap();
    assert_eq!(record.fault, Fault::LateRender);
    assert!((missed.sample..=missed.sample + 1).contains(&record.sample), "{record:?}");
}

#[test]
#[cfg_attr(miri, ignore = "arms four times in closed loop")]
fn stop_supply_settings_and_debugger_are_off_within_one_output_and_need_their_cause_gone() {
    for (fault, inputs, refusal) in [
        (Fault::EmergencyStop, Inputs { stop_closed: false, ..GOOD }, Some(Refusal::StopOpen)),
        (Fault::BrownOut, Inputs { supply_good: false, ..GOOD }, Some(Refusal::Supply)),
        (Fault::Settings, Inputs { settings_valid: false, ..GOOD }, Some(Refusal::Settings)),
        (Fault::Debugger, Inputs { halted: true, ..GOOD }, None),
    ] {
        let mut bench = Bench::armed();
        bench.inputs = inputs;
        assert!(bench.samples_until_off() <= 10);
        assert_eq!(bench.fault(), Some(fault));
        bench.run(20);
        assert_eq!(bench.ask(Request::Clear), Err(Refusal::CausePresent(fault)));
        bench.inputs = GOOD;
        bench.run(20);
        bench.recover();
        // With the force off these inputs are no fault. They only prevent `arm`.
        bench.ask(Request::Disarm).unwrap();
        bench.inputs = inputs;
        bench.run(20);
        assert_eq!(bench.fault(), None);
        assert_eq!(bench.ask(Request::Arm).err(), refusal);
    }
}

#[test]
fn an_encoder_that_dies_in_free_motion_is_found_by_the_push() {
    let mut bench = Bench::armed();
    bench.dead = true;
    bench.offset = 0; // close to where it is: no jump
    bench.push = Force::saturating_from_bits(1 << 28);
    let samples = bench.samples_until_off();
    assert!((500..=540).contains(&samples), "{samples}");
    assert_eq!(bench.fault(), Some(Fault::PushWithoutMotion));
}

/// Behind the surface a handle may rest against the wall, so a lack of motion is no fault there. A wall without force
/// cannot hold the handle.
#[test]
fn an_encoder_that_dies_behind_a_wall_without_force_is_found_too() {
    for (stiffness, found) in [(0.0, true), (1000.0, false)] {
        let mut bench = Bench::armed();
        bench.held = true;
        bench.retune(control(-0.01, stiffness));
        bench.run(300); // the gains fade in
        bench.push = Force::saturating_from_bits(1 << 28);
        bench.run(1_000);
        assert!(bench.supervisor.status().contact, "{:?}", bench.position_m);
        let fault = found.then_some(Fault::PushWithoutMotion);
        assert_eq!(bench.fault(), fault, "{stiffness}");
    }
}

#[test]
fn a_handle_that_is_held_on_purpose_is_no_dead_encoder() {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.still = true;
    bench.push = Force::saturating_from_bits(1 << 28);
    bench.run(if cfg!(miri) { 1_000 } else { 20_000 });
    assert_eq!((bench.state(), bench.fault()), (State::Armed, None));
    bench.still = false;
    let samples = bench.samples_until_off();
    assert!((500..=540).contains(&samples), "{samples}");
    assert_eq!(bench.fault(), Some(Fault::PushWithoutMotion));
}

#[test]
fn the_first_fault_stays_and_later_ones_are_noted() {
    let mut bench = Bench::armed();
    bench.inputs.stop_closed = false;
    bench.run(10);
    bench.offset = bench.offset.wrapping_add(10_000);
    bench.run(20);
    bench.ask(Request::Trip(Fault::BrownOut)).unwrap();
    let status = bench.supervisor.status();
    assert_eq!(status.fault.unwrap().fault, Fault::EmergencyStop);
    assert!(status.causes.contains(Fault::CountJump) && status.causes.contains(Fault::BrownOut));
}

#[test]
fn a_fault_of_the_last_run_waits_for_clear() {
    let plan = SETTINGS.build(&DESIGN).unwrap();
    let mut bench = Bench::new();
    bench.supervisor = Supervisor::new(plan, Some(FaultRecord::bare(Fault::WatchdogReset)));
    bench.run(20);
    assert_eq!(bench.ask(Request::Arm), Err(Refusal::Faulted(Fault::WatchdogReset)));
    bench.recover();
}

#[test]
#[cfg_attr(miri, ignore = "carries the handle over 1 m")]
fn beyond_its_travel_the_handle_gets_no_force_and_may_be_moved_back() {
    let carry = |bench: &mut Bench, to_m: f64| {
        while (bench.position_m - to_m).abs() > 1e-9 {
            bench.position_m += (to_m - bench.position_m).clamp(-5e-5, 5e-5); // 0.5 m/s
            bench.run(1);
        }
        bench.run(200); // the estimate comes to rest
    };
    for end_m in [SETTINGS.travel_low_m, SETTINGS.travel_high_m] {
        let mut bench = Bench::armed();
        bench.control = control(1.0, 2000.0); // out of reach
        bench.held = true;
        let zero_m =
            bench.position_m - f64::from(bench.last.unwrap().record.position.counts()) * 1e-6;
        carry(&mut bench, zero_m + end_m - 1e-4 * end_m.signum());
        assert_eq!(bench.state(), State::Armed);
        carry(&mut bench, zero_m + end_m + 1e-4 * end_m.signum());
        assert_eq!((bench.fault(), bench.output), (Some(Fault::BeyondTravel), None));
        assert!(bench.supervisor.status().zeroed);
        bench.ask(Request::Clear).unwrap();
        bench.run(20);
        bench.ask(Request::Arm).unwrap();
        bench.run(20);
        assert_eq!((bench.fault(), bench.output), (Some(Fault::BeyondTravel), None));
        carry(&mut bench, zero_m + end_m / 2.0);
        bench.held = false;
        bench.velocity_m_per_s = 0.0;
        bench.recover();
    }
}
