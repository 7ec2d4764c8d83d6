//! What supervisor and link exchange: plain records for queues.

use super::{Fault, FaultRecord, FaultSet};

/// State of the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// No force; waits for `arm`.
    Off,
    /// After `arm`: at most 5 % force for at most 100 ms show whether motor and encoder agree.
    SignTest,
    /// The force comes in.
    RampIn,
    /// The full force acts.
    Armed,
    /// No force until `clear`.
    Fault,
}

impl State {
    /// Whether force may act.
    pub const fn is_on(self) -> bool {
        matches!(self, Self::SignTest | Self::RampIn | Self::Armed)
    }

    /// Name, as replies have it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::SignTest => "sign test",
            Self::RampIn => "ramping in",
            Self::Armed => "armed",
            Self::Fault => "fault",
        }
    }
}

/// What the board and the link know, at an output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// The emergency stop is closed: force is possible.
    pub stop_closed: bool,
    /// The supply is above the limit of the voltage detector.
    pub supply_good: bool,
    /// The settings in force were accepted, and their gains are inside the envelope, or it is
    /// unlocked.
    pub settings_valid: bool,
    /// A debugger halted the processor since the last output.
    pub halted: bool,
    /// What the board found wrong with itself.
    pub found: FaultSet,
}

/// What a board senses at an output, see [`contract::sense`](crate::contract::sense).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sensed {
    /// The output task has switched the amplifier on, and not off since.
    pub switched_on: bool,
    /// A debugger halted the processor since the last output.
    pub halted: bool,
    /// The emergency stop was open at some time since the amplifier was switched on.
    pub was_stopped: bool,
    /// It is closed now.
    pub stop_closed: bool,
    /// The supply is above the limit of the voltage detector.
    pub supply_good: bool,
    /// The amplifier is enabled. Read it before the inputs that may switch it off.
    pub enabled: bool,
    /// Faults that the board found in itself; enable is off then.
    pub found: FaultSet,
}

impl Inputs {
    /// What this means. `cut`: the sampling task has switched the amplifier off; `settings_valid` as in [`Inputs`].
    #[inline(always)]
    pub fn of(sensed: Sensed, cut: bool, settings_valid: bool) -> Self {
        let Sensed { switched_on, halted, supply_good, found, .. } = sensed;
        // A stop that is over before the next output still counts. A halt may set the same flag.
        let stopped = switched_on && !halted && sensed.was_stopped;
        let stop_closed = sensed.stop_closed && !stopped;
        // While force is on, enable is dropped only by the emergency stop, the supply detector, the sampling task (it
        // cut) and the output task (it found). These have faults of their own.
        let quiet = stop_closed && supply_good && !cut && found.is_empty();
        let dropped = quiet && !sensed.enabled;
        Self {
            stop_closed,
            supply_good,
            settings_valid,
            halted: switched_on && (halted || dropped),
            found,
        }
    }
}

/// What the link asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Sign test, ramp, force.
    Arm,
    /// Switch the force off.
    Disarm,
    /// Forget the fault, if its cause is gone.
    Clear,
    /// The count becomes 0 here.
    Zero,
    /// Allow gains beyond the envelope, until the force goes off.
    Unlock,
    /// Motor or encoder are reversed: the zero is lost.
    Turn,
    /// Flash is about to be written (`true`), or was (`false`).
    Stall(bool),
    /// A fault with this code that only the board can see.
    Trip(Fault),
}

/// Why a request or a command is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The command `zero` comes first.
    NotZeroed,
    /// The settings are not valid, or outside the envelope.
    Settings,
    /// The emergency stop is open.
    StopOpen,
    /// The supply is too low.
    Supply,
    /// A fault is latched; `clear` comes first.
    Faulted(Fault),
    /// There is no fault to clear.
    NoFault,
    /// The cause of the fault is still there.
    CausePresent(Fault),
    /// The force is on; `disarm` comes first.
    On,
    /// Sign test or ramp is going on; wait for its end.
    Arming,
    /// The force is not on, or not complete yet; `arm` comes first.
    NotArmed,
    /// The handle is in contact; leave the wall first.
    Contact,
    /// The wall covers the place where the handle would be after `zero`.
    WallThere,
    /// A zero is under way.
    Zeroing,
    /// An experiment is running: send `stop` first.
    Busy,
    /// It needs `unlock envelope` first.
    Locked,
    /// Flash is being written.
    Stalled,
}

impl Refusal {
    /// What is wrong and what helps.
    pub const fn text(self) -> &'static str {
        match self {
            Self::NotZeroed => "not zeroed: use zero first",
            Self::Settings => "settings are not valid or outside the envelope: see get",
            Self::StopOpen => "the emergency stop is open: close it first",
            Self::Supply => "the supply is too low",
            Self::Faulted(_) => "a fault is latched: see faults, then clear",
            Self::NoFault => "there is no fault",
            Self::CausePresent(_) => "the cause of the fault is still there",
            Self::On => "the force is on: disarm first",
            Self::Arming => "arming: wait for the ramp to end",
            Self::NotArmed => "not armed: arm first and wait for the ramp",
            Self::Contact => "in contact: leave the wall first",
            Self::WallThere => "the wall reaches over 0: move it or disarm first",
            Self::Zeroing => "a zero is under way: try again",
            Self::Busy => "an experiment is running: stop first",
            Self::Locked => "the envelope is locked: unlock envelope first",
            Self::Stalled => "flash is being written: wait",
        }
    }
}

/// The supervisor as the link sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Status {
    /// State of the supervisor.
    pub state: State,
    /// The first fault, while one is latched.
    pub fault: Option<FaultRecord>,
    /// All causes that were found since, the first among them.
    pub causes: FaultSet,
    /// Causes that are there now.
    pub present: FaultSet,
    /// The count was zeroed, and the zero was not lost since.
    pub zeroed: bool,
    /// Gains beyond the envelope are allowed.
    pub unlocked: bool,
    /// The handle is inside the wall.
    pub contact: bool,
    /// The inputs of the last output.
    pub inputs: Inputs,
}

impl Status {
    /// Whether `arm` is allowed. All its conditions are here, except flash that is being written.
    ///
    /// # Errors
    /// The first thing that is in the way.
    pub fn may_arm(&self) -> Result<(), Refusal> {
        let Inputs { stop_closed, supply_good, settings_valid, .. } = self.inputs;
        let refusal = match self.state {
            State::Fault => {
                Refusal::Faulted(self.fault.map_or(Fault::Settings, |record| record.fault))
            }
            State::SignTest | State::RampIn | State::Armed => Refusal::On,
            State::Off if !stop_closed => Refusal::StopOpen,
            State::Off if !supply_good => Refusal::Supply,
            State::Off if !settings_valid => Refusal::Settings,
            State::Off if !self.zeroed => Refusal::NotZeroed,
            State::Off if self.contact => Refusal::Contact, // the wall would throw the handle out
            State::Off => return Ok(()),
        };
        Err(refusal)
    }
}
