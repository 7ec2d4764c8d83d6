//! The firmware's own sampling and output tasks on the host, with the counts that the board read.
//!
//! Each typed command becomes an order at an output. Telemetry shows the order by the number of the settings or by a
//! flag. So every frame must equal the host's record bit for bit, from the first frame on. This includes velocity, sign
//! test, ramp, return move, hit, fade and flags.

use zwidth::{
    CounterWidth, LoopParameters,
    device::{Device, HISTORY},
    experiment::Order,
    renderer::{Renderer, Sampling},
    safety::{
        BlackBox, FaultSet, Guard, GuardCommand, GuardView, GuardedSampler, OutputCommand, Sensed,
        Supervisor,
    },
    store::{Loaded, Source, Stored},
    telemetry::Record,
    units::Position,
    velocity::Senses,
};

/// Values that the sampling task receives from the output task.
#[derive(Clone)]
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

pub struct Twin {
    sampler: GuardedSampler,
    guard: Guard,
    view: GuardView,
    to_sample: ToSample,
    renderer: Renderer<HISTORY>,
    was_on: bool,
    positions: Vec<Position>,
}

impl Twin {
    /// A board that starts with these settings. Its counter is then at `first`.
    pub fn new(device: &Device<'_>, stored: Stored, first: u32) -> Self {
        let loaded = Loaded { stored, source: Source::Empty, damaged: 0 };
        let start = device.start(&loaded, None).unwrap();
        let history = BlackBox::new(start.period.keep);
        Self {
            sampler: GuardedSampler::new(first, CounterWidth::Bits32),
            guard: Guard::NOTHING,
            view: GuardView::NOTHING,
            to_sample: ToSample {
                parameters: start.control,
                down: GuardCommand::start(&start.safety),
            },
            renderer: Renderer::new(
                Supervisor::new(start.safety, None),
                start.control,
                stored.signs,
                start.period.duty,
                history,
            ),
            was_on: false,
            positions: Vec::new(),
        }
    }

    /// Runs one sample. If an output is due, runs the output, then carries out the waiting order. Returns the output's
    /// record.
    pub fn sample(
        &mut self,
        count: u32,
        order: impl FnOnce(&Record) -> Option<Order>,
    ) -> Option<Record> {
        let ToSample { parameters, down } = &self.to_sample;
        let step = self.sampler.step(parameters, count, &Senses::NONE, down, &mut self.guard);
        let motion = step.report.motion;
        if step.told {
            self.view.take(self.guard, motion.number());
        }
        if step.cut {
            self.was_on = false;
        }
        self.positions.push(motion.position);
        if !step.due {
            return None;
        }
        let sensed = Sensed {
            switched_on: self.was_on,
            halted: false,
            was_stopped: false,
            stop_closed: true,
            supply_good: true,
            enabled: self.was_on,
            found: FaultSet::EMPTY,
        };
        let guard = self.view.at(motion.number());
        let proposal = self.renderer.propose();
        let asked = (proposal, self.renderer.answer(motion, proposal));
        let rendered = self.renderer.grant(&step.report, &guard, asked, sensed);
        self.was_on = matches!(rendered.grant, OutputCommand::On(_));
        self.to_sample.command(self.renderer.command());
        let positions = std::mem::take(&mut self.positions);
        let record = self.renderer.follow(&rendered, motion.position, positions.into_iter());
        if self.renderer.is_ready()
            && let Some(order) = order(&record)
        {
            self.renderer.meet(order, &mut self.to_sample);
            self.was_on &= !self.renderer.is_off();
        }
        self.renderer.report(record);
        Some(record)
    }
}
