//! Computes one output after another, without the hardware. The experiment [proposes](Renderer::propose) a push. The
//! wall [answers](Renderer::answer) with its force. Safety [grants](Renderer::grant) a force. Then an order is carried
//! out, the black box is filled or sent, and the output is reported.

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

/// What the renderer can change in the task `sample` when it carries out an order.
pub trait Sampling {
    /// The task uses the parameters as a whole from the next sample on.
    fn set_parameters(&mut self, parameters: LoopParameters);

    /// The task uses the command from the next sample on.
    fn command(&mut self, command: GuardCommand);

    /// Sets the direction of the count.
    fn turn_encoder(&mut self, reversed: bool);
}

/// Experiment, wall and supervisor, and a black box of `N` records. The task `render` owns the renderer.
#[derive(Clone)]
pub struct Renderer<const N: usize> {
    supervisor: Supervisor,
    parameters: LoopParameters,
    gains: Doubled<Gains>,
    /// Number of times that the settings have changed. It wraps.
    settings: u16,
    motor_reversed: Doubled<bool>,
    experiments: Experiments,
    history: BlackBox<N>,
    /// Index of the next record to send. It is `None` while the records of the black box are not sent.
    replay: Option<usize>,
    /// Whether the black box must record again after all its records were sent.
    release: bool,
    host: Host,
    /// Answer to the last order. It waits until a report has room for it.
    answer: Event,
}

impl<const N: usize> Renderer<N> {
    /// A renderer without an experiment.
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

    /// Whether the motor is mounted the other way round.
    #[inline(always)]
    pub fn motor_reversed(&self) -> bool {
        *self.motor_reversed
    }

    /// Whether the numbers of loop and supervisor are unchanged. They are stored twice. The second copy of the
    /// parameters is `sampled`, from the task `sample`. Call it after an output.
    #[inline(always)]
    pub fn is_whole(&self, sampled: &LoopParameters) -> bool {
        let signs = self.motor_reversed.is_whole() && self.gains.is_whole();
        let asked = *sampled == self.parameters && self.host.is_whole();
        signs && asked && self.supervisor.is_whole()
    }

    /// Whether the numbers of experiment and motor's heat are unchanged. Call it after an output.
    #[inline(always)]
    pub fn experiment_is_whole(&self) -> bool {
        self.experiments.is_whole()
    }

    /// The push that the experiment proposes for this output.
    #[inline(always)]
    pub fn propose(&self) -> Proposal {
        self.experiments.proposal()
    }

    /// Computes the output for this motion and this proposal. Its force is the push minus the wall's force.
    #[inline(always)]
    pub fn answer(&self, motion: Motion, proposal: Proposal) -> Drive {
        self.parameters.render(motion, proposal.push)
    }

    /// Returns the force that safety grants, after it has judged what guard and board have found. Write this force to
    /// the output, then call [`follow`](Self::follow).
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

    /// Command for the task `sample`. Call it when the output is written.
    #[inline(always)]
    pub fn command(&self) -> GuardCommand {
        self.supervisor.down()
    }

    /// Returns what must be written to the backup RAM, if anything. Call it when the output is written.
    #[inline(always)]
    pub fn take_memory_update(&mut self) -> Option<MemoryUpdate> {
        self.supervisor.take_memory_update()
    }

    /// Does the part of an output that can wait until the force is written. `positions` are the positions of the
    /// samples since the last output. Returns the output's record.
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
            // A request for a fault is never refused, so its result is not needed. The next output is off.
            let _ = self.supervisor.request(Request::Trip(Fault::HostSilent));
        }
        record
    }

    /// Whether an order can be carried out, because the answer to the last order was reported.
    #[inline(always)]
    pub fn is_ready(&self) -> bool {
        matches!(self.answer, Event::None)
    }

    /// Whether no force may act any more. If this is true after an order, switch the output off before the order is
    /// answered, because the reader of the answer may rely on it.
    #[inline(always)]
    pub fn is_off(&self) -> bool {
        !self.supervisor.status().state.is_on()
    }

    /// Carries out an order, or refuses it. The next [`report`](Self::report) has the answer. Check
    /// [`is_off`](Self::is_off) before the report.
    #[inline(always)] // a call would copy the order once more
    pub fn meet(&mut self, order: Order, sampling: &mut impl Sampling) {
        self.answer = Event::Answer(self.met(order, sampling));
    }

    /// Refuses an order that has changed on its way.
    #[cold]
    pub fn refuse(&mut self) {
        self.answer = Event::Answer(Err(Refusal::Faulted(Fault::Memory)));
    }

    #[inline(always)]
    fn met(&mut self, order: Order, sampling: &mut impl Sampling) -> Result<(), Refusal> {
        match order {
            Order::Request(request) => {
                let result = self.supervisor.request(request);
                // The command is set now, not with the next output, because flash may be written as soon as this order
                // is answered.
                sampling.command(self.supervisor.down());
                if result.is_ok() && matches!(request, Request::Clear) {
                    // If records are being sent, all of them are sent first.
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
                self.experiments.stop(); // an experiment that has just ended by itself is still reported
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

    /// Makes the report about the output with this record, and about one event since the last report. Call this
    /// function only if there is room for the report. Without room a record is lost, but its event waits.
    #[inline(always)]
    pub fn report(&mut self, record: Record) -> Report {
        let activity = self.experiments.activity();
        // Events of experiments come before the answer to an order. Such an event may be the end of an experiment that
        // the order `stop` has caused.
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

    /// Returns the next record of the black box, while its records are sent.
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
