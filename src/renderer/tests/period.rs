//! Tests a change of the output period, with the renderer and the task `sample` together.

use super::*;
use crate::{
    CounterWidth, Design,
    experiment::PeriodPlan,
    period::PERIODS,
    safety::{GuardView, GuardedSampler, SLEW},
    velocity::Senses,
};

struct ToSample {
    parameters: LoopParameters,
    down: GuardCommand,
}

impl Sampling for ToSample {
    fn set_parameters(&mut self, parameters: LoopParameters) {
        self.parameters = parameters;
    }

    fn command(&mut self, command: GuardCommand) {
        self.down = command;
    }

    fn turn_encoder(&mut self, _: bool) {}
}

/// Both tasks, and a handle of 0.4 kg that only the motor moves.
struct Tasks {
    renderer: Renderer<4>,
    sampler: GuardedSampler,
    guard: Guard,
    view: GuardView,
    to_sample: ToSample,
    orders: Vec<Order>,
    answers: Vec<Result<(), Refusal>>,
    force: Force,
    place: f64,
    speed: f64,
    /// The outputs so far. Each has the number of its sample and its force.
    outputs: Vec<(u64, i32)>,
    stuck: bool,
    /// Number of samples from the moment when `render` was stuck until the task `sample` cut the output.
    cut_after: Option<u32>,
    since: u32,
}

impl Tasks {
    fn new(stored: &Stored) -> Self {
        let PeriodPlan { duty, keep } = DEVICE.period(stored).unwrap();
        let design = Design { period: stored.period, ..DEVICE.design };
        let safety = DEVICE.safety.build(&design).unwrap();
        let parameters = DEVICE.control(stored).unwrap();
        let supervisor = Supervisor::new(safety, None);
        let history = BlackBox::new(keep);
        Self {
            renderer: Renderer::new(supervisor, parameters, stored.signs, duty, history),
            sampler: GuardedSampler::new(0, CounterWidth::Bits32),
            guard: Guard::NOTHING,
            view: GuardView::NOTHING,
            to_sample: ToSample { parameters, down: GuardCommand::start(&safety) },
            orders: Vec::new(),
            answers: Vec::new(),
            force: Force::ZERO,
            place: 0.0,
            speed: 0.0,
            outputs: Vec::new(),
            stuck: false,
            cut_after: None,
            since: 0,
        }
    }

    fn sample(&mut self) {
        self.speed += f64::from(self.force.bits()) / 2f64.powi(30) * 5.906 / 0.4 * 1e-4;
        self.place += self.speed * 1e-4;
        #[expect(clippy::cast_possible_truncation, reason = "a few metres")]
        let count = (self.place * 1e6).floor() as i32;
        let ToSample { parameters, down } = &self.to_sample;
        let counter = count.cast_unsigned();
        let step = self.sampler.step(parameters, counter, &Senses::NONE, down, &mut self.guard);
        let motion = step.report.motion;
        if step.told {
            self.view.take(self.guard, motion.number());
        }
        self.since += u32::from(self.stuck);
        if step.cut {
            assert!(self.since > 0, "{:?}", self.guard);
            self.cut_after.get_or_insert(self.since);
        }
        if !step.due || self.stuck {
            return;
        }
        let guard = self.view.at(motion.number());
        let on = self.force != Force::ZERO;
        let sensed = Sensed { switched_on: on, ..GOOD };
        let proposal = self.renderer.propose();
        let asked = (proposal, self.renderer.answer(step.report.motion, proposal));
        let rendered = self.renderer.grant(&step.report, &guard, asked, sensed);
        self.force = rendered.grant.force().unwrap_or_default();
        self.outputs.push((motion.sample, self.force.bits()));
        self.to_sample.command(self.renderer.command());
        let positions = core::iter::once(motion.position);
        let record = self.renderer.follow(&rendered, motion.position, positions);
        if self.renderer.is_ready() && !self.orders.is_empty() {
            let order = self.orders.remove(0);
            self.renderer.meet(order, &mut self.to_sample);
        }
        match self.renderer.report(record).event {
            Event::Answer(answer) => self.answers.push(answer),
            Event::None => {}
            other => panic!("{other:?}"),
        }
    }

    fn run(&mut self, samples: u32) {
        for _ in 0..samples {
            self.sample();
        }
    }

    /// Orders a period as the console does: first the plan of the period, then the parameters.
    fn set_period(&mut self, stored: &Stored) {
        self.orders.push(Order::Period(DEVICE.period(stored).unwrap()));
        self.orders.push(DEVICE.order(stored).unwrap());
    }

    fn status(&self) -> crate::safety::Status {
        self.renderer.supervisor.status()
    }
}

