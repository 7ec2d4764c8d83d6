//! Which pins of a board are wired to what.

use crate::mcu::Pin;

/// Which pin goes where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// Channels A and B of the encoder.
    pub encoder: [Pin; 2],
    /// Where A and B are wired to as well, for the times of their edges: TIM3's channels 1 and 2.
    pub captured: Option<[Pin; 2]>,
    pub force: Force,
    /// Amplifier enable, active high.
    pub enable: Pin,
    /// Emergency stop, normally closed to ground.
    pub stop: Pin,
}

/// How the force comes out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Force {
    /// Channel 1 of the DAC.
    Dac { pin: Pin },
    /// Sign-magnitude PWM of TIM1.
    Pwm {
        /// Channel 1: the force's magnitude.
        magnitude: Pin,
        /// Channel 2, high: away from the wall.
        sign: Pin,
    },
}
