//! Tests the action of every command: its order, the settings that it stores, and its reply.

use super::*;
use crate::{
    device::tests::blind_estimator,
    velocity::{EstimatorName, Parameter},
};

#[test]
fn boot_says_what_runs_and_proposes_the_first_settings_quietly() {
    let mut console = Console::new(Board::default(), &DEVICE, DEVICE.defaults(), Source::Older);
    let version = version();
    let loaded = "ok load: older settings: the newest cannot be read";
    assert_eq!(console.port.lines, [version.as_str(), loaded]);
    assert_eq!(console.port.orders, [DEVICE.order(&DEVICE.defaults()).unwrap()]);
    // nothing is obeyed before the first report; the answer to the first order has no reply
    console.port.typed.extend(*b"get\n");
    console.pass(true);
    assert_eq!((console.port.lines.len(), console.port.typed.len()), (2, 4));
    let mut bench = Bench { console, status: OFF, activity: Activity::None };
    bench.report(Event::Answer(Err(Refusal::Contact)));
    bench.take();
    bench.console.pass(true);
    assert!(bench.take().0[0].starts_with("ok get "));
}

#[test]
fn what_only_looks_says_it_at_once() {
    let mut bench = Bench::new(OFF);
    assert!(bench.says("help").starts_with("ok help, version, "));
    let version = version();
    assert_eq!(bench.says("version"), version);
    assert!(bench.says("status").starts_with("ok status off, fault none, idle, sample 42,"));
    assert!(bench.says("get").starts_with("ok get k 0 N/m, b 0 N s/m, wall 0.07 m, cutoff 1500"));
    assert_eq!(bench.says("faults"), "ok faults none");
    assert_eq!(bench.says("nonsense"), "error: unknown command: help lists them");
    assert_eq!(bench.says(&"x".repeat(65)), "error: line too long: at most 64 bytes");
}

#[test]
fn faults_of_a_latched_fault_ask_for_the_black_box() {
    let fault = Some(FaultRecord::bare(Fault::OverSpeed));
    let mut bench = Bench::new(Status { state: State::Fault, fault, ..OFF });
    let (lines, orders) = bench.type_in("faults");
    assert!(lines[0].starts_with(&format!("ok faults {}", Fault::OverSpeed)), "{lines:?}");
    assert_eq!((lines.len(), orders.as_slice()), (1, &[Order::Replay][..]));
    assert!(bench.answer(Ok(())).is_empty());
}

/// The supervisor decides. The console sends the request, then replies `ok NAME` or the refusal.
#[test]
fn requests_are_passed_on_and_answered() {
    let fault = Some(FaultRecord::bare(Fault::OverSpeed));
    let faulted = Status { state: State::Fault, fault, ..OFF };
    for (line, status, request) in [
        ("zero", OFF, Request::Zero),
        ("arm", OFF, Request::Arm),
        ("disarm", ARMED, Request::Disarm),
        ("clear", faulted, Request::Clear),
        ("unlock envelope", OFF, Request::Unlock),
    ] {
        let mut bench = Bench::new(status);
        assert_eq!(bench.orders(line), Order::Request(request));
        // one command at a time
        assert_eq!(bench.type_in("version"), (Vec::new(), Vec::new()));
        assert_eq!(bench.answer(Ok(())), [format!("ok {line}")]);
        bench.console.pass(true);
        assert!(bench.take().0[0].starts_with("ok version"));
        bench.orders(line);
        let refused = bench.answer(Err(Refusal::Zeroing));
        assert_eq!(refused, ["error: a zero is under way: try again"]);
        // This answer comes although no order is under way.
        assert!(bench.answer(Ok(())).is_empty());
    }
}

#[test]
fn a_promise_is_passed_on_or_refused_with_what_is_allowed() {
    let mut bench = Bench::new(ARMED);
    assert_eq!(bench.orders("alive 200"), Order::Alive(Promise::of(200.0).unwrap()));
    assert_eq!(bench.answer(Ok(())), ["ok alive"]);
    assert_eq!(bench.orders("alive 0"), Order::Alive(Promise::default()));
    bench.answer(Ok(()));
    assert_eq!(bench.says("alive 10"), "error: alive is 10, allowed 20 to 10000");
}

