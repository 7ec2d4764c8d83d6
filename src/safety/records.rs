//! Records that supervisor and link exchange through queues.

use super::{Fault, FaultRecord, FaultSet};

/// State of the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// There is no force. The supervisor waits for `arm`.
    Off,
    /// The first state after `arm`. A force of at most 5 % acts for at most 100 ms. It shows whether the signs of motor
    /// and encoder agree.
    SignTest,
    /// The force rises.
    RampIn,
    /// The full force acts.
    Armed,
    /// There is no force until `clear`.
    Fault,
}

impl State {
    /// Whether force may act.
    pub const fn is_on(self) -> bool {
        matches!(self, Self::SignTest | Self::RampIn | Self::Armed)
    }

    /// Name of the state in replies.
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

/// Facts about board and settings at an output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Whether the emergency stop is closed, so that force is possible.
    pub stop_closed: bool,
    /// Whether the supply is above the limit of the voltage detector.
    pub supply_good: bool,
    /// Whether the settings in force were accepted. Their gains are inside the envelope, or the envelope is unlocked.
    pub settings_valid: bool,
    /// Whether a debugger halted the processor since the last output.
    pub halted: bool,
    /// Faults that the board found in itself.
    pub found: FaultSet,
}

/// Facts that a board senses at an output, see [`contract::sense`](crate::contract::sense).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sensed {
    /// Whether the task `render` has switched the amplifier on, and has not switched it off since.
    pub switched_on: bool,
    /// Whether a debugger halted the processor since the last output.
    pub halted: bool,
    /// Whether the emergency stop was open at some time since the amplifier was switched on.
    pub was_stopped: bool,
    /// Whether the emergency stop is closed now.
    pub stop_closed: bool,
    /// Whether the supply is above the limit of the voltage detector.
    pub supply_good: bool,
    /// Whether the amplifier is enabled. Read this before the inputs that may switch it off.
    pub enabled: bool,
    /// Faults that the board found in itself. Enable is off then.
    pub found: FaultSet,
}

impl Inputs {
    /// Derives the inputs from these facts. `cut` says whether the task `sample` has switched the amplifier off.
    /// `settings_valid` is the field of [`Inputs`].
    #[inline(always)]
    pub fn of(sensed: Sensed, cut: bool, settings_valid: bool) -> Self {
        let Sensed { switched_on, halted, supply_good, found, .. } = sensed;
        // A stop that ends before the next output is still a stop. A halt may set the same flag.
        let stopped = switched_on && !halted && sensed.was_stopped;
        let stop_closed = sensed.stop_closed && !stopped;
        // While force is on, only four causes switch enable off: the emergency stop, the supply detector, the task
        // `sample` (`cut`) and the task `render` (`found`). Each of these four causes has its own fault.
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

/// A request from the console to the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Switch the force on: sign test, then ramp.
    Arm,
    /// Switch the force off.
    Disarm,
    /// Clear the fault, if its cause is gone.
    Clear,
    /// Make the present position zero.
    Zero,
    /// Allow gains beyond the envelope, until the force goes off.
    Unlock,
    /// Motor or encoder are reversed, so the zero is lost.
    Turn,
    /// Flash is about to be written (`true`), or was written (`false`).
    Stall(bool),
    /// Switch off with this fault, which only the board can find.
    Trip(Fault),
}

/// Why a request or a command is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The count was not zeroed yet: send `zero` first.
    NotZeroed,
    /// The settings are not valid, or outside the envelope.
    Settings,
    /// The emergency stop is open.
    StopOpen,
    /// The supply is too low.
    Supply,
    /// A fault is latched: send `clear` first.
    Faulted(Fault),
    /// There is no fault to clear.
    NoFault,
    /// The cause of the fault is still present.
    CausePresent(Fault),
    /// The force is on: send `disarm` first.
    On,
    /// Sign test or ramp is running: wait for its end.
    Arming,
    /// The force is not on, or not complete yet: send `arm` first.
    NotArmed,
    /// The handle is in contact: leave the wall first.
    Contact,
    /// The wall covers the position that the handle would have after `zero`.
    WallThere,
    /// A zero is under way.
    Zeroing,
    /// An experiment is running: send `stop` first.
    Busy,
    /// The envelope is locked: send `unlock envelope` first.
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

/// What the supervisor reports to the console.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Status {
    /// State of the supervisor.
    pub state: State,
    /// The first fault, while one is latched.
    pub fault: Option<FaultRecord>,
    /// All causes since the first fault, including the first fault.
    pub causes: FaultSet,
    /// Causes that are present now.
    pub present: FaultSet,
    /// Whether the count was zeroed and the zero was not lost since then.
    pub zeroed: bool,
    /// Whether gains beyond the envelope are allowed.
    pub unlocked: bool,
    /// Whether the handle is inside the wall.
    pub contact: bool,
    /// The inputs of the last output.
    pub inputs: Inputs,
}

impl Status {
    /// Checks all conditions of `arm`, except whether flash is being written.
    ///
    /// # Errors
    /// The first condition that is not fulfilled.
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
