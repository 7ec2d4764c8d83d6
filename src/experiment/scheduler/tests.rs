//! The scheduler with a real supervisor, a handle, and nothing of a board.

use std::vec::Vec;

use super::*;
use crate::{
    Motion,
    device::tests::DEVICE,
    experiment::{Promise, Verdict, return_move::tests::Handle},
    safety::{Fault, FaultSet, Guard},
    store::Stored,
    units::Velocity,
};

const GOOD: Sensed = Sensed {
    switched_on: true,
    halted: false,
    was_stopped: false,
    stop_closed: true,
    supply_good: true,
    enabled: true,
    found: FaultSet::EMPTY,
};

mod period;

/// What reached the sampling task.
#[derive(Default)]
struct Sampler {
    parameters: Vec<LoopParameters>,
    commands: Vec<GuardCommand>,
    turned: Option<bool>,
}

impl Sampling for Sampler {
    fn set_parameters(&mut self, parameters: LoopParameters) {
        self.parameters.push(parameters);
    }

    fn command(&mut self, command: GuardCommand) {
        self.commands.push(command);
    }

    fn turn_encoder(&mut self, reversed: bool) {
        self.turned = Some(reversed);
    }
}

struct Bench {
    scheduler: Scheduler<8>,
    sampling: Sampler,
    handle: Handle,
    /// Nothing moves it.
    held: bool,
    /// Where the count was zeroed, counts.
    zero: i32,
    stored: Stored,
    sensed: Sensed,
    guard: Guard,
    sample: u64,
    /// There is no room for reports.
    full: bool,
    reports: Vec<Report>,
    last: OutputCommand,
}

impl Bench {
    /// Off, at rest, the first settings met.
    fn new() -> Self {
        let mut stored = DEVICE.defaults();
        (stored.settle_s, stored.window_s) = (0.1, 0.1);
        let plan = DEVICE.safety.build(&DEVICE.design).unwrap();
        let parameters = DEVICE.control(&stored).unwrap();
        let duty = DEVICE.hit_sequence(&stored, false).unwrap().duty;
        let supervisor = Supervisor::new(plan, None);
        let history = BlackBox::new(1);
        let scheduler = Scheduler::new(supervisor, parameters, stored.signs, duty, history);
        let handle = Handle { spring: 0.0, ..Handle::at(0.0) };
        let mut bench = Self {
            scheduler,
            sampling: Sampler::default(),
            handle,
            held: false,
            zero: 0,
            stored,
            sensed: GOOD,
            guard: Guard::NOTHING,
            sample: 0,
            full: false,
            reports: Vec::new(),
            last: OutputCommand::Off,
        };
        bench.met(DEVICE.order(&stored).unwrap());
        bench
    }

    /// Zeroed and armed.
    fn armed() -> Self {
        let mut bench = Self::new();
        bench.met(Order::Request(Request::Zero));
        bench.met(Order::Request(Request::Arm));
        bench.run(400);
        assert_eq!(bench.status().state, State::Armed, "{:?}", bench.status());
        bench
    }

    fn status(&self) -> crate::safety::Status {
        self.scheduler.supervisor.status()
    }

    fn position(&self) -> Position {
        Position::from_counts(self.handle.position().counts() - self.zero)
    }

    /// One output, with an order if there is one.
    fn output(&mut self, order: Option<Order>) {
        let before = self.position();
        if !self.held {
            self.handle.go(self.last.force().unwrap_or_default());
        }
        let position = self.position();
        let motion = Motion { sample: self.sample, position, velocity: Velocity::ZERO };
        let up = SampleReport { motion, present: Default::default() };
        let sensed = Sensed { switched_on: self.last != OutputCommand::Off, ..self.sensed };
        let rendered = self.scheduler.output(&up, &self.guard, sensed);
        self.last = rendered.grant;
        // nine samples on the way, and the due one
        let moved = position.wrapping_since(before);
        let positions: Vec<_> =
            (1..=10).map(|n| Position::from_counts(before.counts() + moved * n / 10)).collect();
        let record = self.scheduler.follow(&rendered, position, positions.into_iter());
        if self.scheduler.is_ready()
            && let Some(order) = order
        {
            self.scheduler.meet(order, &mut self.sampling);
            if self.scheduler.is_off() {
                self.last = OutputCommand::Off;
            }
        }
        if !self.full {
            let report = self.scheduler.report(record);
            self.reports.push(report);
        }
        let zeros = self.scheduler.command().zeros;
        if self.guard.zeros != zeros {
            self.guard.zeros = zeros;
            self.zero = self.handle.position().counts();
        }
        self.sample += 10;
    }