#[test]
fn what_the_rules_refuse_gives_no_order() {
    let mut bench = Bench::new(OFF);
    assert_eq!(bench.says("hit"), "error: not armed: arm first and wait for the ramp");
    bench.status.inputs.settings_valid = false;
    bench.report(Event::None);
    assert_eq!(bench.says("arm"), "error: settings are not valid or outside the envelope: see get");
    // If the wall is outside the envelope, the refusal has the allowed range.
    bench.console.stored.change(|stored| stored.settings.wall.stiffness_n_per_m = 5000.0);
    let outside =
        "error: beyond the envelope: k at this b is allowed from 0 to 4000, or unlock envelope";
    assert_eq!(bench.says("arm"), outside);
    // The reply is the same if the supervisor refuses the command.
    bench.status = OFF;
    bench.report(Event::None);
    bench.orders("arm");
    assert_eq!(bench.answer(Err(Refusal::Settings)), [outside]);
}

/// A setting of the loop is ordered first. The console stores it when the order is accepted.
#[test]
fn settings_of_the_loop_are_proposed_and_kept_once_taken() {
    type Edit = fn(&mut Stored);
    let cases: [(&str, &str, Edit); 8] = [
        ("k 2000", "ok k 2000 N/m", |s| s.settings.wall.stiffness_n_per_m = 2000.0),
        ("b 5", "ok b 5 N s/m", |s| s.settings.wall.damping_n_s_per_m = 5.0),
        ("wall 0.05", "ok wall 0.05 m", |s| s.settings.wall.position_m = 0.05),
        ("cutoff 1200", "ok cutoff 1200 Hz", |s| {
            s.settings.velocity = s.settings.velocity.with_tuning(1200.0);
        }),
        ("tuning 1300", "ok cutoff 1300 Hz", |s| {
            s.settings.velocity = s.settings.velocity.with_tuning(1300.0);
        }),
        ("estimator first-order", "ok estimator first-order", |s| {
            s.settings.velocity = EstimatorName::FirstOrder.following(&s.settings.velocity);
        }),
        ("fullscale 5", "ok fullscale 5 N", |s| s.full_scale_n = 5.0),
        ("load", "ok load: defaults: nothing was saved yet", |s| *s = DEVICE.defaults()),
    ];
    for (line, reply, edit) in cases {
        let mut bench = Bench::new(OFF);
        bench.console.stored.change(|stored| stored.settings.wall.damping_n_s_per_m = 1.0);
        let before = bench.stored();
        let mut after = before;
        edit(&mut after);
        assert_ne!(after, before, "{line}");
        assert_eq!(bench.orders(line), DEVICE.order(&after).unwrap(), "{line}");
        assert_eq!(bench.stored(), before, "{line}");
        assert_eq!(
            bench.answer(Err(Refusal::Contact)),
            ["error: in contact: leave the wall first"]
        );
        assert_eq!(bench.stored(), before, "{line}");
        bench.orders(line);
        assert_eq!(bench.answer(Ok(())), [reply]);
        assert_eq!(bench.stored(), after, "{line}");
    }
}

