//! Connections of a board's pins.

use crate::mcu::Pin;

/// The pin of each signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// Channels A and B of the encoder.
    pub encoder: [Pin; 2],
    /// Further pins for A and B, which capture the times of their edges: TIM3's channels 1 and 2.
    pub captured: Option<[Pin; 2]>,
    pub force: Force,
    /// Amplifier enable, active high.
    pub enable: Pin,
    /// Emergency stop, normally closed to ground.
    pub stop: Pin,
}

/// Kind of the force output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Force {
    /// Channel 1 of the DAC.
    Dac { pin: Pin },
    /// Sign-magnitude PWM of TIM1.
    Pwm {
        /// Channel 1: magnitude of the force.
        magnitude: Pin,
        /// Channel 2; a high level means away from the wall.
        sign: Pin,
    },
}
