//! Force by DAC1 on PA4: 12 bits for 0 to 3.3 V. Its buffer gives some 0.2 to 3.1 V. Zero force is in the middle.
//!
//! With the buffer off the output impedance is 15 kOhm. With the buffer on the output settles in at most 6 us (data
//! sheet, 5 kOhm and 50 pF). A store changes the output 1 APB1 cycle later, without a preload.

use stm32f4xx_hal::{
    dac::{C1, DacExt, DacOut, DacPin},
    gpio::{Analog, PA4},
    pac,
    rcc::Rcc,
};
use zwidth::{contract::ForceOutput, self_test::Found, units::OutputCode};

use super::{super::common::mask, f4::read_back};

pub const ZERO: u16 = 2048;

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
/// Reads of the converter's flag before giving up. A conversion takes some 2 us.
const LOOKS: u32 = 1000;

/// Codes that the buffer surely reaches: 0.2 V from either end of 3.3 V (data sheet).
pub const SWING: [i32; 2] = [248, 3847];

/// If the converter does not answer for a code, the reading counts as 0.
pub fn test() -> Found {
    let adc = read_back::output_sense();
    let read = |code: u32| {
        // Without the mask an output of `render` would overwrite the code with zero force.
        mask::with_lower_tasks_masked(|| {
            // SAFETY: a documented value; enable is off.
            unsafe { (*pac::DAC::ptr()).dhr12r1().write(|w| w.bits(code)) };
            cortex_m::asm::delay(SETTLE);
            // By now any conversion that `render` has begun has ended.
            let _ = read_back::answer(adc);
            read_back::begin(adc);
            let read = (0..LOOKS).find_map(|_| read_back::answer(adc));
            Output::zero();
            read.map_or(0, u32::from)
        })
    };
    let codes = (0..STEPS).map(|n| LEAST + n * STEP).map(|code| [code, read(code)]);
    let worst = codes.max_by_key(|[code, read]| code.abs_diff(*read)).unwrap_or_default();
    Found::Output { worst, allowed: ALLOWED }
}
