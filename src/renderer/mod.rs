//! One output after another, without the hardware. The experiment [proposes](Renderer::propose) a push, the wall
//! [answers](Renderer::answer), safety [grants](Renderer::grant). Then orders are met, the black box is filled and read
//! out, and the output is reported.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use crate::{
    Drive, LoopParameters, Motion,
    experiment::{DutyPlan, Event, Experiments, Gains, Host, Order, PeriodPlan, Report},
    safety::{
        BlackBox, Doubled, Fault, Guard, GuardCommand, Inputs, MemoryUpdate, Proposal, Refusal,
        Rendered, Request, SampleReport, Sensed, State, Supervisor,
    },
    store::Signs,
    telemetry::{Flags, Record},
    units::Position,
};

#[cfg(test)]
mod tests;

/// The sampling task, as orders use it.
pub trait Sampling {
    /// From the next sample on these count, whole.
    fn set_parameters(&mut self, parameters: LoopParameters);

    /// From the next sample on this command counts.
    fn command(&mut self, command: GuardCommand);

    /// Sets the direction of the count.
    fn turn_encoder(&mut self, reversed: bool);
}

/// Experiment, wall and supervisor, and a black box of `N` records. Owned by the output task.
#[derive(Clone)]
pub struct Renderer<const N: usize> {
    supervisor: Supervisor,
    parameters: LoopParameters,
    gains: Doubled<Gains>,
    /// Counts up with every change of the settings.
    settings: u16,
    motor_reversed: Doubled<bool>,
    experiments: Experiments,
    history: BlackBox<N>,
    /// Next record of the black box to send, while it is read out.
    replay: Option<usize>,
    /// The black box goes on recording once it has been read out.
    release: bool,
    host: Host,
    /// Answer to the last order; kept until a report has room for it.
    answer: Event,
}

impl<const N: usize> Renderer<N> {
    /// A renderer with nothing going on.
    pub fn new(
        supervisor: Supervisor,
        parameters: LoopParameters,
        signs: Signs,
        duty_plan: DutyPlan,
        history: BlackBox<N>,
    ) -> Self {
        Self {
            supervisor,
            parameters,
            gains: Doubled::new(Gains::Outside),
            settings: 0,
            motor_reversed: Doubled::new(signs.motor_reversed),
            experiments: Experiments::new(duty_plan),
            history,
            replay: None,
            release: false,
            host: Host::default(),
            answer: Event::None,
        }
    }

    /// The motor is mounted the other way round.
    #[inline(always)]
    pub fn motor_reversed(&self) -> bool {
        *self.motor_reversed
    }

    /// Whether plans, parameters and orders that decide a force are as they were put here. They are kept twice; the second
    /// copy of the parameters is that of the sampling task. Ask this after each output.
    #[inline(always)]
    pub fn is_whole(&self, sampled: &LoopParameters) -> bool {
        let signs = self.motor_reversed.is_whole() && self.gains.is_whole();
        let asked = self.experiments.is_whole() && *sampled == self.parameters;
        signs && asked && self.host.is_whole() && self.supervisor.is_whole()
    }

    /// What the experiment asks for at this output.
    #[inline(always)]
    pub fn propose(&self) -> Proposal {
        self.experiments.proposal()
    }

    /// The wall's answer to this motion and this proposal.
    #[inline(always)]
    pub fn answer(&self, motion: Motion, proposal: Proposal) -> Drive {
        self.parameters.render(motion, proposal.push)
    }

    /// How much of it safety grants, with the findings of the guard and the board. Put it out, then call
    /// [`follow`](Self::follow).
    #[inline(always)]
    pub fn grant(
        &mut self,
        up: &SampleReport,
        guard: &Guard,
        asked: (Proposal, Drive),
        sensed: Sensed,
    ) -> Rendered {
        let valid = *self.gains == Gains::Inside || self.supervisor.status().unlocked;
        let inputs = Inputs::of(sensed, self.supervisor.is_cut(up, guard), valid);
        self.supervisor.grant(&self.parameters, up, guard, asked, inputs)
    }

    /// For the sampling task, once the output is out.
    #[inline(always)]
    pub fn command(&self) -> GuardCommand {
        self.supervisor.down()
    }

    /// For the backup RAM, once the output is out.
    #[inline(always)]
    pub fn take_memory_update(&mut self) -> Option<MemoryUpdate> {
        self.supervisor.take_memory_update()
    }

    /// Everything of an output that can wait until the force is out. `positions` are those of the samples since the
    /// last output. Returns the output's record.
    #[inline(always)]
    pub fn follow(
        &mut self,
        rendered: &Rendered,
        position: Position,
        positions: impl Iterator<Item = Position>,
    ) -> Record {
        let record = Record { settings: self.settings, ..rendered.record };
        self.supervisor.book();
        self.history.push(record, record.flags.contains(Flags::FAULT));
        if self.experiments.begins_hit() {
            self.supervisor.forget_given();
        }
        self.experiments.follow(&self.parameters.wall, rendered.grant, position, positions);
        let on = !self.is_off();
        if self.host.falls_silent(record.sample, self.parameters.period.get(), on) {
            cold_path();
            // A fault is never refused: the next output is off.
            let _ = self.supervisor.request(Request::Trip(Fault::HostSilent));
        }
        record
    }

