//! The part of the supervisor that runs for every output.

#![deny(clippy::float_arithmetic)]

mod requests;

use core::hint::cold_path;

use super::{
    Doubled, Fault, FaultRecord, FaultSet, GrantedForce, Guard, GuardCommand, Inputs, MemoryUpdate,
    OutputCommand, Refusal, Request, SafetyPlan, SampleReport, State, Status,
    gain_fade::GainFade,
    sign::{SignStep, SignTest},
    speed::SpeedWatch,
    stuck_encoder::StuckEncoder,
};
use crate::{
    Drive, LoopParameters, Motion,
    passivity::PassiveWall,
    port::Exchanged,
    telemetry::{Flags, Record},
    units::{Demand, Force, Position},
};

/// The push that an experiment proposes. The [`Supervisor`] decides how much of it acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Proposal {
    /// Force into the wall.
    pub push: Force,
    /// Whether the handle is held on purpose, as in a calibration. A push without motion is then no sign of a dead
    /// encoder.
    pub still: bool,
}

/// One output under supervision: the command for the hardware, and its record. All other data stay in the
/// [`Supervisor`]. To copy them before the hardware is written would add latency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rendered {
    /// Command for the output.
    pub grant: OutputCommand,
    /// Record for telemetry and black box. Its field `settings` is 0, and is filled in later.
    pub record: Record,
}

/// The part of the supervisor that runs for every output. The task `render` owns it.
#[derive(Clone, Copy, Debug)]
pub struct Supervisor {
    plan: Doubled<SafetyPlan>,
    state: Doubled<State>,
    sign: Doubled<SignTest>,
    /// Number of outputs since the ramp of the force began.
    ramp: u32,
    fade: Option<GainFade>,
    /// The energy account of the wall's port.
    port: PassiveWall,
    /// Whether the passivity controller has changed the last force.
    withheld: bool,
    watch: StuckEncoder,
    speed: SpeedWatch,
    last: OutputCommand,
    fault: Option<FaultRecord>,
    causes: FaultSet,
    present: FaultSet,
    /// [`Guard::events`] at the last output.
    seen: u32,
    /// Number of zeroings that were carried out up to the last output.
    zeros: Doubled<u32>,
    zeroed: Doubled<bool>,
    unlocked: Doubled<bool>,
    contact: bool,
    /// Whether the handle is in contact with a wall that has a force. The handle may lean on this wall.
    resting: bool,
    /// Whether a handle at count 0 would be in the wall.
    wall_over_zero: bool,
    inputs: Inputs,
    record: Record,
    down: GuardCommand,
    memory: Option<MemoryUpdate>,
}

impl Supervisor {
    /// Makes a supervisor that is off, or that has the fault `boot` of the last run.
    pub fn new(plan: SafetyPlan, boot: Option<FaultRecord>) -> Self {
        Self {
            plan: Doubled::new(plan),
            state: Doubled::new(if boot.is_some() { State::Fault } else { State::Off }),
            sign: Doubled::new(SignTest::new()),
            ramp: 0,
            fade: None,
            port: PassiveWall::new(Position::from_counts(0)),
            withheld: false,
            watch: StuckEncoder::default(),
            speed: SpeedWatch::default(),
            last: OutputCommand::Off,
            fault: boot,
            causes: boot.map_or(FaultSet::EMPTY, |record| record.causes),
            present: FaultSet::EMPTY,
            seen: 0,
            zeros: Doubled::new(0),
            zeroed: Doubled::new(false),
            unlocked: Doubled::new(false),
            contact: false,
            resting: false,
            wall_over_zero: false,
            inputs: Inputs::default(),
            record: Record::EMPTY,
            down: GuardCommand::start(&plan),
            memory: None,
        }
    }