#[test]
fn a_change_of_period_is_no_late_output_and_sets_the_distance_of_the_outputs() {
    for from in PERIODS {
        for to in PERIODS {
            for wait in 0..from {
                let stored = Stored { period: from, ..DEVICE.defaults() };
                let mut tasks = Tasks::new(&stored);
                tasks.run(20 + wait);
                tasks.outputs.clear();
                tasks.set_period(&Stored { period: to, ..stored });
                tasks.run(100);
                assert_eq!(tasks.answers, [Ok(()), Ok(())]);
                assert_eq!(tasks.status().fault, None, "{from} {to}");
                let far = tasks.outputs.windows(2).map(|pair| pair[1].0 - pair[0].0);
                let far: Vec<_> = far.collect();
                let changed = far.iter().position(|&far| far == u64::from(to)).unwrap();
                assert!(changed <= 3, "{from} {to}: {far:?}");
                assert!(far[..changed].iter().all(|&far| far == u64::from(from)));
                assert!(far[changed..].iter().all(|&far| far == u64::from(to)));
            }
        }
    }
}

/// Sign test, ramp, and the rise and the fall of a push take the same time at every period. In a millisecond the force
/// changes by at most 5 %.
#[test]
#[cfg_attr(miri, ignore = "arms four times")]
fn arming_and_fading_take_their_time_at_every_period() {
    for period in PERIODS {
        let mut tasks = Tasks::new(&DEVICE.defaults());
        let stored = Stored { period, ..DEVICE.defaults() };
        tasks.set_period(&stored);
        tasks.orders.push(Order::Request(Request::Zero));
        tasks.run(100);
        tasks.outputs.clear();
        tasks.orders.push(Order::Request(Request::Arm));
        let state_after = |tasks: &mut Tasks, samples| {
            tasks.run(samples);
            tasks.status().state
        };
        assert_eq!(state_after(&mut tasks, 980), State::SignTest, "{period}");
        assert_eq!(state_after(&mut tasks, 50), State::RampIn, "{period}");
        assert_eq!(state_after(&mut tasks, 1_950), State::RampIn, "{period}");
        assert_eq!(state_after(&mut tasks, 50), State::Armed, "{period}");
        // with the force on the change is refused, and nothing changes
        tasks.answers.clear();
        tasks.set_period(&Stored { period: if period == 1 { 10 } else { 1 }, ..stored });
        tasks.run(30);
        assert_eq!(tasks.answers, [Err(Refusal::On), Err(Refusal::On)]);
        assert_eq!(tasks.renderer.parameters.period.get(), period);
        let hit = Stored { push_n: stored.full_scale_n, settle_s: 0.05, window_s: 0.05, ..stored };
        let hit = DEVICE.hit_sequence(&hit, false).unwrap();
        let push = hit.hit.push;
        let parts = tasks.renderer.experiments.parts();
        *parts.experiment = Experiment::Hit(HitSequence::at_its_push(hit));
        *parts.activity = Activity::Hit;
        tasks.run(180);
        assert_ne!(tasks.force, push);
        tasks.run(40); // the push comes with the output after the next
        assert_eq!(tasks.force, push, "{period}");
        tasks.orders.push(Order::Stop);
        tasks.run(240);
        assert_eq!((tasks.force, tasks.status().fault), (Force::ZERO, None), "{period}");
        let outputs = &tasks.outputs;
        let ms = 10 / period as usize;
        for pair in outputs.windows(ms + 1) {
            let ((_, first), (_, last)) = (pair[0], pair[ms]);
            assert!((last - first).abs() <= SLEW + 1, "{period}: {pair:?}");
        }
    }
}

/// If an output is missing, the force is switched off at most one period and one sample after the output was due. This
/// holds at every period. A task without an output for 10 ms counts as stuck.
#[test]
#[cfg_attr(miri, ignore = "arms eight times")]
fn a_late_output_is_cut_in_its_time_and_ten_milliseconds_are_stuck_at_every_period() {
    for period in PERIODS {
        for (samples, is_stuck) in [(90, false), (130, true)] {
            let stored = Stored { period, ..DEVICE.defaults() };
            let mut tasks = Tasks::new(&stored);
            tasks.orders.extend([DEVICE.order(&stored).unwrap(), Order::Request(Request::Zero)]);
            tasks.run(100);
            tasks.orders.push(Order::Request(Request::Arm));
            tasks.run(3_200);
            assert_eq!(tasks.status().state, State::Armed);
            let last = tasks.outputs.last().unwrap().0;
            while tasks.outputs.last().unwrap().0 == last {
                tasks.sample(); // up to an output, which is the last
            }
            tasks.stuck = true;
            tasks.run(samples);
            // The output is due after one period. After a second period it is found missing, and is cut with this
            // sample or the next one.
            let cut = tasks.cut_after.unwrap();
            assert!((2 * period..=2 * period + 1).contains(&cut), "{period}: {cut}");
            tasks.stuck = false;
            tasks.run(1); // this output is late; the cut stays until `render` has given the reason
            tasks.run(2 * period);
            let causes = tasks.status().causes;
            assert!(causes.contains(Fault::LateRender), "{period}: {causes:?}");
            assert_eq!(causes.contains(Fault::StuckRender), is_stuck, "{period}: {causes:?}");
        }
    }
}