    fn run(&mut self, outputs: u32) {
        for _ in 0..outputs {
            self.output(None);
        }
    }

    /// Gives an order: the answer.
    fn order(&mut self, order: Order) -> Result<(), Refusal> {
        self.output(Some(order));
        match self.reports.last().unwrap().event {
            Event::Answer(answer) => answer,
            event => panic!("{event:?}"),
        }
    }

    #[track_caller]
    fn met(&mut self, order: Order) {
        assert_eq!(self.order(order), Ok(()), "{order:?}");
    }

    /// Runs until something happens: after how many outputs, and what.
    fn event(&mut self) -> (u32, Event) {
        for n in 0..100_000 {
            self.output(None);
            match self.reports.last().map(|report| report.event) {
                None | Some(Event::None) => {}
                Some(event) => return (n, event),
            }
        }
        panic!("nothing happens");
    }

    fn hit(&self) -> Order {
        Order::Hit(DEVICE.hit_sequence(&self.stored, false).unwrap())
    }

    fn activity(&self) -> Activity {
        self.reports.last().unwrap().activity
    }

    fn calibrate(percent: f64) -> Order {
        Order::Calibrate(DEVICE.calibration(&DEVICE.defaults(), percent).unwrap())
    }
}

#[test]
#[cfg_attr(miri, ignore = "a return and a hit in closed loop")]
fn a_hit_returns_pushes_and_is_judged() {
    let mut bench = Bench::armed();
    bench.stored.push_n = 1.0;
    bench.met(bench.hit());
    assert_eq!(bench.activity(), Activity::Hit);
    // a push without a wall: no contact; its window is 0.2 s after the return
    let (outputs, event) = bench.event();
    assert!(matches!(event, Event::HitOver(Verdict::NoContact, _)), "{event:?}");
    assert!((200..2_000).contains(&outputs), "{outputs}");
    assert!(bench.handle.x > 5e-3, "{}", bench.handle.x);
    assert_eq!(bench.activity(), Activity::None);
    // what it pushed with fades, and nothing pushes any more
    bench.run(30);
    assert_eq!(bench.last.force(), Some(Force::ZERO));
}

#[test]
#[cfg_attr(miri, ignore = "a return in closed loop")]
fn of_the_samples_up_to_its_first_output_only_the_last_is_the_hits() {
    let mut bench = Bench::armed();
    bench.handle.x = 1e-6 * f64::from(bench.zero);
    bench.handle.v = 0.0;
    bench.met(bench.hit());
    let mut fresh = None;
    for _ in 0..2_000 {
        bench.output(None);
        if let Experiment::Hit(hit) = &bench.scheduler.experiment
            && hit.is_fresh()
        {
            fresh = Some(bench.sample);
        }
        if let Event::HitOver(_, window) = bench.reports.last().unwrap().event {
            // one sample of the output that began it, then ten of each
            assert_eq!(window.samples(), 1_000);
            assert_eq!(bench.sample - fresh.unwrap(), 2_010);
            return;
        }
    }
    panic!("it never ends");
}

