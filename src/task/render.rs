//! `render`: with every period-th sample, priority 14, pended by `sample`.

use core::sync::atomic::Ordering::Relaxed;

use heapless::spsc::{Consumer, Producer};
use zwidth::{
    LoopParameters,
    contract::{DebugHalts as _, FaultMemory as _, Supply as _},
    experiment::{
        AbortReason, Activity, Calibration, CalibrationEnd, Duty, DutyPlan, Event, Gains,
        HitSequence, Order, Report,
    },
    safety::{
        BlackBox, Guard, GuardCommand, Inputs, MemoryUpdate, OutputCommand, Refusal, Request,
        SampleReport, State, Supervisor,
    },
    store::Signs,
    telemetry::{Flags, Record},
    units::{Force, Position},
};

use super::{FLAGS, ORDERS, REPORTS, device::PERIOD, sample::Due};
use crate::board::{self, Drive, EmergencyStop, FaultMemory, Halts, Supply};
use crate::sync::{DoubleBufferWriter, SeqlockReader, position_ring::Follower};

/// Records of the black box: half a second at 1 kHz.
const HISTORY: usize = 500;

/// The hardware that this task owns.
pub struct Outputs {
    /// Force and enable.
    pub drive: Drive,
    /// Emergency stop.
    pub stop: EmergencyStop,
    /// Supply voltage.
    pub supply: Supply,
    /// Halts by a debugger.
    pub halts: Halts,
    /// Backup RAM.
    pub memory: FaultMemory,
}

/// Its ends of the queues.
pub struct Ends {
    /// From `sample`, one per output.
    pub due: SeqlockReader<Due>,
    /// From `sample`: what the guard found, when it has changed.
    pub guard: SeqlockReader<Guard>,
    /// To `sample`.
    pub control: DoubleBufferWriter<LoopParameters>,
    /// To `sample`, with every output.
    pub down: DoubleBufferWriter<GuardCommand>,
    /// From `link`.
    pub orders: Consumer<'static, Order, ORDERS>,
    /// To `link`.
    pub reports: Producer<'static, Report, REPORTS>,
}

/// The experiment that is going on.
#[expect(clippy::large_enum_variant, reason = "there is one, in its place, and no heap")]
enum Experiment {
    None,
    Hit(HitSequence),
    Calibration(Calibration),
}

/// The output task. It alone writes the force output.
pub struct Render {
    outputs: Outputs,
    ends: Ends,
    supervisor: Supervisor,
    /// What the guard found, as far as it has told, and with which sample.
    guard: Guard,
    guard_at: u32,
    /// [`Guard::zeros`] up to the sample that was answered.
    zeros: u32,
    /// The positions of all samples.
    positions: Follower,
    control: LoopParameters,
    gains: Gains,
    /// Counts up with every change of the settings.
    settings: u16,
    motor_reversed: bool,
    experiment: Experiment,
    /// What it pushes with at the next output.
    push: Force,
    duty: Duty,
    duty_plan: DutyPlan,
    history: BlackBox<HISTORY>,
    /// Next record of the black box to send, while it is read out.
    replay: Option<usize>,
    /// The amplifier was switched on with the last output.
    was_on: bool,
    /// What the next reports say; kept until there is room for it.
    answer: Event,
    news: Event,
}

impl Render {
    pub(super) fn new(
        outputs: Outputs,
        ends: Ends,
        supervisor: Supervisor,
        control: LoopParameters,
        signs: Signs,
        duty_plan: DutyPlan,
    ) -> Self {
        Self {
            outputs,
            ends,
            supervisor,
            guard: Guard::NOTHING,
            guard_at: 0,
            zeros: 0,
            positions: Follower::new(),
            control,
            gains: Gains::Outside,
            settings: 0,
            motor_reversed: signs.motor_reversed,
            experiment: Experiment::None,
            push: Force::ZERO,
            duty: Duty::default(),
            duty_plan,
            history: BlackBox::new(BlackBox::<HISTORY>::every(board::RATE_HZ, PERIOD)),
            replay: None,
            was_on: false,
            answer: Event::None,
            news: Event::None,
        }
    }

