//! Effects of a debugger on the board, and the detection of a halt of the core.
//!
//! While the core is halted, TIM1 switches its outputs off. TIM1 and the sampling timer stand still, so they stay in
//! phase. The watchdog and TIM6 run on. The manuals say that the outputs are off "as if" MOE were reset. If MOE is only
//! masked, the last force acts again with the first instruction after the halt. The core has a flag that shows a halt
//! (DFSR), but debuggers clear it. So the program detects a halt by the time that passes without samples.

use stm32f4xx_hal::{
    pac,
    rcc::{Enable, Rcc, Reset},
};
use zwidth::{
    contract::DebugHalts,
    safety::{HaltWatch, RateWatch},
};

/// Bits of the timers on APB1 that stop in a halt. They are TIM5 (bit 3) and TIM3 (bit 1). TIM3 must stay in phase with
/// TIM5 if it captures edges. TIM6 (bit 4) and the watchdog (bit 12) run on.
const STOPPED_APB1: u32 = 1 << 3 | 1 << 1;
/// Bit of the timer on APB2 that stops in a halt. It is TIM1.
const STOPPED_APB2: u32 = 1;

/// TIM6, which counts on while the core is halted.
pub struct Halts {
    watch: HaltWatch,
    rate: RateWatch<{ HaltWatch::TICKS_PER_SAMPLE }>,
    /// TIM6's count and the sample's number at the last check of the rate. `halted` says whether a halt was found since
    /// then.
    looked: (u16, u64),
    halted: bool,
}

impl Halts {
    /// Starts TIM6. `clock_hz` is the clock of the timers on APB1.
    pub fn new(timer: pac::TIM6, clock_hz: u32, rate_hz: u32, rcc: &mut Rcc) -> Self {
        pac::TIM6::enable(rcc);
        pac::TIM6::reset(rcc);
        let ticks = clock_hz / (rate_hz * HaltWatch::TICKS_PER_SAMPLE);
        // SAFETY: any 16-bit value is a prescaler.
        timer.psc().write(|w| unsafe { w.bits(ticks - 1) });
        timer.egr().write(|w| w.ug().set_bit());
        timer.cr1().write(|w| w.cen().set_bit());
        Self {
            watch: HaltWatch::default(),
            rate: RateWatch::default(),
            looked: (0, 0),
            halted: true,
        }
    }
}

impl DebugHalts for Halts {
    #[inline(always)]
    fn since_the_last(&mut self, sample: u64, period: u32) -> bool {
        stop_with_the_core();
        let halted = self.watch.found(Self::clock(), sample, period);
        self.halted |= halted;
        halted
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "a 16-bit counter")]
    fn clock() -> u16 {
        // SAFETY: reading the count has no side effect.
        unsafe { (*pac::TIM6::ptr()).cnt().read().bits() as u16 }
    }

    #[inline(always)]
    fn rate_is_wrong(&mut self) -> bool {
        let (ticks, sample) = self.watch.last();
        let (ticks_before, before) = core::mem::replace(&mut self.looked, (ticks, sample));
        let passed = ticks.wrapping_sub(ticks_before).into();
        #[expect(clippy::cast_possible_truncation, reason = "a few")]
        let samples = sample.wrapping_sub(before) as u32;
        self.rate.follow(passed, samples, core::mem::take(&mut self.halted));
        self.rate.is_wrong()
    }
}

/// Sets the bits for the timers that stop in a halt. It is called with every output, because a debugger's script may
/// write other bits. For example, OpenOCD's script for these chips also stops the watchdog.
#[inline(always)]
fn stop_with_the_core() {
    // SAFETY: documented values of two registers that nothing else in this program writes.
    unsafe {
        let dbgmcu = &*pac::DBGMCU::ptr();
        dbgmcu.apb1_fz().write(|w| w.bits(STOPPED_APB1));
        dbgmcu.apb2_fz().write(|w| w.bits(STOPPED_APB2));
    }
}

/// Keeps the debug clock on while the core sleeps. Without it several probes lose RTT.
pub(in crate::board) fn set_up(dbgmcu: &pac::DBGMCU) {
    dbgmcu.cr().modify(|_, w| w.dbg_sleep().set_bit());
    stop_with_the_core();
}
