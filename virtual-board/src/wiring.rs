use crate::mcu::Pin;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// The pins of the encoder's channels A and B.
    pub encoder: [Pin; 2],
    /// Pins of TIM3's channels 1 and 2, if A and B are also wired to TIM3. Then TIM3 captures the times of the edges.
    pub captured: Option<[Pin; 2]>,
    pub force: Force,
    /// The pin that enables the amplifier. It is active high.
    pub enable: Pin,
    /// The pin of the emergency stop, whose switch is normally closed to ground.
    pub stop: Pin,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Force {
    /// The force output is channel 1 of the DAC.
    Dac { pin: Pin },
    /// The force output is a sign-magnitude PWM of TIM1.
    Pwm {
        /// The pin of channel 1, which gives the magnitude of the force.
        magnitude: Pin,
        /// The pin of channel 2, which gives the sign. A high level means a force away from the wall.
        sign: Pin,
    },
}