    /// The output for the newest due sample, then everything that can wait until it is out.
    ///
    /// Late by a period: `sample` switches off, and the fault `late render` is latched.
    #[inline(always)]
    pub fn run(&mut self) {
        let Some(due) = self.ends.due.read() else { return };
        if let Some((guard, number)) = self.ends.guard.read_numbered() {
            (self.guard, self.guard_at) = (guard, number);
        }
        let mut up = due.up(self.guard);
        if self.guard_at.wrapping_sub(up.motion.number()).cast_signed() > 0 {
            up.guard.zeros = self.zeros; // carried out after this sample, if at all
        }
        self.zeros = up.guard.zeros;
        let inputs = self.inputs(&up);
        let rendered = self.supervisor.render(&self.control, &up, self.push, inputs);
        self.put_out(rendered.grant);
        self.ends.down.publish(rendered.down);
        FLAGS.rendered.store(rendered.down.rendered, Relaxed);

        match rendered.memory {
            Some(MemoryUpdate::Write(record)) => self.outputs.memory.write(&record.to_words()),
            Some(MemoryUpdate::Erase) => self.outputs.memory.erase(),
            None => {}
        }
        let record = Record { settings: self.settings, ..rendered.record };
        self.history.push(record, record.flags.contains(Flags::FAULT));
        self.positions.follow_to(up.motion.sample);
        self.duty.add(&self.duty_plan, rendered.grant.force().unwrap_or_default());
        self.observe(rendered.grant);
        self.prepare(up.motion.position);
        if matches!(self.answer, Event::None)
            && let Some(order) = self.ends.orders.dequeue()
        {
            self.answer = Event::Answer(self.meet(order));
        }
        self.report(record);
        board::request_link();
    }

    /// What the board says at this output.
    fn inputs(&mut self, up: &SampleReport) -> Inputs {
        let cut = self.supervisor.is_cut(up);
        let halted = self.outputs.halts.since_the_last(up.motion.sample, PERIOD);
        // A stop that is over before the next look is one all the same. A halt may set the same flag.
        let stopped = self.was_on && !halted && self.outputs.drive.was_stopped();
        let stop_closed = self.outputs.stop.is_closed() && !stopped;
        let supply_good = !self.outputs.supply.is_low();
        Inputs {
            stop_closed,
            supply_good,
            settings_valid: self.gains == Gains::Inside || self.supervisor.status().unlocked,
            // Nobody else drops enable while force is on, but for the emergency stop, the supply detector and
            // `sample` (it cut), which have faults of their own.
            halted: self.was_on
                && (halted || (stop_closed && supply_good && !cut && !self.outputs.drive.is_on())),
        }
    }

    fn put_out(&mut self, grant: OutputCommand) {
        match grant {
            OutputCommand::Off => {
                board::off();
                self.was_on = false;
            }
            OutputCommand::On(granted) => {
                if !self.was_on {
                    self.outputs.drive.on();
                    self.was_on = true;
                }
                let command = granted.command();
                self.outputs.drive.write(command, self.motor_reversed);
            }
        }
    }

