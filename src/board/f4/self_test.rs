//! The self-test of chip and board. It runs with the force off. The board cannot arm during a part of the test, because
//! the console runs the part, and only the console gives the order to arm.

use core::{
    marker::PhantomData,
    sync::atomic::{AtomicU32, Ordering::Relaxed},
};

use stm32f4xx_hal::{pac, rcc::Rcc};
use zwidth::{
    contract,
    period::OUTPUT_WATCHDOG_US,
    self_test::{Delays, EDGES, Found, Part},
};

use super::{Wiring, enable, output_watchdog, pin::BoardPin, watchdog};
use crate::board::common::mask;

/// TIM5's count when `sample` last read the encoder's counter.
static READ_AT: AtomicU32 = AtomicU32::new(0);

/// Notes TIM5's count. `sample` calls it right after it has read the encoder.
#[inline(always)]
pub(super) fn note_reading(ticks: u32) {
    READ_AT.store(ticks, Relaxed);
}

/// The longest time that the test waits for the output watchdog, in us.
const LONGEST_US: u32 = OUTPUT_WATCHDOG_US * 3 / 2;

/// The pins of port C from which two wires lead to the encoder's inputs A and B.
const WIRES: [u32; 2] = [6, 8];

/// The self-test. The program compares the clock gates of all peripherals at every output. So the peripherals of the
/// self-test are switched on at set-up and stay on. The self-test uses the ADC of `read_back.rs`.
pub struct SelfTest<W>(PhantomData<W>);

impl<W: Wiring> SelfTest<W> {
    /// Switches on the clock of port C, whose pins make the edges for the encoder's inputs.
    pub fn new(rcc: &mut Rcc) -> Self {
        rcc.ahb1enr().modify(|_, w| w.gpiocen().set_bit());
        Self(PhantomData)
    }
}

impl<W: Wiring> contract::SelfTest for SelfTest<W> {
    fn test(&mut self, part: Part) -> Found {
        // At an output period of one sample the parts follow each other without a pause. Together they take as long as
        // the watchdog waits. So each part restarts the watchdog.
        watchdog::renew();
        match part {
            Part::Chip => {
                // SAFETY: the address is DBGMCU's, and this code only reads.
                let id = unsafe { (*pac::DBGMCU::ptr()).idcode().read().dev_id().bits() };
                Found::Chip { id: id.into(), expected: W::CHIP }
            }
            Part::BrownOutReset => {
                // SAFETY: the address is the flash controller's, and this code only reads.
                let options = unsafe { (*pac::FLASH::ptr()).optcr().read().bits() };
                Found::BrownOutReset { level: options >> 2 & 3, expected: W::BROWN_OUT_RESET }
            }
            Part::Image => image(),
            Part::Enable => enabled(W::ENABLE, || !W::STOP.is_high()),
            Part::OutputWatchdog => without_outputs(W::CORE_HZ, || !W::STOP.is_high()),
            Part::Output => W::test_output(),
            Part::Encoder => counted(W::CORE_HZ),
            Part::Delay => delays(W::CORE_HZ),
            Part::Clock => Found::Clock(oscillator_hz(W::CORE_HZ / 2)),
        }
    }
}

/// Allowed addresses of the image in flash. `RAM` has the allowed addresses for the top of its stack.
const FLASH: core::ops::Range<u32> = 0x0800_0000..0x0808_0000;
const RAM: core::ops::RangeInclusive<u32> = 0x2000_0000..=0x2002_0000;

fn image() -> Found {
    let image = crate::board::image();
    let [vectors, ..] = image.parts;
    // SAFETY: the address is the core's, and this code only reads.
    let in_force = unsafe { (*cortex_m::peripheral::SCB::PTR).vtor.read() };
    let stack = vectors.first().is_some_and(|top| RAM.contains(top) && top % 8 == 0);
    let leads = |&vector: &u32| vector == 0 || vector & 1 == 1 && FLASH.contains(&vector);
    let rest = vectors.iter().skip(1).position(|vector| !leads(vector));
    let bad =
        if in_force != vectors.as_ptr() as u32 || !stack { Some(0) } else { rest.map(|n| n + 1) };
    let bad_vector = bad.and_then(|number| u32::try_from(number).ok());
    Found::Image { bad_vector, crc: image.checksum(), sealed: image.sealed() }
}

fn enabled(pin: BoardPin, stop_closed: fn() -> bool) -> Found {
    mask::with_lower_tasks_masked(|| {
        crate::board::off();
        cortex_m::asm::delay(32);
        let off = pin.is_high();
        let stop_closed = stop_closed();
        let (on, after) = enable::blink(pin);
        Found::Enable { stop_closed, off, on, after }
    })
}

/// Measures how long enable stays on when no output comes. `render` is masked for this, and the force is zero.
fn without_outputs(core_hz: u32, stop_closed: fn() -> bool) -> Found {
    let mhz = core_hz / 1_000_000;
    mask::with_lower_tasks_masked(|| {
        let stop_closed = stop_closed();
        output_watchdog::begin_anew();
        let dropped = enable::drops_within(LONGEST_US * mhz);
        Found::OutputWatchdog { stop_closed, micros: dropped.map(|cycles| cycles / mhz) }
    })
}

/// Core cycles that the loop waits between two edges. Together with the loop itself, two edges are 22 to 30 cycles
/// apart. The input filter needs at least 16 cycles.
const BETWEEN_EDGES: u32 = 6;