/// A setting that only the next experiment uses is stored at once, if an experiment can run with it.
#[test]
fn settings_of_experiments_are_kept_at_once_or_refused() {
    type Edit = fn(&mut Stored);
    let cases: [(&str, &str, Edit); 12] = [
        ("push 2.5", "ok push 2.5 N", |s| s.push_n = 2.5),
        ("start 0.01", "ok start 0.01 m", |s| s.start_m = 0.01),
        ("settle 1", "ok settle 1 s", |s| s.settle_s = 1.0),
        ("window 1", "ok window 1 s", |s| s.window_s = 1.0),
        ("rms 2e-5", "ok rms 0.00002 m", |s| s.rms_limit_m = 2e-5),
        ("force_rms 0.2", "ok force_rms 0.2 N", |s| s.force_rms_limit_n = Some(0.2)),
        ("kstart 1000", "ok kstart 1000 N/m", |s| s.grid.stiffness_start_n_per_m = 1000.0),
        ("kstep 500", "ok kstep 500 N/m", |s| s.grid.stiffness_step_n_per_m = 500.0),
        ("kmax 5000", "ok kmax 5000 N/m", |s| s.grid.stiffness_max_n_per_m = 5000.0),
        ("bstart 5", "ok bstart 5 N s/m", |s| s.grid.damping_start_n_s_per_m = 5.0),
        ("bstep 20", "ok bstep 20 N s/m", |s| s.grid.damping_step_n_s_per_m = 20.0),
        ("bmax 100", "ok bmax 100 N s/m", |s| s.grid.damping_max_n_s_per_m = 100.0),
    ];
    for (line, reply, edit) in cases {
        let mut bench = Bench::new(OFF);
        let mut after = bench.stored();
        edit(&mut after);
        assert_eq!(bench.says(line), reply);
        assert_eq!(bench.stored(), after, "{line}");
        let name = line.split(' ').next().unwrap();
        let refused = bench.says(&format!("{name} -1e9"));
        assert!(refused.starts_with("error: ") && refused.contains("allowed"), "{refused}");
        assert_eq!(bench.stored(), after, "{line}");
    }
}

#[test]
fn an_estimator_is_tuned_by_what_it_has() {
    let mut bench = Bench::new(OFF);
    assert_eq!(bench.says("tuning2 1"), "error: this estimator has fewer parameters, see get");
    bench
        .console
        .stored
        .change(|stored| stored.settings.velocity = EstimatorName::Difference.defaults());
    for line in ["cutoff 1000", "tuning 1000"] {
        assert_eq!(bench.says(line), "error: this estimator has nothing to tune");
    }
    for &name in EstimatorName::ALL {
        let mut bench = Bench::new(OFF);
        let [first, further @ ..] = name.parameters();
        if name.missing(DEVICE.senses).is_some() {
            continue;
        }
        bench.console.stored.change(|stored| stored.settings.velocity = name.defaults());
        for (parameter, number) in further.into_iter().flatten().zip(2..) {
            let line = format!("tuning{number} {}", Decimal(parameter.default));
            let order = bench.orders(&line);
            assert_eq!(order, DEVICE.order(&bench.stored()).unwrap());
            let Parameter { name, default, unit } = parameter;
            let reply = format!("ok {name} {} {unit}", Decimal(default));
            assert_eq!(bench.answer(Ok(())), [reply]);
        }
        if let Some(parameter) = first.filter(|parameter| parameter.is_whole()) {
            let why = format!("error: {} is a whole number", parameter.name);
            assert_eq!(bench.says("tuning 16.4"), why);
        }
        if first.is_some_and(|parameter| !parameter.is_frequency()) {
            let why = "error: this estimator has no cutoff: set its tuning, see get";
            assert_eq!(bench.says("cutoff 1000"), why);
        }
    }
}

#[test]
#[cfg(feature = "estimators")]
fn an_estimator_of_many_parameters_is_saved_too() {
    for name in [EstimatorName::Biquad, EstimatorName::Biquad2, EstimatorName::FoawEnd] {
        let mut bench = Bench::new(OFF);
        bench.console.stored.change(|stored| stored.settings.velocity = name.defaults());
        assert_eq!(bench.orders("save"), Order::Request(Request::Stall(true)));
    }
}

