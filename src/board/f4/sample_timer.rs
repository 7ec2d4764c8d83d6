//! The clock of the control loop. TIM5 requests samples at exactly equal intervals.

use stm32f4xx_hal::{
    pac,
    rcc::{Enable, Rcc, Reset},
};
use zwidth::contract;

use super::self_test;

/// The sampling timer. Its update event requests the interrupt `TIM5`, which is the sampling task.
pub struct SampleTimer(pac::TIM5);

impl SampleTimer {
    /// Sets up the timer with `ticks` per sample. Its clock is half the core's. It does not run yet.
    pub fn new(timer: pac::TIM5, ticks: u32, rcc: &mut Rcc) -> Self {
        pac::TIM5::enable(rcc);
        pac::TIM5::reset(rcc);
        // SAFETY: any 32-bit value is a valid period.
        timer.arr().write(|w| unsafe { w.bits(ticks.wrapping_sub(1)) });
        timer.cr1().write(|w| w.urs().set_bit());
        timer.egr().write(|w| w.ug().set_bit());
        timer.dier().write(|w| w.uie().set_bit());
        Self(timer)
    }
}

impl contract::SampleTimer for SampleTimer {
    fn start() {
        // SAFETY: the address is TIM5's. After this store nothing writes this register.
        let timer = unsafe { &*pac::TIM5::ptr() };
        timer.cr1().modify(|_, w| w.cen().set_bit());
    }

    #[inline(always)]
    fn is_late() -> bool {
        // SAFETY: the address is TIM5's, and this function only reads.
        let timer = unsafe { &*pac::TIM5::ptr() };
        timer.cnt().read().bits() > timer.arr().read().bits() / 5 * 2
    }

    #[inline(always)]
    fn acknowledge(&mut self) {
        self_test::note_reading(self.0.cnt().read().bits());
        // SAFETY: flags are cleared by writing 0, and 1 leaves them alone.
        self.0.sr().write(|w| unsafe { w.bits(!1) });
    }
}
