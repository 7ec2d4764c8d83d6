//! The supervisor's command for the output.

use crate::units::{Force, OutputCode};

/// Command for the output. Only a supervisor that is on grants a force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutputCommand {
    /// Make enable inactive, then write the code of zero force.
    Off,
    /// This force may act now.
    On(GrantedForce),
}

/// A force that may act. Only a [`Supervisor`](super::Supervisor) makes one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GrantedForce {
    pub(super) force: Force,
    pub(super) command: OutputCode,
}

#[cfg(test)]
impl GrantedForce {
    pub(crate) const ZERO: Self = Self { force: Force::ZERO, command: OutputCode(0) };
}

impl GrantedForce {
    /// The force, within +-1 full scale.
    pub fn force(self) -> Force {
        self.force
    }

    /// The force as a DAC or PWM code.
    pub fn command(self) -> OutputCode {
        self.command
    }
}

impl OutputCommand {
    /// The force that acts, or `None` while off.
    pub fn force(self) -> Option<Force> {
        match self {
            Self::Off => None,
            Self::On(granted) => Some(granted.force),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_granted_is_what_is_given() {
        let force = Force::saturating_from_bits(-123_456);
        let granted = GrantedForce { force, command: OutputCode(777) };
        assert_eq!((granted.force(), granted.command()), (force, OutputCode(777)));
        assert_eq!(OutputCommand::On(granted).force(), Some(force));
        assert_eq!(OutputCommand::Off.force(), None);
    }
}