#[test]
fn settings_that_cannot_be_are_refused_with_what_is_allowed() {
    let mut bench = Bench::new(OFF);
    assert_eq!(
        bench.says("k 1e9"),
        "error: stiffness_n_per_m is 1000000000, allowed 0 to 10000000"
    );
    assert!(bench.says("fullscale 50").starts_with("error: full_scale_n is 50, allowed "));
    assert!(bench.says("fullscale 1").starts_with("error: full_scale_n is 1, allowed "));
    // the loop accepts this setting, but no hit can run with it
    bench.console.stored.change(|stored| stored.push_n = 5.0);
    assert!(bench.says("fullscale 3").starts_with("error: push_n is 5, allowed "));
    if let Some(blind) = blind_estimator() {
        let refused = bench.says(&format!("estimator {}", blind.text()));
        assert!(refused.ends_with("which this board has not"), "{refused}");
    }
    let mut bench = Bench::new(ARMED);
    assert_eq!(bench.says("calibrate 31"), "error: calibrate is 31, allowed -30 to 30");
    bench.console.stored.change(|stored| stored.start_m = 0.07);
    assert!(bench.says("hit").starts_with("error: start_m is 0.07, allowed -0.04 to "));
}

#[test]
fn a_wall_outside_the_envelope_is_taken_only_without_force_or_unlocked() {
    let outside =
        "error: beyond the envelope: k at this b is allowed from 0 to 4000, or unlock envelope";
    assert_eq!(Bench::new(ARMED).says("k 4500"), outside);
    assert_eq!(Bench::new(Status { state: State::RampIn, ..OFF }).says("k 4500"), outside);
    for status in [OFF, FREE] {
        let mut bench = Bench::new(status);
        assert!(matches!(bench.orders("k 4500"), Order::LoopParameters(..)));
    }
    assert!(matches!(Bench::new(ARMED).orders("k 4000"), Order::LoopParameters(..)));
}

#[test]
fn signs_are_turned_and_kept_once_they_are() {
    for (line, motor_reversed, encoder_reversed) in [
        ("motor -", true, false),
        ("motor +", false, false),
        ("encoder -", false, true),
        ("encoder +", false, false),
    ] {
        let mut bench = Bench::new(OFF);
        let signs = crate::store::Signs { motor_reversed, encoder_reversed };
        assert_eq!(bench.orders(line), Order::Signs(signs));
        assert_eq!(bench.answer(Err(Refusal::On)), ["error: the force is on: disarm first"]);
        assert_eq!(bench.stored(), DEVICE.defaults());
        bench.orders(line);
        assert_eq!(bench.answer(Ok(())), [format!("ok {line}")]);
        assert_eq!(bench.stored(), Stored { signs, ..DEVICE.defaults() });
    }
}

#[test]
fn experiments_are_started_and_stopped() {
    let mut bench = Bench::new(ARMED);
    let hit = DEVICE.hit_sequence(&bench.stored(), false).unwrap();
    assert_eq!(bench.orders("hit"), Order::Hit(hit));
    assert_eq!(bench.answer(Ok(())), ["ok hit"]);
    let train = DEVICE.pulse_train(&bench.stored(), -1.2).unwrap();
    assert_eq!(bench.orders("pulses -1.2"), Order::Pulses(train));
    assert_eq!(bench.answer(Ok(())), ["ok pulses"]);
    // A wall with a force would act during the pulses.
    bench.console.stored.change(|stored| stored.settings.wall.stiffness_n_per_m = 2000.0);
    let said = "error: stiffness_n_per_m is 2000, allowed 0 to 0";
    assert_eq!(bench.says("pulses 1"), said);
    let calibration = DEVICE.calibration(&DEVICE.defaults(), -20.0).unwrap();
    assert_eq!(bench.orders("calibrate -20"), Order::Calibrate(calibration));
    assert_eq!(bench.answer(Ok(())), ["ok calibrate"]);
    for answer in [Ok(()), Err(Refusal::Busy)] {
        assert_eq!(bench.orders("stop"), Order::Stop);
        assert_eq!(bench.answer(answer), ["ok stop"]);
    }
}

