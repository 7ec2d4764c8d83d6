//! The registers that decide whether, when and which force acts, read back with every output.
//!
//! All that the program sets up once and that must not change afterwards, folded into one word: a bit that flips in any
//! of them changes it. What changes while the program runs is left out by a mask, or is written with every output
//! (compare values, the DAC's code, DBGMCU). A peripheral without its clock reads as 0 (RM0090 7.2.9), so a lost clock
//! is found as well.

use core::{
    ptr,
    sync::atomic::{AtomicBool, Ordering::Relaxed},
};

use zwidth::contract;

use super::output_watchdog;

/// How [`Encoder::turn`](contract::Encoder::turn) has set TIM2's polarity.
pub(super) static ENCODER_TURNED: AtomicBool = AtomicBool::new(false);

const ALL: u32 = u32::MAX;

const RCC: u32 = 0x4002_3800;
const TIM1: u32 = 0x4001_0000;
const TIM2: u32 = 0x4000_0000;
const TIM5: u32 = 0x4000_0C00;
const TIM6: u32 = 0x4000_1000;
const TIM8: u32 = 0x4001_0400;
const DMA2_STREAM1: u32 = 0x4002_6400 + 0x28;
const GPIOA: u32 = 0x4002_0000;
const GPIOB: u32 = 0x4002_0400;
const GPIOE: u32 = 0x4002_1000;
const SCB: u32 = 0xE000_ED00;
const NVIC: u32 = 0xE000_E100;

/// TIM2's CCER, whose bit CC1P is the direction.
const DIRECTION: (u32, u32) = (TIM2 + 0x20, 1 << 1);

/// Address, and the bits that must not change.
const REGISTERS: [(u32, u32); 62] = [
    // Clocks: HSE, its bypass, its security system, the PLL; what divides, what is on, awake and asleep.
    (RCC, 1 << 16 | 1 << 18 | 1 << 19 | 1 << 24),
    (RCC + 0x04, ALL),
    (RCC + 0x08, ALL),
    (RCC + 0x30, ALL),
    (RCC + 0x40, ALL),
    (RCC + 0x44, ALL),
    (RCC + 0x50, ALL),
    (RCC + 0x60, ALL),
    (RCC + 0x64, ALL),
    // Wait states of the flash; voltage detector; its interrupt.
    (0x4002_3C00, 0xF),
    (0x4000_7000, ALL),
    (0x4001_3C00, ALL),
    (0x4001_3C08, ALL),
    // Pins: mode, drive, pull, alternate function.
    (GPIOA, ALL),
    (GPIOA + 0x04, ALL),
    (GPIOA + 0x0C, ALL),
    (GPIOA + 0x20, ALL),
    (GPIOA + 0x24, ALL),
    (GPIOB, ALL),
    (GPIOB + 0x0C, ALL),
    (GPIOB + 0x24, ALL),
    (GPIOE, ALL),
    (GPIOE + 0x04, ALL),
    (GPIOE + 0x0C, ALL),
    (GPIOE + 0x24, ALL),
    // Enable and PWM: CR1, CR2, SMCR, DIER, CCMR1, CCMR2, CCER, PSC, ARR, RCR, BDTR but for MOE. DAC: CR.
    (TIM1, ALL),
    (TIM1 + 0x04, ALL),
    (TIM1 + 0x08, ALL),
    (TIM1 + 0x0C, ALL),
    (TIM1 + 0x18, ALL),
    (TIM1 + 0x1C, ALL),
    (TIM1 + 0x20, ALL),
    (TIM1 + 0x28, ALL),
    (TIM1 + 0x2C, ALL),
    (TIM1 + 0x30, ALL),
    (TIM1 + 0x44, !(1 << 15)),
    (0x4000_7400, ALL),
    // Encoder: CR1 but for DIR, SMCR, CCMR1, CCER, PSC, ARR.
    (TIM2, !(1 << 4)),
    (TIM2 + 0x08, ALL),
    (TIM2 + 0x18, ALL),
    (DIRECTION.0, !DIRECTION.1),
    (TIM2 + 0x28, ALL),
    (TIM2 + 0x2C, ALL),
    // Samples, the clock beside them, the output watchdog: CR1, DIER, PSC, ARR.
    (TIM5, ALL),
    (TIM5 + 0x0C, ALL),
    (TIM5 + 0x28, ALL),
    (TIM5 + 0x2C, ALL),
    (TIM6, ALL),
    (TIM6 + 0x28, ALL),
    (TIM6 + 0x2C, ALL),
    (TIM8, ALL),
    (TIM8 + 0x0C, ALL),
    (TIM8 + 0x28, ALL),
    (TIM8 + 0x2C, ALL),
    // Its stream: CR, PAR, M0AR, FCR.
    (DMA2_STREAM1, ALL),
    (DMA2_STREAM1 + 0x08, ALL),
    (DMA2_STREAM1 + 0x0C, ALL),
    // Vector table, priority groups.
    (SCB + 0x08, ALL),
    (SCB + 0x0C, 0x700),
    // Interrupts: which are on; priorities of the tasks.
    (NVIC, ALL),
    (NVIC + 0x04, ALL),
    (NVIC + 0x08, ALL),
];

/// Priorities of PVD, SPI2, TIM5 and SPI3: the words of the NVIC that they stand in.
const PRIORITIES: [u32; 3] = [0xE000_E400, 0xE000_E400 + 36, 0xE000_E400 + 48];

/// What they folded to when all was set up.
#[derive(Default)]
pub struct SetUp {
    expected: Option<u32>,
}

#[inline(always)]
fn read(address: u32) -> u32 {
    // SAFETY: a register of this chip, aligned, whose reading has no effect.
    unsafe { ptr::read_volatile(ptr::without_provenance::<u32>(address as usize)) }
}

#[inline(always)]
fn fold(sum: u32, value: u32) -> u32 {
    sum.rotate_left(1) ^ value
}

impl contract::SetUp for SetUp {
    #[inline(always)]
    fn holds(&mut self) -> bool {
        let sum = REGISTERS.iter().fold(0, |sum, (at, bits)| fold(sum, read(*at) & bits));
        let sum = PRIORITIES.iter().fold(sum, |sum, at| fold(sum, read(*at)));
        let (at, bit) = DIRECTION;
        let direction = (read(at) & bit != 0) == ENCODER_TURNED.load(Relaxed);
        *self.expected.get_or_insert(sum) == sum && direction && output_watchdog::stores_off()
    }
}