#[test]
#[cfg_attr(miri, ignore = "arms in closed loop")]
fn experiments_need_the_full_force_and_end_when_it_goes() {
    for order in [Bench::new().hit(), Bench::calibrate(10.0)] {
        assert_eq!(Bench::new().order(order), Err(Refusal::NotArmed));
        let mut bench = Bench::armed();
        bench.met(order);
        bench.run(20);
        bench.sensed.stop_closed = false;
        bench.output(None);
        let report = *bench.reports.last().unwrap();
        assert_eq!((report.status.state, report.activity), (State::Fault, Activity::None));
        let off = matches!(
            report.event,
            Event::HitAborted(AbortReason::Off) | Event::CalibrationOver(CalibrationEnd::Off)
        );
        assert!(off, "{:?}", report.event);
        assert_eq!(bench.scheduler.push, Force::ZERO);
    }
}

#[test]
#[cfg_attr(miri, ignore = "10 s in steps of 1 ms")]
fn a_hit_that_cannot_return_says_so() {
    let mut bench = Bench::armed();
    bench.stored.start_m = -0.02;
    bench.met(bench.hit());
    for _ in 0..20_000 {
        bench.handle.v = 0.0; // a hand holds it
        bench.output(None);
        if let Event::HitAborted(reason) = bench.reports.last().unwrap().event {
            assert_eq!(reason, AbortReason::NotBack);
            return;
        }
    }
    panic!("it never ends");
}

#[test]
#[cfg_attr(miri, ignore = "a minute in steps of 1 ms")]
fn a_calibration_holds_goes_on_with_another_force_and_ends_when_the_handle_moves() {
    let mut bench = Bench::armed();
    bench.held = true; // by a gauge
    bench.met(Bench::calibrate(2.0));
    assert_eq!(bench.activity(), Activity::Calibration);
    let (outputs, event) = bench.event();
    assert!(matches!(event, Event::CalibrationHolds) && (990..1_010).contains(&outputs));
    assert_eq!(bench.scheduler.push.bits(), (1 << 30) / 50);
    // a held handle is no stuck encoder
    bench.met(Bench::calibrate(20.0));
    bench.run(7_000);
    assert_eq!(bench.status().state, State::Armed);
    assert!(bench.scheduler.push.bits() > (1 << 30) / 8);
    for _ in 0..2 {
        bench.handle.x += 0.6e-3;
        bench.output(None);
    }
    let event = bench.reports.last().unwrap().event;
    assert!(matches!(event, Event::CalibrationOver(CalibrationEnd::Moved)), "{event:?}");
    assert_eq!(bench.activity(), Activity::None);
}

#[test]
#[cfg_attr(miri, ignore = "a calibration in closed loop")]
fn after_a_calibration_a_push_without_motion_counts_again() {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.met(Bench::calibrate(20.0));
    bench.run(6_000);
    bench.met(Order::Stop);
    assert_eq!((bench.activity(), bench.scheduler.push), (Activity::None, Force::ZERO));
    bench.run(100); // it fades
    assert_eq!(bench.status().state, State::Armed);
    bench.scheduler.push = Force::saturating_from_bits((1 << 30) / 5);
    bench.run(200);
    assert_eq!(bench.status().fault.unwrap().fault, Fault::PushWithoutMotion);
}

#[test]
#[cfg_attr(miri, ignore = "arms in closed loop")]
fn stop_ends_a_hit_without_a_verdict() {
    let mut bench = Bench::armed();
    bench.met(bench.hit());
    bench.run(10);
    bench.met(Order::Stop);
    assert_eq!(bench.activity(), Activity::None);
    bench.run(1_000);
    let events = bench.reports.iter().filter(|report| matches!(report.event, Event::HitOver(..)));
    assert_eq!(events.count(), 0);
}

#[test]
#[cfg_attr(miri, ignore = "a calibration in closed loop")]
fn an_end_is_told_before_the_answer_to_a_stop_and_nothing_is_lost_while_reports_are_full() {
    let mut bench = Bench::armed();
    bench.met(bench.hit());
    bench.full = true;
    bench.sensed.supply_good = false;
    bench.output(Some(Order::Stop)); // it ends by itself, and the stop is met
    let reports = bench.reports.len();
    // the answer is still to be told: the next order waits
    assert!(!bench.scheduler.is_ready());
    bench.output(Some(Order::Request(Request::Zero)));
    bench.run(5);
    assert_eq!(bench.reports.len(), reports);
    bench.full = false;
    bench.run(3);
    let told: Vec<_> = bench.reports[reports..].iter().map(|report| report.event).collect();
    let [Event::HitAborted(AbortReason::Off), Event::Answer(Ok(())), Event::None] = told[..] else {
        panic!("{told:?}");
    };
    assert!(bench.scheduler.is_ready());
}

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