#[test]
fn telemetry_is_switched_and_numbered() {
    let mut bench = Bench::new(OFF);
    let before = bench.console.port.frames.len();
    assert_eq!(bench.says("stream off"), "ok stream off");
    bench.report(Event::None);
    assert_eq!(bench.console.port.frames.len(), before);
    assert_eq!(bench.says("stream on"), "ok stream on");
    bench.report(Event::None);
    bench.report(Event::None);
    let [.., last, newest] = bench.console.port.frames.as_slice() else { panic!() };
    assert_eq!(bench.console.port.frames.len(), before + 2);
    assert_ne!(last, newest);
}

#[test]
fn saving_stalls_writes_and_goes_on() {
    for broken in [false, true] {
        let mut bench = Bench::new(OFF);
        bench.console.stored.change(|stored| stored.push_n = 1.0);
        bench.console.port.broken = broken;
        assert_eq!(bench.orders("save"), Order::Request(Request::Stall(true)));
        assert_eq!(bench.console.port.flash, None);
        bench.report(Event::Answer(Ok(())));
        let (lines, orders) = bench.take();
        assert_eq!(lines, [if broken { "error: save failed" } else { "ok save" }]);
        assert_eq!(orders, [Order::Request(Request::Stall(false))]);
        assert_eq!(bench.console.port.flash, (!broken).then_some(bench.stored()));
        assert!(bench.answer(Ok(())).is_empty());
        bench.orders("save");
        assert_eq!(bench.answer(Err(Refusal::Supply)), ["error: the supply is too low"]);
    }
}

/// A new output period needs two orders: first the settings that are counted in outputs, then the parameters. Nothing
/// is stored before both are accepted.
#[test]
fn another_period_sends_its_plan_first_and_is_refused_while_force_acts() {
    let on = "error: the force is on: disarm first";
    assert_eq!(Bench::new(ARMED).says("period 1"), on);
    assert_eq!(Bench::new(Status { state: State::RampIn, ..OFF }).says("period 1"), on);
    let mut bench = Bench::new(OFF);
    for samples in ["0", "3", "-1", "20", "1.5", "4e9", "1e22"] {
        let refused = bench.says(&format!("period {samples}"));
        assert!(
            refused.starts_with("error: period is ") && refused.ends_with(", allowed 1 2 5 10")
        );
    }
    for (period, from) in [(1, 10), (2, 1), (5, 2), (10, 5)] {
        let before = bench.stored();
        let after = Stored { period, ..before };
        assert_eq!(before.period, from);
        let line = format!("period {period}");
        let first = Order::Period(DEVICE.period(&after).unwrap());
        assert_eq!(bench.orders(&line), first);
        assert_eq!(bench.answer(Err(Refusal::On)), [on]);
        assert_eq!(bench.stored(), before);
        assert_eq!(bench.orders(&line), first);
        bench.report(Event::Answer(Ok(())));
        assert_eq!(bench.take(), (Vec::new(), std::vec![DEVICE.order(&after).unwrap()]));
        assert_eq!(bench.stored(), before);
        assert_eq!(bench.answer(Ok(())), [format!("ok period {period} samples")]);
        assert_eq!(bench.stored(), after);
        // the same value again is handled like any other change
        assert_eq!(bench.orders(&line), DEVICE.order(&after).unwrap());
        assert_eq!(bench.answer(Ok(())), [format!("ok period {period} samples")]);
        assert!(bench.says("get").ends_with(&format!(", period {period} samples")));
    }
}

#[test]
fn an_estimator_that_leaves_no_time_for_the_period_is_refused_either_way() {
    let slow = |name: &&EstimatorName| {
        let time = crate::period::leaves_time(**name, 1);
        time.is_err() && name.missing(DEVICE.senses).is_none()
    };
    let Some(name) = EstimatorName::ALL.iter().find(slow) else { return };
    let no_time = crate::period::leaves_time(*name, 1).unwrap_err();
    let mut bench = Bench::new(OFF);
    bench.console.stored.change(|stored| stored.period = 1);
    let refused = format!("error: {no_time}");
    assert_eq!(bench.says(&format!("estimator {}", name.text())), refused);
    bench.console.stored.change(|stored| stored.period = 2);
    bench.console.stored.change(|stored| stored.settings.velocity = name.defaults());
    assert_eq!(bench.says("period 1"), refused);
}