/// Makes edges of A and B alternately, and counts them. Two edges are a fifth of a microsecond apart, or more after an
/// interrupt.
fn counted(core_hz: u32) -> Found {
    // SAFETY: the addresses are those of GPIOC and TIM2. Of GPIOC only this function uses the two pins. Of TIM2 it only
    // reads the count.
    let (port, counter) = unsafe { (&*pac::GPIOC::ptr(), &*pac::TIM2::ptr()) };
    let [a, b] = WIRES;
    let (high, low) = (|pin: u32| 1 << pin, |pin: u32| 1 << (16 + pin));
    // SAFETY: two pins are set low, then made outputs. All other pins stay unchanged.
    unsafe {
        port.bsrr().write(|w| w.bits(low(a) | low(b)));
        port.moder().modify(|r, w| w.bits(r.bits() | 0b01 << (2 * a) | 0b01 << (2 * b)));
    }
    cortex_m::asm::delay(core_hz / 1_000_000);
    let count = || counter.cnt().read().bits();
    let edges = |order: [u32; 4]| {
        for _ in 0..EDGES / 4 {
            for level in order {
                // SAFETY: the two pins only.
                port.bsrr().write(|w| unsafe { w.bits(level) });
                cortex_m::asm::delay(BETWEEN_EDGES);
            }
        }
    };
    let (from, begun) = (count(), cortex_m::peripheral::DWT::cycle_count());
    edges([high(a), high(b), low(a), low(b)]);
    let cycles = cortex_m::peripheral::DWT::cycle_count().wrapping_sub(begun);
    cortex_m::asm::delay(core_hz / 1_000_000);
    let there = count().wrapping_sub(from).cast_signed();
    edges([high(b), high(a), low(b), low(a)]);
    cortex_m::asm::delay(core_hz / 1_000_000);
    let back = count().wrapping_sub(from).cast_signed();
    // SAFETY: the two pins are inputs again.
    port.moder().modify(|r, w| unsafe { w.bits(r.bits() & !(0b11 << (2 * a) | 0b11 << (2 * b))) });
    let edges = u64::from(EDGES) * u64::from(core_hz);
    let rate_hz = edges.checked_div(u64::from(cycles)).and_then(|hz| u32::try_from(hz).ok());
    let rate_hz = rate_hz.unwrap_or(0);
    Found::Encoder { sent: EDGES, there, back, rate_hz, least_hz: 0 }
}

/// Measures the delay from the sample's request until the encoder is read. It collects the counts that `sample` notes,
/// until there are enough.
fn delays(core_hz: u32) -> Found {
    let mut times = [0; Delays::SAMPLES];
    let mut taken = 0;
    for time in &mut times {
        READ_AT.store(u32::MAX, Relaxed);
        let looks = core_hz / zwidth::contract::RATE_HZ; // more than a period's cycles
        let noted = (0..looks).map(|_| READ_AT.load(Relaxed)).find(|&ticks| ticks != u32::MAX);
        let Some(noted) = noted else { break };
        *time = noted;
        taken += 1;
    }
    Found::Delay(Delays::of(times.get(..taken).unwrap_or_default()))
}

/// Channel 4 captures its own input at rising edges. The values belong to CC4S in CCMR2, to CC4E in CCER, and to the
/// channel's flag in SR.
const CAPTURES: u32 = 0b01 << 8;
const CAPTURE_ON: u32 = 1 << 12;
const CAPTURED: u32 = 1 << 4;
/// Value of `TI4_RMP` in OR that connects channel 4 to the oscillator LSI.
const FROM_LSI: u32 = 0b01 << 6;
/// Number of periods of LSI that are measured.
const PERIODS: u32 = 32;

/// Measures the frequency of the oscillator LSI with the sample timer. If a capture is read late, an edge is missed,
/// and the measured distance is longer, never shorter. So the shortest distance is used.
fn oscillator_hz(timer_hz: u32) -> u32 {
    // SAFETY: the address is TIM5's.
    let timer = unsafe { &*pac::TIM5::ptr() };
    // SAFETY: documented values of registers that nothing else uses.
    unsafe {
        timer.or().write(|w| w.bits(FROM_LSI));
        timer.ccmr2_input().write(|w| w.bits(CAPTURES));
        timer.ccer().write(|w| w.bits(CAPTURE_ON));
    }
    let period = timer.arr().read().bits() + 1;
    let edge = || {
        let looks = timer_hz / 2_000; // some milliseconds
        let came = (0..looks / 10).any(|_| timer.sr().read().bits() & CAPTURED != 0);
        came.then(|| timer.ccr4().read().bits())
    };
    let mut last = edge();
    let mut least = None;
    for _ in 0..PERIODS {
        let (Some(before), Some(now)) = (last, edge()) else { break };
        let ticks = (now + period - before).checked_rem(period).unwrap_or(0);
        least = Some(least.map_or(ticks, |least: u32| least.min(ticks)));
        last = Some(now);
    }
    // SAFETY: the registers get the values that they had after set-up.
    unsafe {
        timer.ccer().write(|w| w.bits(0));
        timer.ccmr2_input().write(|w| w.bits(0));
        timer.or().write(|w| w.bits(0));
    }
    least.and_then(|ticks| timer_hz.checked_div(ticks)).unwrap_or(0)
}