    /// Returns the output for the sample of `up`. Its force is the force of experiment and wall, limited to what may
    /// act. `guard` has the guard's findings. `control` must belong to the same sample. Write the output, then publish
    /// [`down`](Self::down), and store the result of [`take_memory_update`](Self::take_memory_update).
    #[inline]
    pub fn grant(
        &mut self,
        control: &LoopParameters,
        up: &SampleReport,
        guard: &Guard,
        (proposal, drive): (Proposal, Drive),
        inputs: Inputs,
    ) -> Rendered {
        // The state is checked before it changes, because a change writes both copies and would hide a flipped bit.
        let found = inputs.found.with_if(Fault::Memory, !self.state.is_whole());
        let inputs = Inputs { found, ..inputs };
        self.inputs = inputs;
        if self.state.is_on() {
            self.down.stall = false; // also after a flipped bit: `arm` is refused during a stall
        }
        self.contact = drive.contact;
        self.resting = drive.contact && control.wall.acts();
        self.wall_over_zero = control.wall.penetration(Position::default()) > 0;
        let before = *self.zeros;
        let held = self.follow_zero(guard);
        if *self.zeros != before {
            self.port.rename(up.motion.position);
        }
        self.look(up, guard, inputs, (proposal.still, *self.zeros != before));
        let force = self.force(control, up, proposal.push, &drive, held);
        let grant = match force {
            Some(force) => {
                OutputCommand::On(GrantedForce { force, command: control.actuator.command(force) })
            }
            None => OutputCommand::Off,
        };
        self.last = grant;
        self.down.rendered = up.motion.number();
        self.down.force = grant.force().unwrap_or_default();
        self.down.speed = if self.state.is_on() { self.plan.speed } else { GuardCommand::ANY };
        self.down.jump = if self.down.stall { GuardCommand::ANY } else { self.plan.jump };
        let record = self.record_of(control, up, &drive, grant);
        self.record = record;
        Rendered { grant, record }
    }

    /// Adds the wall's force to the energy account, for the time from the last output on. Call it after this output is
    /// written.
    #[inline]
    pub fn book(&mut self) {
        let acts = matches!(*self.state, State::RampIn | State::Armed);
        let wall = match (self.last.force(), &self.fade) {
            (Some(force), Some(fade)) if acts => {
                i64::from(fade.push().bits()) - i64::from(force.bits())
            }
            _ => 0,
        };
        self.port.gives(0, wall, acts && self.contact, self.record.position);
    }

    /// Energy that wall and hand have exchanged.
    #[inline]
    pub fn exchanged(&self) -> Exchanged {
        self.port.port().exchanged()
    }

    /// Resets [`Exchanged::given`].
    #[inline]
    pub fn forget_given(&mut self) {
        self.port.forget();
    }

    /// The supervisor's state, for the link.
    pub fn status(&self) -> Status {
        Status {
            state: *self.state,
            fault: self.fault,
            causes: self.causes,
            present: self.present,
            zeroed: *self.zeroed || self.zero_pending(),
            unlocked: *self.unlocked,
            contact: self.contact,
            inputs: self.inputs,
        }
    }