    /// Whether an order can be met: the answer to the last one is reported.
    #[inline(always)]
    pub fn is_ready(&self) -> bool {
        matches!(self.answer, Event::None)
    }

    /// No force may act any more. If so after an order, switch the output off before the order is answered: a reader of
    /// the answer may rely on it.
    #[inline(always)]
    pub fn is_off(&self) -> bool {
        !self.supervisor.status().state.is_on()
    }

    /// Meets an order, or refuses it; the next [`report`](Self::report) has the answer. Check [`is_off`](Self::is_off)
    /// before that.
    #[inline(always)] // called, it would copy the order once more
    pub fn meet(&mut self, order: Order, sampling: &mut impl Sampling) {
        self.answer = Event::Answer(self.met(order, sampling));
    }

    /// Refuses an order that differs from the one that was given.
    #[cold]
    pub fn refuse(&mut self) {
        self.answer = Event::Answer(Err(Refusal::Faulted(Fault::Memory)));
    }

    #[inline(always)]
    fn met(&mut self, order: Order, sampling: &mut impl Sampling) -> Result<(), Refusal> {
        match order {
            Order::Request(request) => {
                let result = self.supervisor.request(request);
                // Now, not with the next output: flash may be written as soon as this is answered.
                sampling.command(self.supervisor.down());
                if result.is_ok() && matches!(request, Request::Clear) {
                    // A read-out that has begun goes on to its end.
                    self.release = self.replay.is_some();
                    if !self.release {
                        self.history.release();
                    }
                }
                result
            }
            Order::LoopParameters(parameters, gains) => {
                let parameters = parameters.after(&self.parameters);
                self.supervisor.may_change(&self.parameters, &parameters)?;
                let (old, new) = (self.parameters.period, parameters.period);
                if old != new {
                    cold_path();
                    self.supervisor.set_period(old, new);
                    sampling.command(self.supervisor.down());
                }
                sampling.set_parameters(parameters);
                self.parameters = parameters;
                self.gains.set(gains);
                self.settings = self.settings.wrapping_add(1);
                Ok(())
            }
            Order::Period(_) if !self.is_off() => Err(Refusal::On),
            Order::Period(PeriodPlan { duty, keep }) => {
                cold_path();
                self.experiments.set_duty(duty);
                self.history.keep(keep);
                Ok(())
            }
            Order::Hit(_) | Order::Calibrate(_) | Order::Pulses(_)
                if self.supervisor.status().state != State::Armed =>
            {
                Err(Refusal::NotArmed)
            }
            Order::Hit(plan) => self.experiments.hit(plan),
            Order::Pulses(plan) => self.experiments.pulses(plan, &self.parameters.wall),
            Order::Calibrate(plan) => self.experiments.calibrate(plan),
            Order::Signs(signs) => {
                self.supervisor.request(Request::Turn)?;
                self.motor_reversed.set(signs.motor_reversed);
                sampling.turn_encoder(signs.encoder_reversed);
                Ok(())
            }
            Order::Stop => {
                self.experiments.stop(); // what has just ended by itself is told all the same
                Ok(())
            }
            Order::Replay => {
                self.replay = Some(0);
                Ok(())
            }
            Order::Alive(promise) => {
                self.host.hear(promise);
                Ok(())
            }
        }
    }

    /// The report of the output with this record, and of what happened since the last report. Call it only if there is
    /// room for it, so that records may be lost, but never events.
    #[inline(always)]
    pub fn report(&mut self, record: Record) -> Report {
        let activity = self.experiments.activity();
        // Events of experiments first: one may be the end that a `stop` is answered for.
        let event = match self.experiments.news() {
            Event::None => &mut self.answer,
            news => news,
        };
        let event = core::mem::replace(event, Event::None);
        let streamed = self.replayed().unwrap_or(record);
        let (push, port) = (self.experiments.pushed(), self.supervisor.exchanged());
        let status = self.supervisor.status();
        Report { record, streamed, push, port, status, activity, event }
    }

    /// The next record of the black box in place of the present one, while it is read out.
    fn replayed(&mut self) -> Option<Record> {
        let next = self.replay?;
        let record = self.history.get(next).copied();
        self.replay = record.is_some().then_some(next + 1);
        if record.is_none() && core::mem::take(&mut self.release) {
            self.history.release();
        }
        record.map(|record| Record { flags: record.flags.with_if(Flags::REPLAY, true), ..record })
    }
}
