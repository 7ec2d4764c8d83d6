//! Measures the times of the encoder's edges. TIM3 captures the rising and falling edges of A on channel 1, and those
//! of B on channel 2.
//!
//! TIM3 has the clock and the input filter of TIM2, which counts the edges. So both timers see an edge with the same
//! delay. TIM3's polarity does not matter: `encoder -` changes only TIM2, and the direction of an edge follows from the
//! change of the count.

use stm32f4xx_hal::{
    gpio::PushPull,
    pac,
    rcc::{Enable, Rcc, Reset},
    timer::CPin,
};
use zwidth::velocity::{Captures, Edge, EdgeTimer};

use super::f4::encoder::{EdgeTimes, FILTER};

/// CCMR1: each channel captures its own input (`CCxS` = 01), behind the filter.
const INPUTS: u32 = 0b01 << 8 | 0b01 | FILTER << 12 | FILTER << 4;
/// CCER: both channels are on and capture rising and falling edges (`CCxE`, `CCxP`, `CCxNP`).
const BOTH_EDGES: u32 = 0b1011 << 4 | 0b1011;
/// Flags in SR. Each one means that its channel has an unread capture.
const CAPTURED: [u32; 2] = [1 << 1, 1 << 2];

/// The timer that captures the edges. `TICKS` is the number of its ticks per sample. Like TIM2 and TIM5, TIM3 runs at
/// half the core's clock.
pub struct Edges<const TICKS: u32> {
    timer: pac::TIM3,
    edges: EdgeTimer<TICKS>,
}

impl<const TICKS: u32> Edges<TICKS> {
    /// Starts to capture edges. `a` and `b` are pins of TIM3. They carry the same encoder signals as the pins of TIM2.
    pub fn new(
        timer: pac::TIM3,
        a: impl Into<<pac::TIM3 as CPin<0>>::Ch<PushPull>>,
        b: impl Into<<pac::TIM3 as CPin<1>>::Ch<PushPull>>,
        rcc: &mut Rcc,
    ) -> Self {
        let _pins: (<pac::TIM3 as CPin<0>>::Ch<_>, <pac::TIM3 as CPin<1>>::Ch<_>) =
            (a.into(), b.into());
        pac::TIM3::enable(rcc);
        pac::TIM3::reset(rcc);
        // SAFETY: documented values of the three registers.
        unsafe {
            timer.ccmr1_input().write(|w| w.bits(INPUTS));
            timer.ccer().write(|w| w.bits(BOTH_EDGES));
            timer.arr().write(|w| w.bits(EdgeTimer::<TICKS>::WRAP - 1));
        }
        timer.egr().write(|w| w.ug().set_bit());
        timer.cr1().write(|w| w.cen().set_bit());
        Self { timer, edges: EdgeTimer::new() }
    }
}

impl<const TICKS: u32> EdgeTimes for Edges<TICKS> {
    #[inline(always)]
    fn latest(&mut self, count: u32, counter: &pac::TIM2) -> Option<Edge> {
        let now = self.timer.cnt().read().cnt().bits();
        let up = counter.cr1().read().dir().bit_is_clear();
        let flags = self.timer.sr().read().bits();
        // Reading a capture clears its flag.
        let at = [
            (flags & CAPTURED[0] != 0).then(|| self.timer.ccr1().read().ccr().bits()),
            (flags & CAPTURED[1] != 0).then(|| self.timer.ccr2().read().ccr().bits()),
        ];
        self.edges.update(count, &Captures { now, up, at })
    }
}
