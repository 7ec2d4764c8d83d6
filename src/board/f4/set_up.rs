//! Reads back registers with every output. These registers decide whether a force acts, when it acts and which force it
//! is.
//!
//! The program sets these registers up once and must not change them later. A checksum folds all these registers into
//! one word. A flipped bit in any register changes this word. Bits that change while the program runs are masked out.
//! Registers that the program writes with every output are not included: compare values, the DAC's code, the
//! converters' CR2, DBGMCU. The clock gates of the peripherals are included.

use core::{
    ptr,
    sync::atomic::{AtomicBool, Ordering::Relaxed},
};

use cortex_m::register::basepri;
use zwidth::contract;

use super::{output_watchdog, pin::BoardPin};
use crate::board::common::control_block;

/// How [`Encoder::turn`](contract::Encoder::turn) has set TIM2's polarity.
pub(super) static ENCODER_TURNED: AtomicBool = AtomicBool::new(false);

const RCC: u32 = 0x4002_3800;
const TIM1: u32 = 0x4001_0000;
const TIM2: u32 = 0x4000_0000;
const TIM5: u32 = 0x4000_0C00;
const TIM6: u32 = 0x4000_1000;
const TIM8: u32 = 0x4001_0400;
const DMA2: u32 = 0x4002_6400;
const DMA2_STREAM1: u32 = DMA2 + 0x28;
const GPIOA: u32 = 0x4002_0000;
const GPIOB: u32 = 0x4002_0400;
const GPIOE: u32 = 0x4002_1000;
const FLASH: u32 = 0x4002_3C00;
const POWER: u32 = 0x4000_7000;
const DAC: u32 = 0x4000_7400;
const ADC: u32 = 0x4001_2000;
const EXTI: u32 = 0x4001_3C00;
const SCB: u32 = 0xE000_ED00;
const NVIC: u32 = 0xE000_E100;

/// Bit of TIM2's CCER that sets the direction of counting (CC1P).
const DIRECTION: u32 = 1 << 1;

/// Folds registers into a sum. Each line has a base address, and the offsets of its registers. A register counts with
/// all its bits, or only with those of a mask that follows its offset. The folding is written out line by line, because
/// a loop over a table takes three times as long.
macro_rules! fold {
    ($sum:ident, $($base:expr => [$($offset:literal $(& $bits:expr)?),+];)+) => {
        $($($sum = $sum.rotate_left(1) ^ (read($base + $offset) $(& $bits)?);)+)+
    };
}

