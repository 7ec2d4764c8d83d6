//! The encoder: TIM2 counts both edges of A and B in 32 bits, four counts per line.

use stm32f4xx_hal::{pac, qei::Qei, rcc::Rcc, timer::CPin};
use zwidth::velocity::Senses;

/// `ICxF` = 3: a level counts after 8 equal samples at the timer clock, half the core's: 95 ns at
/// 168 MHz. Shorter glitches do not count; A and B may each change up to ten million times a second.
pub(in crate::board) const FILTER: u32 = 0b0011;

/// The counter of the quadrature decoder.
pub struct Encoder {
    timer: pac::TIM2,
    #[cfg(all(feature = "nucleo-f446re", feature = "time-stamps"))]
    edges: super::edges::Edges,
}

impl Encoder {
    /// Starts counting from 0 at the present position.
    pub fn new(
        timer: pac::TIM2,
        a: impl Into<<pac::TIM2 as CPin<0>>::Ch<stm32f4xx_hal::gpio::PushPull>>,
        b: impl Into<<pac::TIM2 as CPin<1>>::Ch<stm32f4xx_hal::gpio::PushPull>>,
        #[cfg(all(feature = "nucleo-f446re", feature = "time-stamps"))] edges: super::edges::Edges,
        rcc: &mut Rcc,
    ) -> Self {
        let (timer, _pins) = Qei::new(timer, (a, b), rcc).release();
        timer.cr1().modify(|_, w| w.cen().clear_bit());
        timer.ccmr1_input().modify(|r, w| {
            // SAFETY: all values of the two filter fields are allowed; the rest stays.
            unsafe { w.bits(r.bits() | FILTER << 4 | FILTER << 12) }
        });
        timer.cnt().reset();
        timer.cr1().modify(|_, w| w.cen().set_bit());
        Self {
            timer,
            #[cfg(all(feature = "nucleo-f446re", feature = "time-stamps"))]
            edges,
        }
    }

    /// The count now; wraps at 2^32.
    #[inline(always)]
    pub fn count(&self) -> u32 {
        self.timer.cnt().read().bits()
    }

    /// The count now, first of all, and what else this board senses. Once per sample.
    #[inline(always)]
    pub fn sense(&mut self) -> (u32, Senses) {
        let count = self.count();
        #[cfg(all(feature = "nucleo-f446re", feature = "time-stamps"))]
        let senses = Senses { edge: self.edges.latest(count, &self.timer), ..Senses::NONE };
        #[cfg(not(all(feature = "nucleo-f446re", feature = "time-stamps")))]
        let senses = Senses::NONE;
        (count, senses)
    }
}

/// Turns the counter's direction round, or back: TI1's polarity (reference manual, TIMx_CCER, CC1P).
/// The count goes on from where it is, so this is no jump; but what is zero is lost.
pub fn turn(reversed: bool) {
    // SAFETY: of this timer `sample` only reads the counter, and nothing else writes this register.
    let timer = unsafe { &*pac::TIM2::ptr() };
    timer.ccer().modify(|_, w| w.cc1p().bit(reversed));
}
