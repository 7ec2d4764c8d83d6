//! What goes on besides the wall, output by output: orders are met, the experiment gives its push for the next
//! output, the black box is filled and read out, and every output is reported.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use crate::{
    LoopParameters,
    experiment::{
        AbortReason, Activity, Calibration, CalibrationEnd, Duty, DutyPlan, Event, Gains,
        HitSequence, Host, Order, PeriodPlan, PulseTrain, Report,
    },
    safety::{
        BlackBox, Doubled, Fault, Guard, GuardCommand, Inputs, MemoryUpdate, OutputCommand,
        Refusal, Rendered, Request, SampleReport, Sensed, State, Supervisor,
    },
    store::Signs,
    telemetry::{Flags, Record},
    units::{Force, Position},
};

#[cfg(test)]
mod tests;

/// The sampling task, as an order reaches it.
pub trait Sampling {
    /// From the next sample on these count, whole.
    fn set_parameters(&mut self, parameters: LoopParameters);

    /// From the next sample on this counts.
    fn command(&mut self, command: GuardCommand);

    /// The direction of the count.
    fn turn_encoder(&mut self, reversed: bool);
}

/// The experiment that is going on.
enum Experiment {
    None,
    Hit(HitSequence),
    Calibration(Calibration),
    Pulses(PulseTrain),
}

impl Experiment {
    #[inline(always)]
    fn activity(&self) -> Activity {
        match self {
            Self::None => Activity::None,
            Self::Hit(_) => Activity::Hit,
            Self::Calibration(_) => Activity::Calibration,
            Self::Pulses(_) => Activity::Pulses,
        }
    }

    /// Whether what it pushes with is as it was given.
    #[inline(always)]
    fn is_whole(&self) -> bool {
        match self {
            Self::None => true,
            Self::Hit(hit) => hit.is_whole(),
            Self::Calibration(calibration) => calibration.is_whole(),
            Self::Pulses(train) => train.is_whole(),
        }
    }
}

/// The supervisor with what it is to do, and a black box of `N` records. Owned by the output task.
pub struct Renderer<const N: usize> {
    supervisor: Supervisor,
    parameters: LoopParameters,
    gains: Doubled<Gains>,
    /// Counts up with every change of the settings.
    settings: u16,
    motor_reversed: Doubled<bool>,
    experiment: Experiment,
    /// Which of them it is: a flipped bit begins none.
    activity: Activity,
    /// What it pushes with at the next output.
    push: Force,
    /// What it pushed with at the last one.
    pushed: Force,
    duty: Duty,
    duty_plan: Doubled<DutyPlan>,
    history: BlackBox<N>,
    /// Next record of the black box to send, while it is read out.
    replay: Option<usize>,
    /// It goes on recording once it has been read out.
    release: bool,
    host: Host,
    /// What the next reports say; kept until there is room for it.
    answer: Event,
    news: Event,
}

