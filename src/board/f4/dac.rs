//! Force by DAC1 on PA4: 12 bits, 0 to 3.3 V asked for, some 0.2 to 3.1 V with the buffer on, zero force in the middle.
//!
//! Output impedance 15 kOhm with the buffer off, settling 6 us at most (data sheet, 5 kOhm and
//! 50 pF with the buffer on). A store moves the output 1 APB1 cycle later; nothing is preloaded.

use stm32f4xx_hal::{
    dac::{C1, DacExt, DacOut, DacPin},
    gpio::{Analog, PA4},
    pac,
    rcc::Rcc,
};
use zwidth::{contract::ForceOutput, units::OutputCode};

/// Code of zero force.
pub const ZERO: u16 = 2048;

/// The force output.
pub struct Output(C1);

impl Output {
    /// The DAC at zero force.
    pub fn new(dac: pac::DAC, pin: PA4<Analog>, rcc: &mut Rcc) -> Self {
        let mut channel = dac.constrain(pin, rcc);
        channel.set_value(ZERO);
        channel.enable();
        Self(channel)
    }
}

impl ForceOutput for Output {
    /// The core has clamped the code to 1 ..= 4095.
    #[inline(always)]
    fn write(&mut self, command: OutputCode, mirrored: bool) {
        let code = u16::try_from(command.code()).unwrap_or(ZERO);
        self.0.set_value(if mirrored { 2 * ZERO - code.min(2 * ZERO) } else { code });
    }

    #[inline(always)]
    fn zero() {
        // SAFETY: the address is the DAC's; a whole store of a documented value.
        unsafe {
            let dac = &*pac::DAC::ptr();
            dac.dhr12r1().write(|w| w.bits(u32::from(ZERO)));
        }
    }

    /// A DAC has no clock of its own.
    fn start() {}
}
