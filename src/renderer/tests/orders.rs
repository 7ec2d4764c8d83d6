//! Tests the orders that begin no experiment: settings, signs, black box, stop and clear.

use super::*;

#[test]
fn requests_reach_the_supervisor_and_the_sampling_task_at_once() {
    let mut bench = Bench::new();
    let before = bench.sampling.commands.len();
    bench.met(Order::Request(Request::Stall(true)));
    assert_eq!(bench.sampling.commands.len(), before + 1);
    assert!(bench.sampling.commands[before].stall);
    assert_eq!(bench.order(Order::Request(Request::Arm)), Err(Refusal::NotZeroed));
    assert_eq!(bench.order(Order::Request(Request::Clear)), Err(Refusal::NoFault));
}

#[test]
fn a_host_that_falls_silent_takes_the_force_away_in_time() {
    let mut bench = Bench::armed();
    let word = Order::Alive(Promise::of(200.0).unwrap());
    for _ in 0..5 {
        bench.met(word);
        bench.run(190);
        assert_eq!(bench.status().state, State::Armed);
    }
    bench.met(word);
    bench.run(198);
    assert!(matches!(bench.last, OutputCommand::On(_)));
    bench.run(2);
    assert_eq!(bench.last, OutputCommand::Off);
    assert_eq!(bench.status().fault.map(|record| record.fault), Some(Fault::HostSilent));
    // After the fault of a silent host its promise no longer holds.
    bench.met(Order::Request(Request::Clear));
    bench.met(Order::Request(Request::Arm));
    bench.run(600);
    assert_eq!(bench.status().state, State::Armed);
    // If a promise is given with the force off, its time begins with `arm`.
    bench.met(Order::Request(Request::Disarm));
    bench.met(word);
    bench.run(300);
    assert_eq!(bench.status().state, State::Off);
    bench.met(Order::Request(Request::Arm));
    bench.run(190);
    assert_eq!(bench.status().fault, None);
    bench.run(10);
    assert_eq!(bench.status().fault.map(|record| record.fault), Some(Fault::HostSilent));
}

/// The console sends these orders only if its knowledge of the state is old.
#[test]
#[cfg_attr(miri, ignore = "arms in closed loop")]
fn an_experiment_is_begun_alone_and_pulses_without_a_wall_only() {
    let mut bench = Bench::armed();
    for (k, b) in [(100.0, 0.0), (0.0, 1.0)] {
        bench.gains(k, b);
        assert_eq!(bench.order(bench.pulses()), Err(Refusal::Settings), "{k} {b}: the wall acts");
    }
    bench.gains(0.0, 0.0);
    bench.met(bench.pulses());
    for order in [bench.pulses(), bench.hit(), Bench::calibrate(5.0)] {
        assert_eq!(bench.order(order), Err(Refusal::Busy));
    }
    bench.met(Order::Stop);
    bench.met(Bench::calibrate(5.0));
    bench.met(Bench::calibrate(6.0));
    assert_eq!(bench.order(bench.hit()), Err(Refusal::Busy));
}

/// Without an experiment each output sets the push to zero again.
#[test]
#[cfg_attr(miri, ignore = "arms in closed loop")]
fn the_push_of_no_experiment_is_none_whatever_it_has_become() {
    let mut bench = Bench::armed();
    *bench.renderer.experiments.parts().push = Force::FULL_SCALE;
    bench.run(2);
    assert_eq!(*bench.renderer.experiments.parts().push, Force::ZERO);
}

#[test]
fn an_order_that_came_otherwise_is_refused() {
    let mut bench = Bench::new();
    bench.renderer.refuse();
    bench.run(1);
    let event = bench.reports.last().unwrap().event;
    assert!(matches!(event, Event::Answer(Err(Refusal::Faulted(Fault::Memory)))), "{event:?}");
}

/// The force is off when the answer comes. The four cases are: during a hit, without a hit, with the force already off,
/// and with a fault.
#[test]
fn disarm_is_answered_with_the_force_off() {
    for case in 0..4 {
        let mut bench = if case == 3 { Bench::new() } else { Bench::armed() };
        match case {
            1 => {
                bench.stored.push_n = 1.0;
                bench.met(bench.hit());
                bench.run(3);
                assert!(bench.last.force().is_some_and(|force| force != Force::ZERO));
            }
            2 => bench.sensed.stop_closed = false,
            _ => {}
        }
        bench.met(Order::Request(Request::Disarm));
        assert_eq!(bench.last, OutputCommand::Off, "{case}");
        let command = bench.sampling.commands.last().unwrap();
        assert_eq!((command.force, command.speed), (Force::ZERO, GuardCommand::ANY), "{case}");
        let expected = if case == 2 { State::Fault } else { State::Off };
        assert_eq!(bench.status().state, expected, "{case}");
        bench.run(2);
        assert_eq!((bench.last, bench.activity()), (OutputCommand::Off, Activity::None));
    }
}

