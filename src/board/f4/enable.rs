//! The amplifier's enable line and the emergency stop: channel 3 and the break input of TIM1.
//!
//! The line follows the timer's main output enable (MOE), so hardware alone can switch it off:
//! * when the emergency stop opens, the break input clears MOE without any code;
//! * with `DBG_TIM1_STOP` the outputs are off while a debugger has the core halted (debugger.rs);
//! * the output watchdog clears MOE when no output has come for a while (output_watchdog.rs);
//! * one store clears MOE, from any task, the panic and the fault handlers.
//!
//! While MOE is clear, TIM1 drives its outputs to their idle level, low. Enable is then inactive. On a board with PWM
//! the force output then has no pulse. In reset the pins are inputs, so the enable line has a pull-down (4.7 kOhm, at
//! the amplifier).
//!
//! The first store to BDTR sets `LOCK` level 3 (RM0090 17.4.18, RM0390 16.4.18). This level freezes break input, idle
//! levels, polarities and output modes. It does not freeze MOE, counter, periods, compare values and the channels'
//! enable bits. The store comes after the board's file has set everything up. Until then the timer drives no pin.

use cortex_m::peripheral::DWT;
use stm32f4xx_hal::{
    pac,
    rcc::{Enable as _, Rcc, Reset},
};
use zwidth::contract;

/// BDTR with MOE clear, `LOCK` level 3, and idle levels that are driven. The break input is on and active high: the
/// switch of the stop is normally closed to ground, so an open switch means stop.
pub(super) const OFF: u32 = 0b11 << 8 | 1 << 10 | 1 << 11 | 1 << 12 | 1 << 13;
/// [`OFF`] with MOE set. While the break input is active, the hardware clears MOE again.
const ON: u32 = OFF | 1 << 15;

/// Sets MOE for a moment. Returns the level of `pin` while MOE is set, and its level afterwards. An open emergency stop
/// keeps MOE clear. Call it with the tasks masked and the force at zero.
pub(super) fn blink(pin: super::pin::BoardPin) -> (bool, bool) {
    // SAFETY: a documented value of the register.
    registers().bdtr().write(|w| unsafe { w.bits(ON) });
    cortex_m::asm::delay(32);
    let on = pin.is_high();
    <Enable as contract::Enable>::off();
    cortex_m::asm::delay(32);
    (on, pin.is_high())
}

/// Sets MOE, and returns the number of core cycles until hardware clears it. Returns `None` if MOE is still set after
/// `cycles`. An open emergency stop clears MOE at once. Call it with the tasks masked and the force at zero.
pub(super) fn drops_within(cycles: u32) -> Option<u32> {
    // SAFETY: a documented value of the register.
    registers().bdtr().write(|w| unsafe { w.bits(ON) });
    let begun = DWT::cycle_count();
    let dropped = loop {
        let passed = DWT::cycle_count().wrapping_sub(begun);
        if registers().bdtr().read().moe().bit_is_clear() {
            break Some(passed);
        }
        if passed > cycles {
            break None;
        }
    };
    <Enable as contract::Enable>::off();
    dropped
}

/// Flag in SR: the break input was active. It stays set until it is cleared.
const BREAK: u32 = 1 << 7;

/// TIM1's registers, for the few stores that any task or handler must be able to make.
pub(in crate::board) fn registers() -> &'static pac::tim1::RegisterBlock {
    // SAFETY: the address is TIM1's. Outside `init` this program only stores whole constants
    // into BDTR, SR, CR1 and CNT and compare values into CCR1 and CCR2, never a modified reading.
    unsafe { &*pac::TIM1::ptr() }
}

/// The enable line, on channel 3 of TIM1. The channel is always high, and MOE decides whether this level reaches the
/// pin.
pub struct Enable(());

impl Enable {
    /// Gives TIM1 a clock and resets it. In its reset state it drives no pin.
    pub fn new(rcc: &mut Rcc) -> Self {
        pac::TIM1::enable(rcc);
        pac::TIM1::reset(rcc);
        let tim1 = registers();
        // OC3M = 101, forced active; SAFETY: a documented value of the register.
        tim1.ccmr2_output().write(|w| unsafe { w.bits(0b101 << 4) });
        tim1.ccer().modify(|_, w| w.cc3e().set_bit());
        Self(())
    }
}

impl contract::Enable for Enable {
    fn on(&mut self) {
        // Writing 0 clears a flag; writing 1 does not change a flag. SAFETY: a documented value.
        registers().sr().write(|w| unsafe { w.bits(!BREAK) });
        // SAFETY: a documented value of the register.
        registers().bdtr().write(|w| unsafe { w.bits(ON) });
    }

    #[inline(always)]
    fn off() {
        // SAFETY: a documented value of the register.
        registers().bdtr().write(|w| unsafe { w.bits(OFF) });
    }

    #[inline(always)]
    fn is_on(&self) -> bool {
        registers().bdtr().read().moe().bit_is_set()
    }

    #[inline(always)]
    fn was_stopped(&self) -> bool {
        registers().sr().read().bits() & BREAK != 0
    }
}
