//! The output watchdog switches the enable line off when the program stops writing outputs.
//!
//! TIM8 counts microseconds from the last output. At [`OUTPUT_WATCHDOG_US`] its update event requests a transfer from
//! DMA2 (stream 1, channel 7: TIM8_UP, RM0090 table 43, RM0390 9.3.3). DMA2 then stores into TIM1's BDTR the word that
//! `off` stores there. This clears MOE, and only `arm` sets it again. This path uses no core, no interrupt and no pin:
//!
//! ```text
//! outputs    | | | | |                                      (1 ms)
//! TIM8 count /|/|/|/|/------| 2500: update event, DMA2 stores "off"
//! enable     ¯¯¯¯¯¯¯¯¯¯¯¯¯¯¯¯|_________________________
//! ```
//!
//! The stream is circular with one item, so each further update stores the same word. In direct mode (FCR as reset) the
//! word is fetched before its request. DMA1 cannot make this transfer: its peripheral port reaches only APB1, and TIM1
//! is on APB2 (RM0090 2.1, figure 1). In a debugger's halt TIM8 and DMA2 run on (debugger.rs). So after a halt longer
//! than [`OUTPUT_WATCHDOG_US`], the force stays off until `arm`.

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use stm32f4xx_hal::{
    pac,
    rcc::{Enable, Rcc, Reset},
};
use zwidth::{
    contract::{self, RATE_HZ},
    period::OUTPUT_WATCHDOG_US,
    safety::RateWatch,
};

use super::enable;

/// The word that DMA2 stores. It is in RAM, which DMA2 reaches on all these chips. Nothing writes it.
static OFF: AtomicU32 = AtomicU32::new(enable::OFF);

/// The timer's clock after its prescaler, in Hz.
const TICK_HZ: u32 = 1_000_000;
const _: () = assert!(OUTPUT_WATCHDOG_US < 1 << 16, "TIM8 has 16 bits");

/// CR1: the timer counts. Only an overflow requests a transfer (`URS`). The event that loads the prescaler at set-up
/// requests none.
const RUNNING: u32 = 1 << 2 | 1;
/// DIER: the update event requests a DMA transfer (`UDE`). It requests no interrupt.
const REQUESTS: u32 = 1 << 8;
/// CR of the stream: channel 7, very high priority, words in memory and in the peripheral, fixed addresses, circular,
/// from memory to peripheral.
const STREAM: u32 = 7 << 25 | 0b11 << 16 | 0b10 << 13 | 0b10 << 11 | 1 << 8 | 0b01 << 6;
/// Number of the DMA stream.
const NUMBER: usize = 1;

/// Flag in SR (`UIF`): the timer has overflown.
const OVERFLOWN: u32 = 1;

/// TIM8. Its clock comes from APB2, but the clock of the sample timer comes from APB1. `rate_is_wrong` compares the
/// two. So it finds a changed divider of one bus, and a count that stands still.
pub struct OutputWatchdog {
    timer: pac::TIM8,
    rate: RateWatch<{ TICK_HZ / RATE_HZ }>,
    /// Number of the sample at which the last output was written.
    sample: u32,
}

impl OutputWatchdog {
    /// Starts the watchdog. Call it when TIM1's BDTR has the value that `off` stores.
    pub fn new(timer: pac::TIM8, dma: &pac::DMA2, rcc: &mut Rcc) -> Self {
        pac::DMA2::enable(rcc);
        pac::DMA2::reset(rcc);
        pac::TIM8::enable(rcc);
        pac::TIM8::reset(rcc);
        let clock_hz = rcc.clocks.timclk2().raw();
        let stream = dma.st(NUMBER);
        // SAFETY: documented values; the two addresses are those of a register and of a static word.
        unsafe {
            stream.par().write(|w| w.bits(enable::registers().bdtr().as_ptr() as u32));
            stream.m0ar().write(|w| w.bits(OFF.as_ptr() as u32));
            stream.ndtr().write(|w| w.bits(1));
            stream.cr().write(|w| w.bits(STREAM));
            stream.cr().write(|w| w.bits(STREAM | 1));
            timer.psc().write(|w| w.bits(clock_hz / TICK_HZ - 1));
            timer.arr().write(|w| w.bits(OUTPUT_WATCHDOG_US - 1));
            timer.cr1().write(|w| w.bits(RUNNING & !1));
            timer.egr().write(|w| w.ug().set_bit());
            timer.dier().write(|w| w.bits(REQUESTS));
            timer.cr1().write(|w| w.bits(RUNNING));
        }
        Self { timer, rate: RateWatch::default(), sample: 0 }
    }
}

/// Starts the count again from zero. Each output does this.
#[inline(always)]
pub(super) fn begin_anew() {
    // SAFETY: the address is TIM8's. Any 16-bit value is a valid count, and nothing else writes it.
    unsafe { (*pac::TIM8::ptr()).cnt().write(|w| w.bits(0)) };
}

/// Whether the word in RAM is still the word that switches off.
#[inline(always)]
pub(super) fn stores_off() -> bool {
    OFF.load(Relaxed) == enable::OFF
}

impl contract::OutputWatchdog for OutputWatchdog {
    #[inline(always)]
    fn renew(&mut self, sample: u32, halted: bool) {
        let passed = self.timer.cnt().read().bits();
        let acted = self.timer.sr().read().bits() & OVERFLOWN != 0;
        begin_anew();
        // SAFETY: flags are cleared by writing 0.
        self.timer.sr().write(|w| unsafe { w.bits(0) });
        let samples = sample.wrapping_sub(self.sample);
        self.sample = sample;
        self.rate.follow(passed, samples, halted || acted);
    }

    #[inline(always)]
    fn rate_is_wrong(&self) -> bool {
        self.rate.is_wrong()
    }
}