impl<const N: usize> Renderer<N> {
    /// Nothing going on.
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
            experiment: Experiment::None,
            activity: Activity::None,
            push: Force::ZERO,
            pushed: Force::ZERO,
            duty: Duty::default(),
            duty_plan: Doubled::new(duty_plan),
            history,
            replay: None,
            release: false,
            host: Host::default(),
            answer: Event::None,
            news: Event::None,
        }
    }

    /// The motor is mounted the other way round.
    #[inline(always)]
    pub fn motor_reversed(&self) -> bool {
        *self.motor_reversed
    }

    /// Whether what decides a force is as it was put here: it is kept twice, the parameters as those that the sampling
    /// task goes by. To be asked after each output.
    #[inline(always)]
    pub fn is_whole(&self, sampled: &LoopParameters) -> bool {
        let signs = self.motor_reversed.is_whole() && self.gains.is_whole();
        let begun = self.experiment.activity() == self.activity;
        let planned = self.experiment.is_whole() && self.duty_plan.is_whole();
        signs && begun && planned && *sampled == self.parameters && self.supervisor.is_whole()
    }

    /// The output that answers `up`, with what the guard found. Put it out, then call [`follow`](Self::follow).
    #[inline(always)]
    pub fn output(&mut self, up: &SampleReport, guard: &Guard, sensed: Sensed) -> Rendered {
        let valid = *self.gains == Gains::Inside || self.supervisor.status().unlocked;
        let inputs = Inputs::of(sensed, self.supervisor.is_cut(up, guard), valid);
        self.supervisor.render(&self.parameters, up, guard, self.push, inputs)
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

    /// Everything of an output that can wait until it is out. `positions` are those of the samples since the last
    /// one. Returns the output's record.
    #[inline(always)]
    pub fn follow(
        &mut self,
        rendered: &Rendered,
        position: Position,
        positions: impl Iterator<Item = Position>,
    ) -> Record {
        let record = Record { settings: self.settings, ..rendered.record };
        self.pushed = self.push;
        self.supervisor.book();
        self.history.push(record, record.flags.contains(Flags::FAULT));
        self.duty.add(&self.duty_plan, rendered.grant.force().unwrap_or_default());
        self.observe(rendered.grant, positions);
        self.prepare(position);
        let on = !self.is_off();
        if self.host.falls_silent(record.sample, self.parameters.period.get(), on) {
            cold_path();
            // Nothing refuses a fault: the next output is off.
            let _ = self.supervisor.request(Request::Trip(Fault::HostSilent));
        }
        record
    }

    /// What the experiment pushes with at the next output. Found out after this one, so that it costs no
    /// latency: a return move does not mind a millisecond, and a hit begins with the output of its push.
    fn prepare(&mut self, position: Position) {
        let contact = self.parameters.wall.penetration(position) > 0;
        let over = match &mut self.experiment {
            Experiment::None => {
                self.push = Force::ZERO; // whatever a bit has become
                return;
            }
            Experiment::Hit(hit) => match hit.output(position, contact, &self.duty) {
                Ok(push) => {
                    self.push = push;
                    return;
                }
                Err(reason) => Event::HitAborted(reason),
            },
            Experiment::Calibration(calibration) => match calibration.output(position, contact) {
                Ok(push) => {
                    self.push = push;
                    if calibration.is_complete_now() {
                        self.news = Event::CalibrationHolds;
                    }
                    return;
                }
                Err(end) => Event::CalibrationOver(end),
            },
            Experiment::Pulses(train) => match train.output(position, contact, &self.duty) {
                Ok(Some(push)) => {
                    self.push = push;
                    return;
                }
                Ok(None) => Event::PulsesOver(Ok(())),
                Err(reason) => Event::PulsesOver(Err(reason)),
            },
        };
        self.end(over);
    }

    /// The experiment is over; what it pushed with fades.
    fn end(&mut self, news: Event) {
        self.stop();
        self.news = news;
    }

    #[inline(always)] // called, it would copy the experiment once more
    fn set(&mut self, experiment: Experiment) {
        self.activity = experiment.activity();
        self.experiment = experiment;
    }

    /// No experiment any more, without a word.
    fn stop(&mut self) {
        self.set(Experiment::None);
        self.push = Force::ZERO;
        self.supervisor.expect_still(false);
    }

    /// Feeds the samples since the last output to the experiment.
    fn observe(&mut self, grant: OutputCommand, mut positions: impl Iterator<Item = Position>) {
        let on = matches!(grant, OutputCommand::On(_));
        match self.experiment {
            Experiment::Hit(_) if !on => self.end(Event::HitAborted(AbortReason::Off)),
            Experiment::Calibration(_) if !on => {
                self.end(Event::CalibrationOver(CalibrationEnd::Off));
            }
            Experiment::Pulses(_) if !on => self.end(Event::PulsesOver(Err(AbortReason::Off))),
            _ => {}
        }
        let Experiment::Hit(hit) = &mut self.experiment else {
            positions.for_each(drop);
            return;
        };
        let wall = &self.parameters.wall;
        let mut verdict = None;
        if hit.is_fresh() {
            self.supervisor.forget_given();
            // Of the samples up to the output that began it only the last one is the hit's.
            if let Some(position) = positions.last() {
                verdict = hit.sample(position, wall.penetration(position) > 0);
            }
        } else {
            for position in positions.by_ref() {
                verdict = verdict.or(hit.sample(position, wall.penetration(position) > 0));
            }
        }
        if let Some(verdict) = verdict.or_else(|| hit.early_verdict()) {
            let window = hit.scatter();
            self.end(Event::HitOver(verdict, window));
        }
    }

    /// Whether an order can be met: the answer to the last one is reported.
    #[inline(always)]
    pub fn is_ready(&self) -> bool {
        matches!(self.answer, Event::None)
    }

    /// No force may act any more. After an order, the output is then switched off before the order is answered: who
    /// reads that it is off may rely on it.
    #[inline(always)]
    pub fn is_off(&self) -> bool {
        !self.supervisor.status().state.is_on()
    }

    /// Meets an order, or refuses it; the next [`report`](Self::report) says which. See to [`is_off`](Self::is_off)
    /// before that.
    #[inline(always)] // called, it would copy the order once more
    pub fn meet(&mut self, order: Order, sampling: &mut impl Sampling) {
        self.answer = Event::Answer(self.met(order, sampling));
    }

    /// Answers an order that has come otherwise than it was given: it is not met.
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
                    // What is being read out is read out to its end.
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
                self.duty_plan.set(duty);
                self.history.keep(keep);
                Ok(())
            }
            Order::Hit(_) | Order::Calibrate(_) | Order::Pulses(_)
                if self.supervisor.status().state != State::Armed =>
            {
                Err(Refusal::NotArmed)
            }
            Order::Hit(_) | Order::Pulses(_) if !matches!(self.experiment, Experiment::None) => {
                Err(Refusal::Busy)
            }
            Order::Calibrate(_)
                if !matches!(self.experiment, Experiment::None | Experiment::Calibration(_)) =>
            {
                Err(Refusal::Busy)
            }
            // What the console takes for the wall is not what acts.
            Order::Pulses(_) if self.parameters.wall.acts() => Err(Refusal::Settings),
            Order::Hit(plan) => {
                self.set(Experiment::Hit(HitSequence::new(plan)));
                Ok(())
            }
            Order::Pulses(plan) => {
                self.set(Experiment::Pulses(PulseTrain::new(plan)));
                Ok(())
            }
            Order::Calibrate(plan) => {
                match &mut self.experiment {
                    Experiment::Calibration(calibration) => calibration.retarget(plan),
                    _ => self.set(Experiment::Calibration(Calibration::new(plan))),
                }
                self.supervisor.expect_still(true);
                Ok(())
            }
            Order::Signs(signs) => {
                self.supervisor.request(Request::Turn)?;
                self.motor_reversed.set(signs.motor_reversed);
                sampling.turn_encoder(signs.encoder_reversed);
                Ok(())
            }
            Order::Stop => {
                self.stop(); // what has just ended by itself is told all the same
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

    /// What to tell of the output with that record, and of what happened since the last report. To be called only
    /// if there is room for it: what is full loses records, never events.
    #[inline(always)]
    pub fn report(&mut self, record: Record) -> Report {
        let activity = self.activity;
        // The news first: they may be the end of what a `stop` is answered for.
        let event = match &mut self.news {
            Event::None => &mut self.answer,
            news => news,
        };
        let event = core::mem::replace(event, Event::None);
        let streamed = self.replayed().unwrap_or(record);
        let (push, port) = (self.pushed, self.supervisor.exchanged());
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
