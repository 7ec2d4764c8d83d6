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
use zwidth::{contract::ForceOutput, self_test::Found, units::OutputCode};

use super::super::common::mask;

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

/// Codes within what the buffer can give (0.2 to 3.1 V).
const LEAST: u32 = 320;
const STEP: u32 = 230;
const STEPS: u32 = 16;
/// Errors of DAC and converter together: offset, gain and linearity, 1 % of the range (data sheets).
const ALLOWED: u32 = 40;

/// Core cycles until the output has settled: 10 us.
const SETTLE: u32 = 1800;
/// Looks at the converter's flag: it takes some 4 us.
const LOOKS: u32 = 1000;

/// ADC1's fourth input is the DAC's pin (data sheet: PA4 is ADC12_IN4). A code that the converter does not answer for
/// reads as 0. `SelfTest` has given it its clock.
pub fn test() -> Found {
    // SAFETY: the addresses are ADC1's and of what the two converters share, which nothing else uses; documented values:
    // clock / 4, one conversion of channel 4, 84 cycles of sampling, on.
    let adc = unsafe {
        (*pac::ADC_COMMON::ptr()).ccr().write(|w| w.bits(0b01 << 16));
        let adc = &*pac::ADC1::ptr();
        adc.smpr2().write(|w| w.bits(0b100 << 12));
        adc.sqr1().write(|w| w.bits(0));
        adc.sqr3().write(|w| w.bits(4));
        adc.cr2().write(|w| w.bits(1));
        adc
    };
    cortex_m::asm::delay(SETTLE);
    let read = |code: u32| {
        // An output of `render` would put zero force in its place.
        mask::with_lower_tasks_masked(|| {
            // SAFETY: documented values; enable is off.
            unsafe {
                (*pac::DAC::ptr()).dhr12r1().write(|w| w.bits(code));
                cortex_m::asm::delay(SETTLE);
                adc.sr().write(|w| w.bits(0));
                adc.cr2().write(|w| w.bits(1 << 30 | 1));
            }
            let done = (0..LOOKS).any(|_| adc.sr().read().eoc().bit_is_set());
            let read = adc.dr().read().bits();
            Output::zero();
            if done { read } else { 0 }
        })
    };
    let codes = (0..STEPS).map(|n| LEAST + n * STEP).map(|code| [code, read(code)]);
    let worst = codes.max_by_key(|[code, read]| code.abs_diff(*read)).unwrap_or_default();
    // SAFETY: a documented value: off.
    adc.cr2().write(|w| unsafe { w.bits(0) });
    Found::Output { worst, allowed: ALLOWED }
}
