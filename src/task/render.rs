//! `render`: with every period-th sample, priority 14, pended by `sample`.

use core::sync::atomic::Ordering::Relaxed;

use zwidth::{
    Control, Motion,
    experiment::Hit,
    link::Activity,
    safety::{
        BlackBox, Down, Grant, Guard, Inputs, MemoryUpdate, Refusal, Request, Supervisor, Up,
    },
    store::Signs,
    telemetry::{Flags, Record},
    units::Force,
};

use super::{
    FLAGS, ORDERS, REPORTS,
    device::PERIOD,
    order::{Event, Gains, Order, Report},
    trail::Follower,
};
use crate::board::{
    self, Drive, EmergencyStop, FaultMemory, Publisher, Reader, Reading, Supply, Writer,
};

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
    /// Backup RAM.
    pub memory: FaultMemory,
}

/// Its ends of the queues.
pub struct Ends {
    /// From `sample`, one per output: the motion, and whether it has switched off.
    pub due: Reading<(Motion, bool)>,
    /// From `sample`: what the guard found, when it has changed.
    pub guard: Reading<Guard>,
    /// To `sample`.
    pub control: Publisher<Control>,
    /// To `sample`, with every output.
    pub down: Publisher<Down>,
    /// From `link`.
    pub orders: Reader<Order, ORDERS>,
    /// To `link`.
    pub reports: Writer<Report, REPORTS>,
}

/// The output task. It alone writes the force output.
pub struct Render {
    outputs: Outputs,
    ends: Ends,
    supervisor: Supervisor,
    /// What the guard found, as far as it has told.
    guard: Guard,
    /// The positions of all samples.
    positions: Follower,
    control: Control,
    gains: Gains,
    /// Counts up with every change of the settings.
    settings: u16,
    motor_reversed: bool,
    hit: Option<Hit>,
    history: BlackBox<HISTORY>,
    /// Next record of the black box to send, while it is read out.
    replay: Option<usize>,
    /// The amplifier was switched on with the last output.
    was_on: bool,
    /// What the next report says; kept until there is room for it.
    event: Event,
}

impl Render {
    pub(super) fn new(
        outputs: Outputs,
        ends: Ends,
        supervisor: Supervisor,
        control: Control,
        signs: Signs,
    ) -> Self {
        Self {
            outputs,
            ends,
            supervisor,
            guard: Guard::default(),
            positions: Follower::new(),
            control,
            gains: Gains::Outside,
            settings: 0,
            motor_reversed: signs.motor_reversed,
            hit: None,
            history: BlackBox::new(BlackBox::<HISTORY>::every(board::RATE_HZ, PERIOD)),
            replay: None,
            was_on: false,
            event: Event::None,
        }
    }

    /// The output for the newest due sample, then everything that can wait until it is out.
    ///
    /// Late by a period: `sample` switches off, and the fault `late render` is latched.
    #[inline(always)]
    pub fn run(&mut self) {
        let Some((motion, cut)) = self.ends.due.read() else { return };
        if let Some(guard) = self.ends.guard.read() {
            self.guard = guard;
        }
        let up = Up { motion, guard: self.guard, cut };
        let push = self.hit.as_ref().map_or(Force::ZERO, Hit::push);
        let inputs = self.inputs();
        let rendered = self.supervisor.render(&self.control, &up, push, inputs);
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
        self.experiment(rendered.grant);
        if matches!(self.event, Event::None)
            && let Some(order) = self.ends.orders.read()
        {
            self.event = Event::Answer(self.meet(order));
        }
        self.report(record);
        super::pend_link();
    }

    /// What the board says at this output.
    fn inputs(&self) -> Inputs {
        let stop_closed = self.outputs.stop.is_closed();
        let supply_good = !self.outputs.supply.is_low();
        Inputs {
            stop_closed,
            supply_good,
            settings_valid: self.gains == Gains::Inside || self.supervisor.status().unlocked,
            // Nobody else drops enable while force is on, but for the emergency stop and `sample`,
            // which have faults of their own.
            halted: self.was_on && stop_closed && !self.outputs.drive.is_on(),
        }
    }

    fn put_out(&mut self, grant: Grant) {
        match grant {
            Grant::Off => {
                board::off();
                self.was_on = false;
            }
            Grant::On(granted) => {
                if !self.was_on {
                    self.outputs.drive.on();
                    self.was_on = true;
                }
                let command = granted.command();
                self.outputs.drive.write(command, self.motor_reversed);
            }
        }
    }

    /// Feeds the samples since the last output to the experiment.
    fn experiment(&mut self, grant: Grant) {
        let on = matches!(grant, Grant::On(_));
        if self.hit.is_some() && !on {
            self.hit = None;
            self.event = Event::HitBroken;
        }
        while let Some(position) = self.positions.read() {
            let Some(hit) = &mut self.hit else { continue };
            let contact = self.control.wall.penetration(position) > 0;
            if let Some(verdict) = hit.sample(position, contact) {
                self.event = Event::HitOver(verdict, *hit.scatter());
                self.hit = None;
            }
        }
    }

    fn meet(&mut self, order: Order) -> Result<(), Refusal> {
        match order {
            Order::Request(request) => {
                let result = self.supervisor.request(request);
                if result.is_ok() && matches!(request, Request::Clear) {
                    self.history.release();
                }
                result
            }
            Order::Control(control, gains) => {
                self.supervisor.may_change(&self.control, &control)?;
                self.ends.control.publish(control); // from the next sample on, whole
                self.control = control;
                self.gains = gains;
                self.settings = self.settings.wrapping_add(1);
                Ok(())
            }
            Order::Hit(plan) => {
                self.hit = Some(Hit::new(plan));
                Ok(())
            }
            Order::Stop => {
                self.hit = None;
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
        if !self.ends.reports.has_room() {
            return;
        }
        let activity = match self.hit {
            Some(_) => Activity::Hit,
            None => Activity::None,
        };
        let record = self.replayed().unwrap_or(record);
        let report = Report {
            record,
            status: self.supervisor.status(),
            activity,
            event: core::mem::replace(&mut self.event, Event::None),
        };
        self.ends.reports.write(report);
    }

    /// The next record of the black box in place of the present one, while it is read out.
    fn replayed(&mut self) -> Option<Record> {
        let next = self.replay?;
        let record = self.history.get(next).copied();
        self.replay = record.is_some().then_some(next + 1);
        record.map(|record| Record { flags: record.flags.with_if(Flags::REPLAY, true), ..record })
    }
}
