//! The encoder: TIM2 counts both edges of A and B in 32 bits, four counts per line.

use core::sync::atomic::Ordering::Relaxed;

use stm32f4xx_hal::{gpio::PushPull, pac, qei::Qei, rcc::Rcc, timer::CPin};
use zwidth::{
    contract,
    velocity::{Edge, Senses},
};

use super::set_up;

/// `ICxF` = 3: a new level counts after 8 equal samples at the timer clock (half the core's), 95 ns at 168 MHz. Shorter
/// glitches do not count. A and B may each change up to ten million times a second.
pub(in crate::board) const FILTER: u32 = 0b0011;

pub trait EdgeTimes {
    /// Returns the last edge that `count` includes. `count` was read from `counter` just before.
    fn latest(&mut self, count: u32, counter: &pac::TIM2) -> Option<Edge>;
}

/// For a board that does not measure edge times.
impl EdgeTimes for () {
    #[inline(always)]
    fn latest(&mut self, _: u32, _: &pac::TIM2) -> Option<Edge> {
        None
    }
}

pub struct Encoder<E = ()> {
    timer: pac::TIM2,
    edges: E,
}

impl<E> Encoder<E> {
    /// Sets up the counter at 0. It does not count yet.
    pub fn new(
        timer: pac::TIM2,
        a: impl Into<<pac::TIM2 as CPin<0>>::Ch<PushPull>>,
        b: impl Into<<pac::TIM2 as CPin<1>>::Ch<PushPull>>,
        edges: E,
        rcc: &mut Rcc,
    ) -> Self {
        let (timer, _pins) = Qei::new(timer, (a, b), rcc).release();
        timer.cr1().modify(|_, w| w.cen().clear_bit());
        timer.ccmr1_input().modify(|r, w| {
            // SAFETY: all values of the two filter fields are allowed; the rest stays.
            unsafe { w.bits(r.bits() | FILTER << 4 | FILTER << 12) }
        });
        timer.cnt().reset();
        Self { timer, edges }
    }
}

impl<E: EdgeTimes> contract::Encoder for Encoder<E> {
    fn start() {
        // SAFETY: the address is TIM2's. No sample has come yet, and after this store nothing writes this register.
        let timer = unsafe { &*pac::TIM2::ptr() };
        timer.cr1().modify(|_, w| w.cen().set_bit());
    }

    #[inline(always)]
    fn count(&self) -> u32 {
        self.timer.cnt().read().bits()
    }

    #[inline(always)]
    fn sense(&mut self) -> (u32, Senses) {
        let count = self.count();
        (count, Senses { edge: self.edges.latest(count, &self.timer), ..Senses::NONE })
    }

    /// Sets the direction of counting by the polarity of TI1 (reference manual, TIMx_CCER, CC1P). The zero of the
    /// position is lost.
    fn turn(reversed: bool) {
        // SAFETY: of this timer `sample` only reads the counter, and nothing else writes this register.
        let timer = unsafe { &*pac::TIM2::ptr() };
        set_up::ENCODER_TURNED.store(reversed, Relaxed);
        timer.ccer().modify(|_, w| w.cc1p().bit(reversed));
    }
}