#[test]
fn settings_are_exchanged_whole_counted_and_refused_where_they_would_throw() {
    let mut bench = Bench::armed();
    let settings = bench.renderer.settings;
    // With another wall the estimator does not start anew.
    let (known, commands) = (bench.sampling.parameters.len(), bench.sampling.commands.len());
    bench.stored.settings.wall.stiffness_n_per_m = 1000.0;
    bench.met(DEVICE.order(&bench.stored).unwrap());
    assert_eq!(bench.sampling.parameters[known..], [DEVICE.control(&bench.stored).unwrap()]);
    assert_eq!(bench.sampling.commands.len(), commands);
    bench.output(None);
    assert_eq!(bench.reports.last().unwrap().record.settings, settings + 1);
    // With another cutoff the estimator starts anew.
    bench.stored.settings.wall.stiffness_n_per_m = 0.0;
    bench.stored.settings.velocity = bench.stored.settings.velocity.with_tuning(1000.0);
    bench.met(DEVICE.order(&bench.stored).unwrap());
    let (before, now) = (bench.sampling.parameters[known], bench.sampling.parameters[known + 1]);
    assert_eq!(now, DEVICE.control(&bench.stored).unwrap().after(&before));
    assert_ne!(now.estimator, DEVICE.control(&bench.stored).unwrap().estimator);
    assert_eq!(bench.sampling.commands.len(), commands);
    // The new wall would be at the position of the handle.
    let kept = bench.renderer.parameters;
    bench.stored.settings.wall.position_m = -0.03;
    let refused = bench.order(DEVICE.order(&bench.stored).unwrap());
    assert_eq!((refused, bench.renderer.parameters), (Err(Refusal::Contact), kept));
    assert_eq!(bench.sampling.parameters.len(), known + 2);
}

#[test]
fn gains_outside_the_envelope_are_valid_only_if_it_is_unlocked() {
    let mut bench = Bench::new();
    let valid = |bench: &mut Bench| {
        bench.output(None);
        bench.status().inputs.settings_valid
    };
    assert!(valid(&mut bench));
    bench.stored.settings.wall.stiffness_n_per_m = 1e6;
    bench.met(DEVICE.order(&bench.stored).unwrap());
    assert!(!valid(&mut bench));
    bench.met(Order::Request(Request::Unlock));
    assert!(valid(&mut bench));
    bench.met(Order::Request(Request::Disarm));
    assert!(!valid(&mut bench));
}

#[test]
fn signs_are_turned_with_the_force_off_and_the_zero_is_lost() {
    let signs = Signs { motor_reversed: true, encoder_reversed: true };
    let mut bench = Bench::armed();
    assert_eq!(bench.order(Order::Signs(signs)), Err(Refusal::On));
    assert_eq!((bench.renderer.motor_reversed(), bench.sampling.turned), (false, None));
    bench.met(Order::Request(Request::Disarm));
    bench.met(Order::Signs(signs));
    assert_eq!((bench.renderer.motor_reversed(), bench.sampling.turned), (true, Some(true)));
    assert!(!bench.status().zeroed);
}

#[test]
#[cfg_attr(miri, ignore = "arms in closed loop")]
fn the_black_box_is_read_out_oldest_first_beside_the_present_and_released_by_clear() {
    let mut bench = Bench::armed();
    bench.sensed.stop_closed = false;
    bench.run(20);
    let fault = bench.status().fault.unwrap().sample;
    bench.met(Order::Replay);
    bench.run(9);
    let sent: Vec<_> = bench.reports[bench.reports.len() - 10..].iter().collect();
    let replayed: Vec<_> = sent
        .iter()
        .filter(|report| report.streamed.flags.contains(Flags::REPLAY))
        .map(|report| report.streamed.sample)
        .collect();
    let expected: Vec<_> = (0..8).map(|n| fault - 70 + 10 * n).collect();
    assert_eq!(replayed, expected);
    assert!(sent.iter().all(|report| !report.record.flags.contains(Flags::REPLAY)));
    let last = sent[9];
    assert_eq!(last.streamed, last.record);
    assert!(bench.renderer.history.is_frozen());
    bench.sensed.stop_closed = true;
    bench.output(None);
    bench.met(Order::Request(Request::Clear));
    assert!(!bench.renderer.history.is_frozen());
}

