//! What the output may do.

use crate::units::{Command, Force};

/// What the output may do. A force comes only out of a supervisor that is on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Grant {
    /// Amplifier enable inactive first, then the code of zero force.
    Off,
    /// This force.
    On(Granted),
}

/// A force that may act. Only a [`Supervisor`](super::Supervisor) makes one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Granted {
    pub(super) force: Force,
    pub(super) command: Command,
}

impl Granted {
    /// The force, within +-1 full scale.
    pub fn force(self) -> Force {
        self.force
    }

    /// The same as a DAC or PWM code.
    pub fn command(self) -> Command {
        self.command
    }
}

impl Grant {
    /// The force that acts; none while off.
    pub fn force(self) -> Option<Force> {
        match self {
            Self::Off => None,
            Self::On(granted) => Some(granted.force),
        }
    }
}
