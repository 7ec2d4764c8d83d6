//! ADC1 reads the pin of the DAC (PA4, ADC12_IN4). ADC2 reads the voltage with which the amplifier reports its current
//! (PB0, ADC12_IN8).
//!
//! The program starts one conversion at a time (RM0390 13.3.4 and 13.13.3; RM0090 13.3.4 and 13.13.3). A conversion
//! takes 28 cycles of sampling and 12 cycles of conversion at 22.5 or 21 MHz, some 1.8 us. A conversion sets a flag at
//! its end, and reading its result clears the flag. So a converter that stands still gives no further readings.

use core::marker::PhantomData;

use stm32f4xx_hal::{pac, rcc::Rcc};
use zwidth::{contract::ReadBack, safety::Readings};

use super::Wiring;

/// Bits of the control register CR2. `ON` switches the converter on, `BEGIN` starts a conversion.
const ON: u32 = 1;
const BEGIN: u32 = 1 << 30 | ON;
/// Flag in SR at the end of a conversion.
const DONE: u32 = 1 << 1;
/// Value of a channel's three bits in SMPR2, for 28 cycles of sampling.
const SAMPLING: u32 = 0b010;

pub struct Converters<W>(PhantomData<W>);

/// ADC2, which reads the motor's current. Its registers have the layout of ADC1's.
#[inline(always)]
fn current_sense() -> &'static pac::adc1::RegisterBlock {
    // SAFETY: the address is ADC2's, which only this file uses.
    unsafe { &*pac::ADC2::ptr() }
}

/// ADC1, which reads the DAC's pin.
#[inline(always)]
pub fn output_sense() -> &'static pac::adc1::RegisterBlock {
    // SAFETY: the address is ADC1's, which this file and the self-test use.
    unsafe { &*pac::ADC1::ptr() }
}

impl<W: Wiring> Converters<W> {
    /// Switches ADC2 on, and ADC1 if the force output can be read. The clock of the converters is a quarter of APB2's
    /// clock.
    pub fn new(rcc: &mut Rcc) -> Self {
        rcc.apb2enr().modify(|_, w| w.adc1en().set_bit().adc2en().set_bit());
        // SAFETY: documented values: the clock's divider; one conversion of channel 4 and of channel 8; on.
        unsafe {
            (*pac::ADC_COMMON::ptr()).ccr().write(|w| w.bits(0b01 << 16));
            if W::SWING.is_some() {
                set_up(output_sense(), 4);
            }
            set_up(current_sense(), 8);
        }
        Self(PhantomData)
    }
}

/// # Safety
/// Nothing else uses that converter.
unsafe fn set_up(adc: &pac::adc1::RegisterBlock, channel: u32) {
    // SAFETY: documented values.
    unsafe {
        adc.smpr2().write(|w| w.bits(SAMPLING << (3 * channel)));
        adc.sqr1().write(|w| w.bits(0));
        adc.sqr3().write(|w| w.bits(channel));
        adc.cr2().write(|w| w.bits(ON));
    }
}

#[inline(always)]
pub fn begin(adc: &pac::adc1::RegisterBlock) {
    // SAFETY: a documented value.
    adc.cr2().write(|w| unsafe { w.bits(BEGIN) });
}

/// Returns the reading, or `None` if the conversion has not ended yet.
#[inline(always)]
pub fn answer(adc: &pac::adc1::RegisterBlock) -> Option<u16> {
    let done = adc.sr().read().bits() & DONE != 0;
    #[expect(clippy::cast_possible_truncation, reason = "12 bits")]
    done.then(|| adc.dr().read().bits() as u16)
}

impl<W: Wiring> ReadBack for Converters<W> {
    const SWING: Option<[i32; 2]> = W::SWING;

    #[inline(always)]
    fn begin(&mut self) {
        if W::SWING.is_some() {
            begin(output_sense());
        }
        begin(current_sense());
    }

    #[inline(always)]
    fn finish(&mut self) -> Readings {
        let output = if W::SWING.is_some() { answer(output_sense()) } else { None };
        Readings { output, current: answer(current_sense()) }
    }
}