#[test]
fn loading_takes_signs_full_scale_and_period_only_without_force() {
    let mut saved = DEVICE.defaults();
    saved.settings.wall.stiffness_n_per_m = 1000.0;
    let mut bench = Bench::new(ARMED);
    bench.console.port.flash = Some(saved);
    assert_eq!(bench.orders("load"), DEVICE.order(&saved).unwrap());
    assert_eq!(bench.answer(Ok(())), ["ok load: newest settings"]);
    let turned = crate::store::Signs { motor_reversed: true, encoder_reversed: false };
    for other in [
        Stored { signs: turned, ..saved },
        Stored { full_scale_n: 5.0, ..saved },
        Stored { period: 1, ..saved },
    ] {
        let mut bench = Bench::new(ARMED);
        bench.console.port.flash = Some(other);
        assert_eq!(bench.says("load"), "error: the force is on: disarm first");
        bench.status = OFF;
        bench.report(Event::None);
        let mut order = bench.orders("load");
        if other.period != saved.period {
            assert_eq!(order, Order::Period(DEVICE.period(&other).unwrap()));
            bench.report(Event::Answer(Ok(())));
            order = bench.take().1[0];
        }
        assert_eq!(order, DEVICE.order(&other).unwrap());
        bench.report(Event::Answer(Ok(())));
        let (lines, orders) = bench.take();
        assert_eq!(lines, ["ok load: newest settings"]);
        let expected = if other.signs == turned { &[Order::Signs(turned)][..] } else { &[] };
        assert_eq!((orders.as_slice(), bench.stored()), (expected, other));
    }
}

/// The flipped bit may be in a setting that the command does not change. For example, with a flipped bit in B, `k`
/// would put the wrong B in force.
#[test]
fn with_a_flipped_bit_in_settings_or_device_every_order_is_a_fault() {
    for of_device in [false, true] {
        let mut bench = Bench::new(FREE);
        bench.console.flip(of_device);
        for line in ["push 2", "k 5000", "settle 3", "hit", "disarm", "stop"] {
            let (lines, orders) = bench.type_in(line);
            assert_eq!(orders, [Order::Request(Request::Trip(Fault::Memory))], "{line}");
            assert!(
                lines.len() == 1 && lines[0].starts_with("error: ") && lines[0].contains("memory"),
                "{line}: {lines:?}"
            );
            assert_eq!(bench.answer(Ok(())), Vec::<String>::new(), "{line}");
        }
        assert!(bench.says("status").starts_with("ok status"));
    }
    // If the bit flips between the order of `save` and its answer, nothing is written.
    let mut bench = Bench::new(OFF);
    bench.orders("save");
    bench.console.flip(false);
    assert!(bench.answer(Ok(())).iter().any(|line| line.starts_with("error: save")));
    assert_eq!(bench.console.port.flash, None);
}

/// A bit of the order flips before the settings are in force. Without the check, the reply would say 9000 although
/// another K is in force.
#[test]
fn what_is_in_force_otherwise_than_it_was_asked_for_is_a_fault() {
    let mut bench = Bench::new(FREE);
    for line in ["k 9000", "cutoff 700", "wall 0.01"] {
        bench.orders(line);
        let parameters = bench.console.port.in_force.as_mut().unwrap();
        parameters.wall.damping = crate::Gain::from_f64(0.25).unwrap();
        let before = bench.stored();
        bench.report(Event::Answer(Ok(())));
        let (lines, orders) = bench.take();
        assert!(lines.len() == 1 && lines[0].starts_with("error: "), "{line}: {lines:?}");
        assert!(lines[0].contains("memory"), "{line}: {lines:?}");
        assert_eq!(orders, [Order::Request(Request::Trip(Fault::Memory))], "{line}");
        assert_eq!(bench.stored(), before, "{line}");
        assert_eq!(bench.answer(Ok(())), Vec::<String>::new());
    }
}