#[test]
fn the_black_box_keeps_a_fault_until_a_clear_that_is_met() {
    let mut bench = Bench::new();
    bench.met(Order::Request(Request::Trip(Fault::HostSilent)));
    bench.sensed.found = FaultSet::EMPTY.with(Fault::Registers);
    bench.run(2);
    assert!(bench.renderer.history.is_frozen());
    bench.met(Order::Request(Request::Disarm));
    let refused = bench.order(Order::Request(Request::Clear));
    assert_eq!(refused, Err(Refusal::CausePresent(Fault::Registers)));
    assert!(bench.renderer.history.is_frozen());
    bench.sensed.found = FaultSet::EMPTY;
    bench.run(1);
    bench.met(Order::Request(Request::Clear));
    assert!(!bench.renderer.history.is_frozen());
}

/// The fault is written to the memory once, and erased at `clear`.
#[test]
fn what_the_backup_memory_is_to_hold_is_said_once() {
    let mut bench = Bench::new();
    for (request, update) in [
        (Request::Trip(Fault::HostSilent), true),
        (Request::Stall(false), false),
        (Request::Clear, true),
    ] {
        bench.met(Order::Request(request));
        assert_eq!(bench.renderer.take_memory_update().is_some(), update, "{request:?}");
        assert_eq!(bench.renderer.take_memory_update(), None);
    }
}

#[test]
#[cfg_attr(miri, ignore = "arms in closed loop")]
fn a_clear_does_not_cut_the_black_box_off() {
    let mut bench = Bench::armed();
    bench.sensed.stop_closed = false;
    bench.run(20);
    bench.sensed.stop_closed = true;
    bench.output(None);
    let fault = bench.status().fault.unwrap().sample;
    bench.met(Order::Replay);
    bench.run(2);
    bench.met(Order::Request(Request::Clear));
    bench.run(7);
    let sent = &bench.reports[bench.reports.len() - 11..];
    let replayed: Vec<_> = sent
        .iter()
        .filter(|report| report.streamed.flags.contains(Flags::REPLAY))
        .map(|report| report.streamed.sample)
        .collect();
    assert_eq!(replayed, (0..8).map(|n| fault - 70 + 10 * n).collect::<Vec<_>>());
    assert!(!bench.renderer.history.is_frozen(), "it records again");
}

#[test]
#[cfg_attr(miri, ignore = "a motor takes half a minute to warm")]
fn a_motor_that_has_worked_is_warm() {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.met(Bench::calibrate(20.0));
    bench.run(9_000);
    assert!(bench.renderer.experiments.parts().duty.per_mille() > 0);
}

/// Tries all facts that a board senses, and checks what the supervisor makes of them.
#[test]
fn inputs_tell_a_stop_from_a_debugger_from_a_cut() {
    let found = FaultSet::EMPTY.with(Fault::Registers);
    let held = Inputs {
        stop_closed: true,
        supply_good: true,
        settings_valid: true,
        halted: false,
        found: FaultSet::EMPTY,
    };
    for (sensed, cut, expected) in [
        (GOOD, false, held),
        (Sensed { stop_closed: false, ..GOOD }, false, Inputs { stop_closed: false, ..held }),
        (Sensed { was_stopped: true, ..GOOD }, false, Inputs { stop_closed: false, ..held }),
        (
            Sensed { was_stopped: true, enabled: false, ..GOOD },
            false,
            Inputs { stop_closed: false, ..held },
        ),
        // while the output is off, a past stop does not count
        (Sensed { was_stopped: true, switched_on: false, ..GOOD }, false, held),
        (
            Sensed { supply_good: false, enabled: false, ..GOOD },
            false,
            Inputs { supply_good: false, ..held },
        ),
        (Sensed { halted: true, ..GOOD }, false, Inputs { halted: true, ..held }),
        // a halt may set the flag of a stop
        (
            Sensed { halted: true, was_stopped: true, ..GOOD },
            false,
            Inputs { halted: true, ..held },
        ),
        (Sensed { halted: true, switched_on: false, ..GOOD }, false, held),
        // Enable is inactive, and the board gives no reason.
        (Sensed { enabled: false, ..GOOD }, false, Inputs { halted: true, ..held }),
        (Sensed { enabled: false, ..GOOD }, true, held),
        (Sensed { enabled: false, switched_on: false, ..GOOD }, false, held),
        // the board has switched enable off, and gives the reason
        (Sensed { enabled: false, found, ..GOOD }, false, Inputs { found, ..held }),
    ] {
        assert_eq!(Inputs::of(sensed, cut, true), expected, "{sensed:?} {cut}");
    }
    assert!(!Inputs::of(GOOD, false, false).settings_valid);
}
