//! The force output is DAC1 on PA4. Its 12 bits stand for 0 to 3.3 V, but its buffer reaches only some 0.2 to 3.1 V.
//! Zero force is in the middle of the range.
//!
//! The buffer is on. With the buffer off the output impedance would be 15 kOhm. With the buffer on the output settles
//! in at most 6 us (data sheet, 5 kOhm and 50 pF). There is no preload: the output changes one APB1 cycle after the
//! store.

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
    /// Starts the DAC with the code of zero force.
    pub fn new(dac: pac::DAC, pin: PA4<Analog>, rcc: &mut Rcc) -> Self {
        let mut channel = dac.constrain(pin, rcc);
        channel.set_value(ZERO);
        channel.enable();
        Self(channel)
    }
}

impl ForceOutput for Output {
    /// Writes the code to the DAC. The control core has clamped it to 1 ..= 4095.
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

    /// Does nothing, because a DAC has no clock to start.
    fn start() {}
}

/// The self-test sets the codes `LEAST + n * STEP`, for `n` from 0 to `STEPS - 1`. The buffer can reach all of them
/// (0.2 to 3.1 V).
const LEAST: u32 = 320;
const STEP: u32 = 230;
const STEPS: u32 = 16;
/// The largest allowed difference between the written code and the code that the ADC reads: 1 % of the range. It covers
/// offset, gain and linearity of both converters (data sheets).
const ALLOWED: u32 = 40;

/// Number of core cycles until the output has settled, 10 us.
const SETTLE: u32 = 1800;
/// Number of times that the ADC's flag is read before the test gives up. A conversion takes some 2 us.
const LOOKS: u32 = 1000;

/// The lowest and the highest code that the buffer surely reaches. They are 0.2 V away from 0 V and from 3.3 V (data
/// sheet).
pub const SWING: [i32; 2] = [248, 3847];

/// Sets the test codes and reads each one back with the ADC. If the ADC does not answer for a code, the reading counts
/// as 0.
pub fn test() -> Found {
    let adc = read_back::output_sense();
    let read = |code: u32| {
        // `render` is masked. Otherwise its next output would overwrite the code with that of zero force.
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
