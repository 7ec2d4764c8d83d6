//! Renderer and sampling task with the force off. Settings are sent as orders, in the firmware's order.

use zwidth::{
    CounterWidth, LoopParameters,
    experiment::{DutyPlan, Gains, Order},
    renderer::{Renderer, Sampling},
    safety::{
        BlackBox, FaultSet, Guard, GuardCommand, GuardView, GuardedSampler, OutputCommand,
        SafetyPlan, SampleReport, Sensed, Supervisor,
    },
    store::Signs,
    units::Position,
    velocity::Senses,
};

#[derive(Clone, Debug)]
pub struct ToSample {
    pub control: LoopParameters,
    pub down: GuardCommand,
}

impl Sampling for ToSample {
    fn set_parameters(&mut self, parameters: LoopParameters) {
        self.control = parameters;
    }

    fn command(&mut self, command: GuardCommand) {
        self.down = command;
    }

    fn turn_encoder(&mut self, _: bool) {}
}

pub struct Orders {
    renderer: Renderer<4>,
    to_sample: ToSample,
    sampler: GuardedSampler,
    guard: Guard,
    view: GuardView,
}

impl Orders {
    pub fn new(plan: SafetyPlan, duty: DutyPlan, control: LoopParameters) -> Self {
        let supervisor = Supervisor::new(plan, None);
        let renderer = Renderer::new(supervisor, control, Signs::default(), duty, BlackBox::new(1));
        Self {
            renderer,
            to_sample: ToSample { control, down: GuardCommand::start(&plan) },
            sampler: GuardedSampler::new(0, CounterWidth::Bits32),
            guard: Guard::NOTHING,
            view: GuardView::NOTHING,
        }
    }

    /// Runs one sample and the output task. The task first computes the output, then carries out a waiting order.
    pub fn sample(
        &mut self,
        count: i64,
        senses: &Senses,
        order: &mut Option<LoopParameters>,
    ) -> SampleReport {
        let ToSample { control, down } = &self.to_sample;
        let step = self.sampler.step(control, count as u32, senses, down, &mut self.guard);
        let number = step.report.motion.number();
        if step.told {
            self.view.take(self.guard, number);
        }
        if step.due {
            let guard = self.view.at(number);
            let sensed = Sensed {
                switched_on: false,
                halted: false,
                was_stopped: false,
                stop_closed: true,
                supply_good: true,
                enabled: false,
                found: FaultSet::EMPTY,
            };
            let proposal = self.renderer.propose();
            let asked = (proposal, self.renderer.answer(step.report.motion, proposal));
            let rendered = self.renderer.grant(&step.report, &guard, asked, sensed);
            assert_eq!(rendered.grant, OutputCommand::Off);
            self.to_sample.command(self.renderer.command());
            let position: Position = step.report.motion.position;
            let record = self.renderer.follow(&rendered, position, std::iter::empty());
            if self.renderer.is_ready()
                && let Some(control) = order.take()
            {
                self.renderer
                    .meet(Order::LoopParameters(control, Gains::Inside), &mut self.to_sample);
            }
            self.renderer.report(record);
        }
        step.report
    }

    /// Parameters that the sampling task uses in the next sample.
    pub fn control(&self) -> &LoopParameters {
        &self.to_sample.control
    }
}
