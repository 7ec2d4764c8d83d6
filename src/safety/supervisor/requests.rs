//! Carries out requests such as `arm`, `disarm`, `clear` and `zero` between two outputs, and checks new settings.

use core::num::NonZeroU32;

use super::{
    Fault, FaultRecord, FaultSet, GuardCommand, MemoryUpdate, OutputCommand, Refusal, Request,
    SignTest, SpeedWatch, State, StuckEncoder, Supervisor,
};
use crate::{LoopParameters, units::Force};

impl Supervisor {
    /// Carries out a request between two outputs, or refuses it.
    ///
    /// # Errors
    /// The reason of a refusal. Nothing has changed then.
    pub fn request(&mut self, request: Request) -> Result<(), Refusal> {
        match request {
            Request::Arm => self.arm(),
            Request::Disarm => {
                self.switch_off();
                Ok(())
            }
            Request::Clear => self.clear(),
            Request::Zero => self.zero(),
            Request::Unlock => self.unlock(),
            Request::Turn if self.state.is_on() => Err(Refusal::On),
            // A zero that is under way would be carried out with the new direction of the count.
            Request::Turn if self.zero_pending() => Err(Refusal::Zeroing),
            Request::Turn => {
                self.zeroed.set(false);
                Ok(())
            }
            Request::Stall(true) if self.state.is_on() => Err(Refusal::On),
            Request::Stall(true) if !self.status().inputs.supply_good => Err(Refusal::Supply),
            Request::Stall(stall) => {
                self.down.stall = stall;
                if stall {
                    self.down.jump = GuardCommand::ANY; // until the output after the stall's end
                }
                Ok(())
            }
            Request::Trip(fault) => {
                let last = self.record;
                self.trip(Some(FaultRecord {
                    sample: last.sample,
                    position: last.position,
                    velocity: last.velocity,
                    force: last.force,
                    flags: last.flags,
                    ..FaultRecord::bare(fault)
                }));
                Ok(())
            }
        }
    }

    /// Prepares another output period. The new period comes into force with the next parameters, if
    /// [`may_change`](Self::may_change) allows it. The next output is still due after the old period, but by then the
    /// guard already has the new one. The guard must not report this output as late.
    #[inline(never)] // once in a while, and not to be in the way of what comes with every output
    pub fn set_period(&mut self, old: NonZeroU32, new: NonZeroU32) {
        self.plan.set(self.plan.at(new.get()));
        self.speed = SpeedWatch::default();
        self.down.rendered = self.down.rendered.wrapping_add(old.get()).wrapping_sub(new.get());
    }

    /// Checks that settings may change between this output and the next sample. Gains may always change, because their
    /// change fades in. The wall's position and the velocity estimator may not change in contact. This is checked here,
    /// because the console only knew an older output. A wall must not be put over the handle, because it would throw
    /// the handle out.
    ///
    /// # Errors
    /// The handle is in contact before or after the change, or a zero is under way. In the latter case the position
    /// from the next sample on is not known.
    pub fn may_change(&self, from: &LoopParameters, to: &LoopParameters) -> Result<(), Refusal> {
        let moved = from.wall.surface() != to.wall.surface();
        let same = from.estimator == to.estimator && from.period == to.period && !moved;
        let inside = moved && to.wall.penetration(self.record.position) > 0;
        if same || !self.state.is_on() {
            Ok(())
        } else if from.period != to.period {
            Err(Refusal::On)
        } else if self.contact || inside {
            Err(Refusal::Contact)
        } else if moved && self.zero_pending() {
            Err(Refusal::Zeroing)
        } else {
            Ok(())
        }
    }

    fn arm(&mut self) -> Result<(), Refusal> {
        self.status().may_arm()?;
        if self.down.stall {
            return Err(Refusal::Stalled);
        }
        // The handle's position after the zero is not known yet. It may be in a wall.
        if self.zero_pending() {
            return Err(Refusal::Zeroing);
        }
        self.state.set(State::SignTest);
        self.sign.set(SignTest::new());
        self.watch = StuckEncoder::default();
        self.memory = Some(MemoryUpdate::Write(FaultRecord::bare(Fault::ResetWhileArmed)));
        Ok(())
    }

    fn clear(&mut self) -> Result<(), Refusal> {
        if *self.state != State::Fault {
            return Err(Refusal::NoFault);
        }
        if let Some(fault) = self.present.first() {
            return Err(Refusal::CausePresent(fault));
        }
        self.state.set(State::Off);
        self.fault = None;
        self.causes = FaultSet::EMPTY;
        self.down.acknowledged = self.seen;
        self.memory = Some(MemoryUpdate::Erase);
        Ok(())
    }

    fn zero(&mut self) -> Result<(), Refusal> {
        match *self.state {
            State::SignTest | State::RampIn => return Err(Refusal::Arming),
            State::Armed if self.contact => return Err(Refusal::Contact),
            State::Armed if self.wall_over_zero => return Err(Refusal::WallThere),
            State::Armed | State::Off | State::Fault if self.zero_pending() => {
                return Err(Refusal::Zeroing);
            }
            State::Armed | State::Off | State::Fault => {}
        }
        self.down.zeros = self.down.zeros.next();
        Ok(())
    }

    fn unlock(&mut self) -> Result<(), Refusal> {
        if let (State::Fault, Some(record)) = (*self.state, self.fault) {
            return Err(Refusal::Faulted(record.fault));
        }
        self.unlocked.set(true);
        Ok(())
    }

    fn switch_off(&mut self) {
        self.unlocked.set(false);
        if self.state.is_on() {
            self.state.set(State::Off);
            self.last = OutputCommand::Off;
            self.down.force = Force::ZERO;
            self.down.speed = GuardCommand::ANY;
            self.memory = Some(MemoryUpdate::Erase);
        }
    }
}