/// A call, because inside its caller the compiler can read all registers to the stack before it folds them, which takes
/// nearly twice as long.
#[inline(never)]
fn sum() -> u32 {
    let mut sum = 0u32;
    // The clocks: HSE with its bypass and its security system, the PLL, and the dividers. DCKCFGR has the divider of
    // the timers (TIMPRE), except on the F407. Then come the clock gates, for the core awake and asleep.
    fold! { sum,
        RCC => [0x00 & (1 << 16 | 1 << 18 | 1 << 19 | 1 << 24), 0x04, 0x08, 0x30, 0x40, 0x44, 0x50, 0x60, 0x64, 0x8C];
    }
    // The wait states of the flash, the voltage detector, and its interrupt.
    fold! { sum,
        FLASH => [0x00 & 0xF];
        POWER => [0x00];
        EXTI => [0x00, 0x08];
    }
    // The pins: their modes, output types, alternate functions, and the pull-up of the stop.
    fold! { sum,
        GPIOA => [0x00, 0x04, 0x20, 0x24];
        GPIOB => [0x00, 0x0C, 0x24];
        GPIOE => [0x00, 0x04, 0x0C, 0x24];
    }
    // Enable and PWM: CR1, CR2, SMCR, CCMR1, CCMR2, CCER, PSC, ARR, RCR, BDTR without MOE. DAC: CR.
    fold! { sum,
        TIM1 => [0x00, 0x04, 0x08, 0x18, 0x1C, 0x20, 0x28, 0x2C, 0x30, 0x44 & (!(1 << 15))];
        DAC => [0x00];
    }
    // Converters 1 and 2: CR1, SMPR2, SQR1, SQR3. Shared by both: CCR.
    fold! { sum,
        ADC => [0x04, 0x10, 0x2C, 0x34];
        ADC + 0x100 => [0x04, 0x10, 0x2C, 0x34, 0x204];
    }
    // Encoder: CR1 without DIR, CR2, SMCR, CCMR1, CCER, PSC, ARR.
    fold! { sum,
        TIM2 => [0x00 & (!(1 << 4)), 0x04, 0x08, 0x18, 0x20 & !DIRECTION, 0x28, 0x2C];
    }
    // Sample timer, TIM6, output watchdog: CR1, CR2, SMCR, DIER, PSC, ARR, RCR.
    fold! { sum,
        TIM5 => [0x00, 0x08, 0x0C, 0x28, 0x2C];
        TIM6 => [0x00, 0x28, 0x2C];
        TIM8 => [0x00, 0x04, 0x08, 0x0C, 0x28, 0x2C, 0x30];
    }
    // The output watchdog's stream: CR, NDTR (always 1, one item in a circle), PAR, M0AR, FCR without the FIFO's level.
    // The stream's error flags in LISR (DMEIF1, TEIF1): after an error the stream stores nothing.
    fold! { sum,
        DMA2_STREAM1 => [0x00, 0x04, 0x08, 0x0C, 0x14 & (!(0b111 << 3))];
        DMA2 => [0x00 & (0b11 << 8)];
    }
    // Vector table, priority groups, priorities of PendSV and similar exceptions, memory protection with its one
    // region.
    fold! { sum,
        SCB => [0x08, 0x0C & 0x700, 0x1C, 0x20, 0x94, 0x9C, 0xA0];
    }
    // The interrupts: which of them are on, and the priorities of the four tasks.
    fold! { sum,
        NVIC => [0x00, 0x04, 0x08, 0x300, 0x324, 0x330];
    }
    sum
}

/// The check of the registers. `expected` is the checksum of the first check.
pub struct SetUp {
    expected: Option<u32>,
    /// The checksums of the two halves of the channels, which are checked in turn. Whether the second half is next.
    channels: [Option<u32>; 2],
    channels_next: bool,
    /// Whether the registers were wrong at an earlier check. After such a check the program itself changes the mode of
    /// the enable pin. In the checksum this change could cancel the wrong value.
    were_wrong: bool,
    enable: BoardPin,
}

impl SetUp {
    /// A check without expected sums. The first check sets them.
    pub const fn new(enable: BoardPin) -> Self {
        Self {
            expected: None,
            channels: [None; 2],
            channels_next: false,
            were_wrong: false,
            enable,
        }
    }
}

#[inline(always)]
fn read(address: u32) -> u32 {
    // SAFETY: a register of this chip, aligned, whose reading has no effect.
    unsafe { ptr::read_volatile(ptr::without_provenance::<u32>(address as usize)) }
}

impl contract::SetUp for SetUp {
    #[inline(always)]
    fn channels_hold(&mut self) -> bool {
        let of_channels = self.channels_next;
        self.channels_next = !of_channels;
        let [head, channels] = &mut self.channels;
        let sum = control_block::sum(of_channels);
        *if of_channels { channels } else { head }.get_or_insert(sum) == sum
    }

    #[inline(always)]
    fn holds(&mut self) -> bool {
        let sum = sum();
        let turned = read(TIM2 + 0x20) & DIRECTION != 0;
        let direction = turned == ENCODER_TURNED.load(Relaxed);
        // Only the logger masks interrupts, and this task cannot run during that time. So if this task finds interrupts
        // masked, that is an error. The mask would keep `link` from running.
        let unmasked = basepri::read() == 0;
        let whole = *self.expected.get_or_insert(sum) == sum;
        whole && direction && unmasked && output_watchdog::stores_off()
    }

    #[cold]
    fn hold_enable_low(&mut self) {
        // The expected sums are inverted, so that no later sum equals them. This saves a check of `were_wrong` at each
        // output.
        if !self.were_wrong {
            self.were_wrong = true;
            self.expected = self.expected.map(|sum| !sum);
        }
        self.enable.hold_low();
    }
}
