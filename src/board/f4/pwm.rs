//! The force output is a sign-magnitude PWM of TIM1. Channel 1 carries the magnitude, channel 2 the sign.
//!
//! The PWM runs at 40 kHz, so a sample has four PWM periods. They are in phase with the sampling timer, and begin
//! [`LEAD_CYCLES`] after it. Both compare registers are preloaded. The sign is itself a PWM of 0 or 100 %. No update
//! comes between the two stores of a command, so the whole command acts with the next PWM period. A command that is
//! written within [`LEAD_CYCLES`] of its sample acts [`LEAD_CYCLES`] after the sample. A command that is written after
//! that time acts one PWM period (25 us) later.

use stm32f4xx_hal::{gpio::PushPull, pac, timer::CPin};
use zwidth::{contract::ForceOutput, self_test::Found, units::OutputCode};

use super::super::common::mask;
use super::f4::{enable, pin::BoardPin};

/// PWM periods per sample.
pub const PER_SAMPLE: u32 = 4;
/// Core cycles from the sampling timer's update to the PWM timer's update. `tests/elf/control` checks that the
/// registers hold every command before the PWM timer's update.
pub const LEAD_CYCLES: u32 = 2352; // 14 us

/// CR1 while the timer runs: the counter is enabled, and the period is preloaded.
const RUNNING: u32 = 1 | 1 << 7;
/// Bit of CR1 that blocks update events.
const UPDATE_DISABLE: u32 = 1 << 1;

pub struct Output(());

impl Output {
    /// Sets up the PWM with `steps` timer ticks per period and zero force. TIM1 must already have its clock, and must
    /// not run yet. A period must be longer than [`LEAD_CYCLES`], because of the count at which `start` starts the
    /// timer.
    pub fn new(
        magnitude: impl Into<<pac::TIM1 as CPin<0>>::Ch<PushPull>>,
        sign: impl Into<<pac::TIM1 as CPin<1>>::Ch<PushPull>>,
        steps: u16,
    ) -> Self {
        let _pins = (magnitude.into(), sign.into());
        let tim1 = enable::registers();
        Self::zero();
        // SAFETY: documented values: the period; PWM mode 1 with preload on channels 1 and 2.
        unsafe {
            tim1.arr().write(|w| w.bits(u32::from(steps) - 1));
            tim1.ccmr1_output().write(|w| w.bits(0b0110_1000 << 8 | 0b0110_1000));
        }
        tim1.ccer().modify(|_, w| w.cc1e().set_bit().cc2e().set_bit());
        tim1.cr1().write(|w| w.arpe().set_bit());
        tim1.egr().write(|w| w.ug().set_bit());
        Self(())
    }
}

impl ForceOutput for Output {
    /// Writes the code. It acts from the next PWM period on. The control core has clamped it to +-steps.
    #[inline(always)]
    fn write(&mut self, command: OutputCode, mirrored: bool) {
        let code = command.code();
        let sign = if (code < 0) != mirrored { u32::from(u16::MAX) } else { 0 };
        let cr1 = enable::registers().cr1();
        // If an update came between the two stores, the new magnitude would have the old sign for one period. So
        // updates are blocked during the two stores. SAFETY: documented values.
        unsafe {
            cr1.write(|w| w.bits(RUNNING | UPDATE_DISABLE));
            set(code.unsigned_abs(), sign);
            cr1.write(|w| w.bits(RUNNING));
        }
    }

    /// Starts the timer so that it updates [`LEAD_CYCLES`] after the sampling timer. Start the sampling timer right
    /// after this.
    fn start() {
        let tim1 = enable::registers();
        let ahead = tim1.arr().read().bits() + 1 - LEAD_CYCLES;
        // SAFETY: below the period; a documented value.
        unsafe {
            tim1.cnt().write(|w| w.bits(ahead));
            tim1.cr1().write(|w| w.bits(RUNNING));
        }
    }

    /// Sets zero force. It acts from the next PWM period on.
    #[inline(always)]
    fn zero() {
        set(0, 0);
    }
}

#[inline(always)]
fn set(magnitude: u32, sign: u32) {
    let tim1 = enable::registers();
    // SAFETY: any 16-bit value is a compare value; above the period the output is constantly high.
    unsafe {
        tim1.ccr1().write(|w| w.bits(magnitude));
        tim1.ccr2().write(|w| w.bits(sign));
    }
}

/// The pins of magnitude and sign.
const PINS: [BoardPin; 2] = [BoardPin::new('E', 9), BoardPin::new('E', 11)];
/// Distance between two codes that the self-test sets.
const STEP: usize = 600;

/// Sets codes with enable off, and reads the compare registers back. If one of the two pins does not stay low, all bits
/// of the reading are ones.
pub fn test() -> Found {
    let read = |code: u32| {
        // `render` is masked. Otherwise its next output would overwrite the code with that of zero force.
        mask::with_lower_tasks_masked(|| {
            set(code, code);
            let tim1 = enable::registers();
            let pair = [tim1.ccr1().read().bits(), tim1.ccr2().read().bits()];
            let low = PINS.iter().all(|pin| !pin.is_high());
            set(0, 0);
            if low {
                pair.into_iter().max_by_key(|back| back.abs_diff(code)).unwrap_or(0)
            } else {
                u32::MAX
            }
        })
    };
    let top = enable::registers().arr().read().bits() + 1;
    let codes = (0..=top).step_by(STEP).map(|code| [code, read(code)]);
    let worst = codes.max_by_key(|[code, read]| code.abs_diff(*read)).unwrap_or_default();
    Found::Output { worst, allowed: 0 }
}
