//! Tests the renderer without a board, with a real supervisor and a simulated handle.

use std::vec::Vec;

use super::*;
use crate::{
    WallSettings,
    device::tests::DEVICE,
    experiment::{
        AbortReason, Activity, CalibrationEnd, Experiment, HitSequence, Promise, Verdict,
        return_move::tests::Handle,
    },
    safety::{FaultSet, OutputCommand, SafetyPlan},
    store::Stored,
    units::{Force, Velocity},
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

mod orders;
mod period;
mod port;

/// Parameters, commands and directions that the task `sample` has received.
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
    renderer: Renderer<8>,
    sampling: Sampler,
    handle: Handle,
    /// Whether the handle is held, so that nothing moves it.
    held: bool,
    /// Position of the handle, in counts, that was made zero.
    zero: i32,
    stored: Stored,
    sensed: Sensed,
    guard: Guard,
    sample: u64,
    /// Whether there is no room for reports.
    full: bool,
    reports: Vec<Report>,
    last: OutputCommand,
}

impl Bench {
    /// A bench with the force off and the handle at rest. Its first settings are accepted.
    fn new() -> Self {
        Self::with(DEVICE.safety.build(&DEVICE.design).unwrap())
    }

    fn with(plan: SafetyPlan) -> Self {
        let mut stored = DEVICE.defaults();
        (stored.settle_s, stored.window_s) = (0.1, 0.1);
        let parameters = DEVICE.control(&stored).unwrap();
        let duty = DEVICE.hit_sequence(&stored, false).unwrap().approach.duty;
        let supervisor = Supervisor::new(plan, None);
        let history = BlackBox::new(1);
        let renderer = Renderer::new(supervisor, parameters, stored.signs, duty, history);
        let handle = Handle { spring: 0.0, ..Handle::at(0.0) };
        let mut bench = Self {
            renderer,
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

    fn armed() -> Self {
        Self::new().on()
    }

    fn on(self) -> Self {
        let mut bench = self;
        bench.met(Order::Request(Request::Zero));
        bench.met(Order::Request(Request::Arm));
        bench.run(400);
        assert_eq!(bench.status().state, State::Armed, "{:?}", bench.status());
        bench
    }

    fn status(&self) -> crate::safety::Status {
        self.renderer.supervisor.status()
    }

    fn position(&self) -> Position {
        Position::from_counts(self.handle.position().counts() - self.zero)
    }

    fn output(&mut self, order: Option<Order>) {
        let before = self.position();
        if !self.held {
            self.handle.go(self.last.force().unwrap_or_default());
        }
        let position = self.position();
        let motion = Motion { sample: self.sample, position, velocity: Velocity::ZERO };
        let up = SampleReport { motion, present: Default::default() };
        let sensed = Sensed { switched_on: self.last != OutputCommand::Off, ..self.sensed };
        let proposal = self.renderer.propose();
        let asked = (proposal, self.renderer.answer(up.motion, proposal));
        let rendered = self.renderer.grant(&up, &self.guard, asked, sensed);
        self.last = rendered.grant;
        // Nine samples on the way to the position, and the tenth, at which the output is due.
        let moved = position.wrapping_since(before);
        let positions: Vec<_> =
            (1..=10).map(|n| Position::from_counts(before.counts() + moved * n / 10)).collect();
        let record = self.renderer.follow(&rendered, position, positions.into_iter());
        if self.renderer.is_ready()
            && let Some(order) = order
        {
            self.renderer.meet(order, &mut self.sampling);
            if self.renderer.is_off() {
                self.last = OutputCommand::Off;
            }
        }
        if !self.full {
            let report = self.renderer.report(record);
            self.reports.push(report);
        }
        let zeros = self.renderer.command().zeros.number();
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

    /// Runs until an event. Returns the number of outputs, and the event.
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

    fn gains(&mut self, stiffness_n_per_m: f64, damping_n_s_per_m: f64) {
        let wall = self.stored.settings.wall;
        self.stored.settings.wall = WallSettings { stiffness_n_per_m, damping_n_s_per_m, ..wall };
        let design = DEVICE.design(&self.stored).unwrap();
        let parameters = self.stored.settings.build(&design).unwrap();
        self.met(Order::LoopParameters(parameters, Gains::Inside));
    }

    fn pulses(&self) -> Order {
        let mut stored = self.stored;
        stored.settings.wall.stiffness_n_per_m = 0.0;
        stored.settings.wall.damping_n_s_per_m = 0.0;
        Order::Pulses(DEVICE.pulse_train(&stored, 1.0).unwrap())
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
    // a push without a wall has no contact; the window of the hit is 0.2 s after the return
    let (outputs, event) = bench.event();
    assert!(matches!(event, Event::HitOver(Verdict::NoContact, _)), "{event:?}");
    assert!((200..2_000).contains(&outputs), "{outputs}");
    assert!(bench.handle.x > 5e-3, "{}", bench.handle.x);
    assert_eq!(bench.activity(), Activity::None);
    // The push of the experiment fades, and then there is none.
    bench.run(30);
    assert_eq!(bench.last.force(), Some(Force::ZERO));
}

#[test]
#[cfg_attr(miri, ignore = "four returns in closed loop")]
fn a_pulse_train_pushes_four_times_and_is_over() {
    let mut bench = Bench::armed();
    bench.met(bench.pulses());
    assert_eq!(bench.activity(), Activity::Pulses);
    let before = bench.reports.len();
    let (_, event) = bench.event();
    assert!(matches!(event, Event::PulsesOver(Ok(()))), "{event:?}");
    assert_eq!(bench.activity(), Activity::None);
    // The strong pulses differ from the return move, which has a smaller force.
    let Order::Pulses(plan) = bench.pulses() else { panic!() };
    for (push, outputs) in plan.pulses {
        let with = bench.reports[before..].iter().filter(|report| report.push == push).count();
        assert_eq!(with, outputs as usize, "{push:?}");
    }
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
        if let Experiment::Hit(hit) = bench.renderer.experiments.parts().experiment
            && hit.is_fresh()
        {
            fresh = Some(bench.sample);
        }
        if let Event::HitOver(_, window) = bench.reports.last().unwrap().event {
            // Of the output that began the hit only one sample counts. Of each further output all ten count.
            assert_eq!(window.samples(), 1_000);
            assert_eq!(bench.sample - fresh.unwrap(), 2_010);
            bench.output(None);
            let Event::HitCodes(codes) = bench.reports.last().unwrap().event else {
                panic!("none")
            };
            assert_eq!(codes.samples(), 100);
            return;
        }
    }
    panic!("it never ends");
}

#[test]
#[cfg_attr(miri, ignore = "arms in closed loop")]
fn experiments_need_the_full_force_and_end_when_it_goes() {
    for order in [Bench::new().hit(), Bench::calibrate(10.0), Bench::new().pulses()] {
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
            Event::HitAborted(AbortReason::Off)
                | Event::CalibrationOver(CalibrationEnd::Off)
                | Event::PulsesOver(Err(AbortReason::Off))
        );
        assert!(off, "{:?}", report.event);
        assert_eq!(*bench.renderer.experiments.parts().push, Force::ZERO);
    }
}

#[test]
#[cfg_attr(miri, ignore = "10 s in steps of 1 ms")]
fn a_hit_that_cannot_return_says_so() {
    let mut bench = Bench::armed();
    bench.stored.start_m = -0.02;
    bench.met(bench.hit());
    for n in 0..20_000 {
        // A hand holds the handle there and shakes it. Otherwise this would be a push without motion.
        bench.handle.v = if n / 20 % 2 == 0 { 0.1 } else { -0.1 };
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
    assert_eq!(bench.renderer.experiments.parts().push.bits(), (1 << 30) / 50);
    // a held handle is not reported as a stuck encoder; the force continues from its value
    bench.met(Bench::calibrate(20.0));
    bench.run(1);
    assert!(bench.renderer.experiments.parts().push.bits() > (1 << 30) / 50);
    bench.run(6_999);
    assert_eq!(bench.status().state, State::Armed);
    assert!(bench.renderer.experiments.parts().push.bits() > (1 << 30) / 8);
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
    assert_eq!(
        (bench.activity(), *bench.renderer.experiments.parts().push),
        (Activity::None, Force::ZERO)
    );
    bench.run(100); // it fades
    assert_eq!(bench.status().state, State::Armed);
    bench.stored.start_m += 0.01;
    bench.met(bench.hit()); // its return move pushes
    bench.run(600);
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
    bench.output(Some(Order::Stop)); // the hit ends by itself, and the stop is carried out
    let reports = bench.reports.len();
    // the answer waits for a report, and the next order waits for the answer
    assert!(!bench.renderer.is_ready());
    bench.output(Some(Order::Request(Request::Zero)));
    bench.run(5);
    assert_eq!(bench.reports.len(), reports);
    bench.full = false;
    bench.run(3);
    let told: Vec<_> = bench.reports[reports..].iter().map(|report| report.event).collect();
    let [Event::HitAborted(AbortReason::Off), Event::Answer(Ok(())), Event::None] = told[..] else {
        panic!("{told:?}");
    };
    assert!(bench.renderer.is_ready());
}

/// A flipped bit begins an experiment, or changes its kind. Then the kind, which is stored separately, differs from it.
#[test]
fn an_experiment_that_nobody_began_is_found_after_the_output() {
    let mut bench = Bench::new();
    let renderer = &mut bench.renderer;
    assert!(renderer.experiment_is_whole());
    *renderer.experiments.parts().activity = Activity::Hit;
    assert!(!renderer.experiment_is_whole());
}

#[test]
fn a_copy_that_differs_is_found_after_the_output() {
    let spoilers: [fn(&mut Renderer<8>); 3] = [
        |renderer| renderer.motor_reversed.spoil(true),
        |renderer| renderer.gains.spoil(Gains::Outside),
        |renderer| renderer.host.spoil(),
    ];
    for spoil in spoilers {
        let mut bench = Bench::new();
        let sampled = bench.renderer.parameters;
        spoil(&mut bench.renderer);
        assert!(!bench.renderer.is_whole(&sampled));
    }
}

/// Checks the plan of each experiment, and the motor's thermal limits.
#[test]
#[cfg_attr(miri, ignore = "arms in closed loop")]
fn a_plan_that_is_not_what_was_ordered_is_found() {
    let mut bench = Bench::armed();
    bench.gains(0.0, 0.0);
    for order in [bench.hit(), bench.pulses(), Bench::calibrate(5.0)] {
        bench.met(order);
        assert!(bench.renderer.experiment_is_whole());
        match bench.renderer.experiments.parts().experiment {
            Experiment::Hit(hit) => hit.spoil(),
            Experiment::Pulses(train) => train.spoil(),
            Experiment::Calibration(calibration) => calibration.spoil(),
            Experiment::None => panic!("none"),
        }
        assert!(!bench.renderer.experiment_is_whole());
        bench.met(Order::Stop);
        assert!(bench.renderer.experiment_is_whole());
    }
    let other = Stored { period: 5, ..DEVICE.defaults() };
    bench.renderer.experiments.parts().duty_plan.spoil(DEVICE.period(&other).unwrap().duty);
    assert!(!bench.renderer.experiment_is_whole());
    let mut bench = Bench::new();
    bench.renderer.experiments.parts().duty.spoil();
    assert!(!bench.renderer.experiment_is_whole());
}