    /// What the experiment pushes with at the next output. Found out after this one, so that it costs no
    /// latency: a way back does not mind a millisecond, and a hit begins with the output of its push.
    fn prepare(&mut self, position: Position) {
        let contact = self.control.wall.penetration(position) > 0;
        let over = match &mut self.experiment {
            Experiment::None => return,
            Experiment::Hit(trial) => match trial.output(position, contact, &self.duty) {
                Ok(push) => {
                    self.push = push;
                    return;
                }
                Err(broken) => Event::HitAborted(broken),
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
        };
        self.end(over);
    }

    /// The experiment is over; what it pushed with fades.
    fn end(&mut self, news: Event) {
        self.stop();
        self.news = news;
    }

    /// No experiment any more, without a word.
    fn stop(&mut self) {
        self.experiment = Experiment::None;
        self.push = Force::ZERO;
        self.supervisor.expect_still(false);
    }

    /// Feeds the samples since the last output to the experiment.
    fn observe(&mut self, grant: OutputCommand) {
        let on = matches!(grant, OutputCommand::On(_));
        match self.experiment {
            Experiment::Hit(_) if !on => self.end(Event::HitAborted(AbortReason::Off)),
            Experiment::Calibration(_) if !on => {
                self.end(Event::CalibrationOver(CalibrationEnd::Off));
            }
            _ => {}
        }
        let Experiment::Hit(trial) = &mut self.experiment else {
            while self.positions.read().is_some() {}
            return;
        };
        let (mut verdict, mut newest, fresh) = (None, None, trial.is_fresh());
        while let Some(position) = self.positions.read() {
            newest = Some(position);
            if !fresh {
                let contact = self.control.wall.penetration(position) > 0;
                verdict = verdict.or(trial.sample(position, contact));
            }
        }
        if let Some(position) = newest.filter(|_| fresh) {
            let contact = self.control.wall.penetration(position) > 0;
            verdict = trial.sample(position, contact);
        }
        if let Some(verdict) = verdict.or_else(|| trial.early_verdict()) {
            let scatter = trial.scatter();
            self.end(Event::HitOver(verdict, scatter));
        }
    }

    #[inline(always)] // called, it would copy the order once more
    fn meet(&mut self, order: Order) -> Result<(), Refusal> {
        match order {
            Order::Request(request) => {
                let result = self.supervisor.request(request);
                // Now, not with the next output: flash may be written as soon as this is answered.
                self.ends.down.publish(self.supervisor.down());
                if result.is_ok() && matches!(request, Request::Clear) {
                    self.history.release();
                }
                result
            }
            Order::LoopParameters(control, gains) => {
                self.supervisor.may_change(&self.control, &control)?;
                self.ends.control.publish(control); // from the next sample on, whole
                if control.estimator != self.control.estimator {
                    self.supervisor.retuned();
                    self.ends.down.publish(self.supervisor.down());
                }
                self.control = control;
                self.gains = gains;
                self.settings = self.settings.wrapping_add(1);
                Ok(())
            }
            Order::Hit(_) | Order::Calibrate(_)
                if self.supervisor.status().state != State::Armed =>
            {
                Err(Refusal::NotArmed)
            }
            Order::Hit(plan) => {
                self.experiment = Experiment::Hit(HitSequence::new(plan));
                Ok(())
            }
            Order::Calibrate(plan) => {
                match &mut self.experiment {
                    Experiment::Calibration(calibration) => calibration.retarget(plan),
                    _ => self.experiment = Experiment::Calibration(Calibration::new(plan)),
                }
                self.supervisor.expect_still(true);
                Ok(())
            }
            Order::Signs(signs) => {
                self.supervisor.request(Request::Turn)?;
                self.motor_reversed = signs.motor_reversed;
                board::turn_encoder(signs.encoder_reversed);
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
        }
    }

    /// A queue that is full loses records, never outputs or events.
    fn report(&mut self, record: Record) {
        if !self.ends.reports.ready() {
            return;
        }
        let activity = match self.experiment {
            Experiment::None => Activity::None,
            Experiment::Hit(_) => Activity::Hit,
            Experiment::Calibration(_) => Activity::Calibration,
        };
        // The news first: they may be the end of what a `stop` is answered for.
        let event = match &mut self.news {
            Event::None => &mut self.answer,
            news => news,
        };
        let event = core::mem::replace(event, Event::None);
        let streamed = self.replayed().unwrap_or(record);
        let status = self.supervisor.status();
        let report = Report { record, streamed, status, activity, event };
        // There is room, and nobody else writes.
        let _ = self.ends.reports.enqueue(report);
    }

    /// The next record of the black box in place of the present one, while it is read out.
    fn replayed(&mut self) -> Option<Record> {
        let next = self.replay?;
        let record = self.history.get(next).copied();
        self.replay = record.is_some().then_some(next + 1);
        record.map(|record| Record { flags: record.flags.with_if(Flags::REPLAY, true), ..record })
    }
}
