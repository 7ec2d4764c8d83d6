//! Faults in registers. A register gets a value that the program has not set.

use virtual_board::{
    board::{Board, Force},
    world::World,
};

const RCC: u32 = 0x4002_3800;
const GPIOA: u32 = 0x4002_0000;
const GPIOB: u32 = 0x4002_0400;
const GPIOE: u32 = 0x4002_1000;
const TIM1: u32 = 0x4001_0000;
const TIM2: u32 = 0x4000_0000;
const TIM5: u32 = 0x4000_0C00;
const TIM6: u32 = 0x4000_1000;
const ADC: u32 = 0x4001_2000;
const TIM8: u32 = 0x4001_0400;
const DMA2_STREAM1: u32 = 0x4002_6428;
const NVIC_PRIORITIES: u32 = 0xE000_E400;

#[derive(Clone, Copy, Debug)]
pub enum Change {
    /// Flips these bits of the register.
    Flip(u32),
    /// Writes this value into the register.
    Be(u32),
}
use Change::{Be, Flip};

#[derive(Clone, Copy, Debug)]
pub struct RegisterRow {
    /// Name of the fault in reports.
    pub name: &'static str,
    pub address: u32,
    pub change: Change,
    /// Whether the program still runs and reports fault 43, `registers`.
    pub says: bool,
}

pub fn register_rows(board: Board) -> Vec<RegisterRow> {
    let cycles = u32::try_from(board.cycles_per_sample()).unwrap_or_default();
    let mut rows = vec![
        ("TIM5 at half the rate", TIM5 + 0x2C, Be(cycles - 1), true),
        ("TIM5 at 6.9 kHz", TIM5 + 0x2C, Be(cycles / 40 * 29), true),
        ("TIM5 ARR bit 16", TIM5 + 0x2C, Flip(1 << 16), false),
        ("TIM5 PSC 15", TIM5 + 0x28, Be(15), false),
        ("TIM5 CEN", TIM5, Flip(1), false),
        ("TIM5 UIE", TIM5 + 0x0C, Flip(1), false),
        ("TIM6 CEN", TIM6, Flip(1), true),
        ("TIM6 PSC", TIM6 + 0x28, Flip(1 << 4), true),
        ("TIM2 CEN", TIM2, Flip(1), true),
        ("TIM2 SMS", TIM2 + 0x08, Flip(1), true),
        ("TIM2 direction", TIM2 + 0x20, Flip(1 << 1), true),
        ("TIM2 filter", TIM2 + 0x18, Flip(1 << 4), true),
        ("TIM2 ARR", TIM2 + 0x2C, Flip(1 << 20), true),
        ("TIM1 CC3E", TIM1 + 0x20, Flip(1 << 8), true),
        ("TIM8 CEN", TIM8, Flip(1), true),
        ("TIM8 UDE", TIM8 + 0x0C, Flip(1 << 8), true),
        ("TIM8 ARR", TIM8 + 0x2C, Flip(1 << 15), true),
        ("TIM8 PSC", TIM8 + 0x28, Flip(1 << 14), true),
        ("TIM8 by another clock", TIM8 + 0x08, Flip(1 << 14), true),
        ("TIM8 repeats", TIM8 + 0x30, Flip(1), true),
        ("DMA2 stream off", DMA2_STREAM1, Flip(1), true),
        ("TIM8 without clock", RCC + 0x44, Flip(1 << 1), true),
        ("DMA2 without clock", RCC + 0x30, Flip(1 << 22), true),
        ("TIM6 without clock", RCC + 0x40, Flip(1 << 4), false), // the board treats this as a halt
        ("TIM5 without clock asleep", RCC + 0x60, Flip(1 << 3), true),
        ("clock divider of APB1", RCC + 0x08, Flip(1 << 10), true),
        ("clock security system", RCC, Flip(1 << 19), true),
        ("TIM1 in reset", RCC + 0x24, Flip(1), false), // MOE is off, as in a halt
        ("TIM8 in reset", RCC + 0x24, Flip(1 << 1), true),
        ("TIM2 in reset", RCC + 0x20, Flip(1), false), // the encoder count also jumps to 0
        ("TIM5 in reset", RCC + 0x20, Flip(1 << 3), false),
        ("TIM6 in reset", RCC + 0x20, Flip(1 << 4), false), // the board treats this as a halt
        ("DMA2 in reset", RCC + 0x10, Flip(1 << 22), true),
        ("converters in reset", RCC + 0x24, Flip(1 << 8), true),
        ("port A in reset", RCC + 0x10, Flip(1), false), // the encoder's pins change too
        ("encoder's pin", GPIOA, Flip(1 << 2), true),
        ("voltage detector", 0x4000_7000, Flip(1 << 4), true),
        ("`sample` at the lowest priority", NVIC_PRIORITIES + 48, Flip(0x00E0_0000), true),
        ("`render` above `sample`", NVIC_PRIORITIES + 48, Flip(0x2000_0000), true),
        // The value is the register's value after reset. So SysTick's priority also changes.
        ("PendSV at the highest priority", 0xE000_ED20, Be(0), true),
        ("stack guard's region", 0xE000_EDA0, Flip(1), true),
        ("priority groups", 0xE000_ED0C, Be(0x05FA_0500), true),
        ("ADC2's channel", ADC + 0x134, Flip(1 << 3), true),
        ("a second interrupt", 0xE000_E104, Be(1 << 23), true),
    ];
    match board.wiring.force {
        Force::Dac { .. } => rows.extend([
            ("the stop's pin", GPIOB, Flip(0b11 << 24), true),
            ("DAC in reset", RCC + 0x20, Flip(1 << 29), true),
            ("enable's pin a GPIO", GPIOA, Flip(0b11 << 20), true),
            ("enable open drain", GPIOA + 0x04, Flip(1 << 10), true),
            ("DAC off", 0x4000_7400, Flip(1), true),
            ("DAC's pin", GPIOA, Flip(0b11 << 8), true),
            ("ADC1's channel", ADC + 0x34, Flip(1), true),
        ]),
        Force::Pwm { .. } => rows.extend([
            ("the stop's pin", GPIOE, Flip(0b11 << 30), true),
            ("port E in reset", RCC + 0x10, Flip(1 << 4), true),
            ("enable's pin a GPIO", GPIOE, Flip(0b11 << 26), true),
            ("enable open drain", GPIOE + 0x04, Flip(1 << 13), true),
            ("sign open drain", GPIOE + 0x04, Flip(1 << 11), true),
            ("TIM1 ARR", TIM1 + 0x2C, Flip(1 << 11), true),
            ("PWM's pin", GPIOE, Flip(0b11 << 18), true),
        ]),
    }
    let rows = rows.into_iter();
    rows.map(|(name, address, change, says)| RegisterRow { name, address, change, says }).collect()
}

impl RegisterRow {
    pub fn apply(&self, world: &mut World<'_>) {
        let was = world.powered.mcu.peek(self.address);
        let value = match self.change {
            Flip(bits) => was ^ bits,
            Be(value) => value,
        };
        world.powered.mcu.poke(self.address, value);
    }
}