/// Where the answer comes, the force is off: with a hit, without one, off already, and with a fault.
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
    // The promise is over with it, and one with the force off does nothing.
    bench.met(Order::Request(Request::Clear));
    bench.met(word);
    bench.run(300);
    assert_eq!(bench.status().state, State::Off);
    bench.met(Order::Request(Request::Arm));
    bench.run(600);
    assert_eq!(bench.status().state, State::Armed);
}

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
    let settings = bench.scheduler.settings;
    // another wall: no restart of the estimator
    let (known, commands) = (bench.sampling.parameters.len(), bench.sampling.commands.len());
    bench.stored.settings.wall.stiffness_n_per_m = 1000.0;
    bench.met(DEVICE.order(&bench.stored).unwrap());
    assert_eq!(bench.sampling.parameters[known..], [DEVICE.control(&bench.stored).unwrap()]);
    assert_eq!(bench.sampling.commands.len(), commands);
    bench.output(None);
    assert_eq!(bench.reports.last().unwrap().record.settings, settings + 1);
    // another cutoff: it starts anew
    bench.stored.settings.wall.stiffness_n_per_m = 0.0;
    bench.stored.settings.velocity = bench.stored.settings.velocity.with_tuning(1000.0);
    bench.met(DEVICE.order(&bench.stored).unwrap());
    let (before, now) = (bench.sampling.parameters[known], bench.sampling.parameters[known + 1]);
    assert_eq!(now, DEVICE.control(&bench.stored).unwrap().after(&before));
    assert_ne!(now.estimator, DEVICE.control(&bench.stored).unwrap().estimator);
    assert_eq!(bench.sampling.commands.len(), commands);
    // a wall where the handle is
    let kept = bench.scheduler.parameters;
    bench.stored.settings.wall.position_m = -0.03;
    let refused = bench.order(DEVICE.order(&bench.stored).unwrap());
    assert_eq!((refused, bench.scheduler.parameters), (Err(Refusal::Contact), kept));
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
    assert_eq!((bench.scheduler.motor_reversed(), bench.sampling.turned), (false, None));
    bench.met(Order::Request(Request::Disarm));
    bench.met(Order::Signs(signs));
    assert_eq!((bench.scheduler.motor_reversed(), bench.sampling.turned), (true, Some(true)));
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
    assert!(bench.scheduler.history.is_frozen());
    bench.sensed.stop_closed = true;
    bench.output(None);
    bench.met(Order::Request(Request::Clear));
    assert!(!bench.scheduler.history.is_frozen());
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
    assert!(!bench.scheduler.history.is_frozen(), "it records again");
}

#[test]
#[cfg_attr(miri, ignore = "a motor takes half a minute to warm")]
fn a_motor_that_has_worked_is_warm() {
    let mut bench = Bench::armed();
    bench.held = true;
    bench.met(Bench::calibrate(20.0));
    bench.run(9_000);
    assert!(bench.scheduler.duty.per_mille() > 0);
}

/// All facts that a board senses, against what each of them means.
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
        // while off, an old stop is none
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
        // enable has dropped, and nobody says why
        (Sensed { enabled: false, ..GOOD }, false, Inputs { halted: true, ..held }),
        (Sensed { enabled: false, ..GOOD }, true, held),
        (Sensed { enabled: false, switched_on: false, ..GOOD }, false, held),
        // the board has dropped it, and says why
        (Sensed { enabled: false, found, ..GOOD }, false, Inputs { found, ..held }),
    ] {
        assert_eq!(Inputs::of(sensed, cut, true), expected, "{sensed:?} {cut}");
    }
    assert!(!Inputs::of(GOOD, false, false).settings_valid);
}
