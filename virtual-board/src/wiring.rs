use crate::mcu::Pin;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// Channels A and B of the encoder.
    pub encoder: [Pin; 2],
    /// Pins of TIM3's channels 1 and 2, if A and B are also wired to TIM3. Then TIM3 captures the times of the edges.
    pub captured: Option<[Pin; 2]>,
    pub force: Force,
    /// Amplifier enable, active high.
    pub enable: Pin,
    /// Emergency stop, normally closed to ground.
    pub stop: Pin,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Force {
    /// Channel 1 of the DAC.
    Dac { pin: Pin },
    /// Sign-magnitude PWM of TIM1.
    Pwm {
        /// Channel 1: magnitude of the force.
        magnitude: Pin,
        /// Channel 2. A high level means a force away from the wall.
        sign: Pin,
    },
}