    /// Whether the values that decide about the force are unchanged in memory. Call it after each output.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.state.is_whole()
            && self.plan.is_whole()
            && self.unlocked.is_whole()
            && self.zeroed.is_whole()
            && self.zeros.is_whole()
            && self.fade.as_ref().is_none_or(GainFade::is_whole)
            && !(self.state.is_on()
                && (self.fault.is_some() || self.down.acknowledged != self.seen))
    }

    /// Whether the task `sample` has switched off by itself.
    pub fn is_cut(&self, up: &SampleReport, guard: &Guard) -> bool {
        !up.present.is_empty() || guard.events != self.down.acknowledged
    }

    /// Returns the command for the task `sample`, after the last output or [`request`](Self::request). Publish it after
    /// the output is written to the hardware. After a request that cannot wait for the next output, such as a stall or
    /// a zero, publish it at once.
    #[inline]
    pub fn down(&self) -> GuardCommand {
        self.down
    }

    /// The requested change of the backup RAM, if there is one. Call it after every output.
    #[inline]
    pub fn take_memory_update(&mut self) -> Option<MemoryUpdate> {
        self.memory.take()
    }

    /// Keeps the first fault, and notes later faults. If there is already a fault although the force is on, a bit has
    /// flipped. Then the new fault replaces it.
    #[inline]
    fn trip(&mut self, record: Option<FaultRecord>) {
        let Some(record) = record else {
            return;
        };
        let first = self.fault.is_none() || self.state.is_on();
        self.causes = if first { record.causes } else { self.causes.union(record.causes) };
        if record.causes.loses_zero() {
            self.zeroed.set(false);
        }
        if first {
            self.fault = Some(record);
            self.memory = Some(MemoryUpdate::Write(record));
        }
        self.state.set(State::Fault);
        self.unlocked.set(false);
    }

    /// Whether a zeroing was requested that `sample` has not carried out yet.
    fn zero_pending(&self) -> bool {
        self.down.zeros.number() != *self.zeros
    }

    /// Notes a zeroing that `sample` has carried out. The positions then have other numbers, so the old settings no
    /// longer give the old force. A change of the force must start from the force of the last output. Returns this
    /// force.
    fn follow_zero(&mut self, guard: &Guard) -> Option<Force> {
        // Only a request makes a zero, and there is one at a time. Any other difference is a flipped bit.
        let asked = guard.zeros == self.down.zeros.number();
        if guard.zeros == *self.zeros || !asked || !self.zeros.is_whole() {
            return None;
        }
        self.zeros.set(guard.zeros);
        self.zeroed.set(true);
        self.last.force()
    }

    /// Finds all faults that are present, and latches them.
    #[inline]
    fn look(
        &mut self,
        up: &SampleReport,
        guard: &Guard,
        inputs: Inputs,
        (still, renamed): (bool, bool),
    ) {
        let on = self.state.is_on();
        let fast = self.speed.too_fast(&self.plan, up.motion.position, renamed);
        let outside = FaultSet::EMPTY
            .with_if(Fault::EmergencyStop, !inputs.stop_closed)
            .with_if(Fault::BrownOut, !inputs.supply_good)
            .with_if(Fault::Settings, !inputs.settings_valid)
            .with_if(Fault::Debugger, inputs.halted);
        // With the force off these causes are no fault, and only prevent `arm`. But a cause of the latched fault
        // prevents `clear` as long as it is present.
        let relevant = if on { outside } else { outside.without(outside.without(self.causes)) };
        let found = up.present.union(inputs.found);
        let found = found.with_if(Fault::OutOfRange, !up.motion.position.in_range());
        self.present = relevant.union(found);
        if guard.events != self.seen {
            cold_path();
            self.seen = guard.events;
            let record = self.here(up.motion, guard.causes.union(self.stuck(up.motion)));
            self.trip(record.map(|record| FaultRecord {
                fault: guard.first.first().unwrap_or(record.fault),
                sample: guard.first_found(up.motion),
                ..record
            }));
        }
        let acted = self.last.force().filter(|_| !still);
        let pushed = self.watch.failed(&self.plan, acted, self.resting, up.motion.position);
        let place = up.motion.position.wrapping_since(Position::default());
        let [low, high] = self.plan.travel;
        let acting = outside
            .with_if(Fault::PushWithoutMotion, pushed)
            .with_if(Fault::OverSpeed, fast && found.is_empty()) // a jump is no speed
            .with_if(Fault::BeyondTravel, place < low || place > high);
        let all = if on { found.union(acting) } else { found };
        if !all.is_empty() {
            cold_path();
            self.trip(self.here(up.motion, all));
        }
    }

    /// Returns the fault of a stuck `render`, if outputs are late for a long time. The guard has found each single late
    /// output.
    #[inline]
    fn stuck(&self, motion: Motion) -> FaultSet {
        let behind = motion.number().wrapping_sub(self.down.rendered);
        let stuck = behind > self.plan.stuck && !self.down.stall;
        FaultSet::EMPTY.with_if(Fault::StuckRender, stuck)
    }

    /// Makes a record of `causes` with the present position, velocity and force. The fault of the record is the first
    /// cause.
    #[inline]
    fn here(&self, motion: Motion, causes: FaultSet) -> Option<FaultRecord> {
        causes.first().map(|fault| FaultRecord {
            fault,
            causes,
            sample: motion.sample,
            position: motion.position,
            velocity: motion.velocity,
            force: self.last.force().unwrap_or_default(),
            flags: self.record.flags,
        })
    }

    /// Returns the force that may act now, or `None` if no force may act.
    #[inline]
    fn force(
        &mut self,
        control: &LoopParameters,
        up: &SampleReport,
        push: Force,
        drive: &Drive,
        held: Option<Force>,
    ) -> Option<Force> {
        if *self.state == State::SignTest {
            let step = self.sign.change(|sign| sign.step(&self.plan, up.motion.position));
            match step {
                // With a changed position or time a wrong sign could pass.
                _ if !self.sign.is_whole() => {
                    self.trip(self.here(up.motion, FaultSet::EMPTY.with(Fault::Memory)));
                }
                SignStep::Push(force) => return Some(force),
                SignStep::Passed => {
                    self.state.set(State::RampIn);
                    self.ramp = 0;
                    self.fade = None;
                }
                SignStep::Failed => {
                    self.trip(self.here(up.motion, FaultSet::EMPTY.with(Fault::SignTestFailed)));
                }
            }
        }
        if !self.state.is_on() {
            return None;
        }
        // Ramp and fade together must not exceed the largest step.
        let ramping = *self.state == State::RampIn;
        let SafetyPlan { slew, ramp_step, .. } = *self.plan;
        let slew = if ramping { slew.saturating_sub_unsigned(ramp_step) } else { slew };
        let fade = self.fade.get_or_insert(GainFade::new(control.wall, push));
        let full = fade.force((&control.wall, push), up.motion, drive, held, slew);
        let pushed = fade.push();
        let force = if ramping { self.ramped(full) } else { full };
        Some(self.within_port(force, pushed, (drive.contact, up.motion.position)))
    }

    /// `full`, scaled by the progress of the ramp.
    fn ramped(&mut self, full: Force) -> Force {
        // The first millisecond is for the step from the force of the sign test to 0, so the ramp begins after it.
        let ramped = self.ramp.saturating_sub(self.plan.per_ms - 1);
        if ramped >= self.plan.ramp_renders {
            self.state.set(State::Armed);
            return full;
        }
        let part = i64::from(ramped) * i64::from(self.plan.ramp_step); // below 2^30
        let force = (i64::from(full.bits()) * part) >> Force::FRACTION_BITS;
        self.ramp = self.ramp.saturating_add(1);
        Demand::from_bits(force).saturate().0
    }

    /// Limits `force` by the passivity controller of the wall, if there is one. The result is between `force` and
    /// `push`.
    #[inline]
    fn within_port(&mut self, force: Force, push: Force, at: (bool, Position)) -> Force {
        self.withheld = false;
        let Some(plan) = &self.plan.passivity else { return force };
        let push = i64::from(push.bits());
        let wants = push - i64::from(force.bits());
        let gives = self.port.limit(plan, wants, at.0, at.1);
        self.withheld = gives != wants;
        Demand::from_bits(push - gives).saturate().0
    }

    fn record_of(
        &self,
        control: &LoopParameters,
        up: &SampleReport,
        drive: &Drive,
        grant: OutputCommand,
    ) -> Record {
        let (force, command) = match grant {
            OutputCommand::Off => (Force::ZERO, control.actuator.zero()),
            OutputCommand::On(granted) => (granted.force, granted.command),
        };
        let fading = self.fade.as_ref().is_some_and(GainFade::is_fading);
        Record {
            sample: up.motion.sample,
            position: up.motion.position,
            velocity: up.motion.velocity,
            force,
            command,
            flags: Flags::RENDERED
                .with_if(Flags::CONTACT, drive.contact)
                .with_if(Flags::SATURATED, drive.saturated)
                .with_if(Flags::ON, grant.force().is_some())
                .with_if(Flags::ARMED, *self.state == State::Armed)
                .with_if(Flags::CHANGING, self.state.is_on() && (fading || self.withheld))
                .with_if(Flags::FAULT, self.fault.is_some())
                .with_if(Flags::ZEROED, *self.zeroed)
                .with_if(Flags::STOP_CLOSED, self.inputs.stop_closed)
                .with_if(Flags::UNLOCKED, *self.unlocked),
            settings: 0,
            fault: self.fault.map_or(0, |record| record.fault.code()),
        }
    }
}

#[cfg(test)]
#[path = "../tests/supervisor.rs"]
mod tests;
