//! Words and registers in which a bit can flip: RAM that the program reads, registers of the core and of peripherals.

use virtual_board::{
    elf::{Elf, SAMPLE_STATE},
    session::Failed,
    world::World,
};

/// A part of the chip's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// Data that `sample` keeps from one sample to the next.
    Sample,
    /// Data that `render` keeps from one output to the next, except for data that only telemetry and black box use.
    Render,
    /// Data that tasks pass to each other.
    Between,
    /// The statics of the console, the logger and RTT.
    Link,
    /// The statics of all other parts of the program.
    Other,
    /// The stack, from the stack pointer to its end.
    Stack,
    Core,
    Peripheral,
}

pub const REGIONS: [Region; 8] = [
    Region::Sample,
    Region::Render,
    Region::Between,
    Region::Link,
    Region::Other,
    Region::Stack,
    Region::Core,
    Region::Peripheral,
];

impl Region {
    pub const fn text(self) -> &'static str {
        match self {
            Self::Sample => "RAM of `sample`",
            Self::Render => "RAM of `render`",
            Self::Between => "RAM between the tasks",
            Self::Link => "RAM of `link`",
            Self::Other => "other RAM",
            Self::Stack => "stack",
            Self::Core => "core registers",
            Self::Peripheral => "peripheral registers",
        }
    }

    /// The region of a static at this address.
    pub fn at(elf: &Elf, address: u32) -> Self {
        let holds =
            |&&(_, from, size): &&(String, u32, u32)| (from..from + size).contains(&address);
        let symbol = elf.symbols.iter().find(holds);
        symbol.map_or(Self::Other, |(name, ..)| Self::of(name))
    }

    /// The region of a static by its symbol's name.
    fn of(symbol: &str) -> Self {
        let has = |parts: &[&str]| parts.iter().any(|part| symbol.contains(part));
        if has(&[SAMPLE_STATE]) {
            Self::Sample
        } else if has(&["local_resource_render"]) {
            Self::Render
        } else if has(&["queues", "position_ring", "FLAGS"]) {
            Self::Between
        } else if has(&["local_resource_link", "RTT", "logger", "LOGGER"]) {
            Self::Link
        } else {
            Self::Other
        }
    }
}

pub struct Places {
    words: [Vec<u32>; REGIONS.len()],
    /// The bits that a flip can change in the registers of peripherals. Each has the register's address and the bit's
    /// number.
    pub bits: Vec<(u32, u8)>,
    /// The bits that a flip can change in the reload register of the independent watchdog.
    pub watchdog: Vec<(u32, u8)>,
    /// Address after the last word of the stack.
    pub stack_end: u32,
}

/// A block of registers: its name, its base address, and the offset of each register.
type Block = (&'static str, u32, &'static [u16]);

const BLOCKS: [Block; 19] = [
    (
        "RCC",
        0x4002_3800,
        &[0x00, 0x04, 0x08, 0x10, 0x20, 0x24, 0x30, 0x40, 0x44, 0x50, 0x60, 0x64, 0x8C],
    ),
    ("PWR", 0x4000_7000, &[0x00]),
    ("FLASH", 0x4002_3C00, &[0x00]),
    ("GPIOA", 0x4002_0000, &[0x00, 0x04, 0x08, 0x0C, 0x14, 0x20, 0x24]),
    ("GPIOB", 0x4002_0400, &[0x00, 0x04, 0x08, 0x0C, 0x14, 0x20, 0x24]),
    ("GPIOE", 0x4002_1000, &[0x00, 0x04, 0x08, 0x0C, 0x14, 0x20, 0x24]),
    (
        "TIM1",
        0x4001_0000,
        &[
            0x00, 0x04, 0x08, 0x0C, 0x18, 0x1C, 0x20, 0x24, 0x28, 0x2C, 0x30, 0x34, 0x38, 0x3C,
            0x40, 0x44,
        ],
    ),
    ("TIM2", 0x4000_0000, &[0x00, 0x04, 0x08, 0x0C, 0x18, 0x20, 0x24, 0x28, 0x2C]),
    ("TIM3", 0x4000_0400, &[0x00, 0x04, 0x08, 0x0C, 0x18, 0x20, 0x24, 0x28, 0x2C]),
    ("TIM5", 0x4000_0C00, &[0x00, 0x04, 0x08, 0x0C, 0x24, 0x28, 0x2C]),
    ("TIM6", 0x4000_1000, &[0x00, 0x04, 0x0C, 0x24, 0x28, 0x2C]),
    ("TIM8", 0x4001_0400, &[0x00, 0x04, 0x08, 0x0C, 0x24, 0x28, 0x2C, 0x30]),
    ("DMA2", 0x4002_6400, &[0x28, 0x2C, 0x30, 0x34, 0x3C]),
    ("DAC", 0x4000_7400, &[0x00, 0x08, 0x2C]),
    (
        "ADC",
        0x4001_2000,
        &[0x04, 0x08, 0x10, 0x2C, 0x34, 0x4C, 0x104, 0x108, 0x110, 0x12C, 0x134, 0x14C, 0x304],
    ),
    ("EXTI", 0x4001_3C00, &[0x00, 0x04, 0x08, 0x0C]),
    ("DBGMCU", 0xE004_2000, &[0x04, 0x08, 0x0C]),
    ("SCB", 0xE000_ED00, &[0x08, 0x0C, 0x10, 0x14, 0x18, 0x1C, 0x20, 0x24, 0x94, 0x98, 0x9C, 0xA0]),
    ("core", 0xE000_E000, &[0x10, 0x100, 0x104, 0x108, 0x200, 0x204, 0x208, 0x400, 0x424, 0x430]),
];

/// The independent watchdog. Its only listed register is RLR, which the program can change only after it has written a
/// key. PR is left out, because the emulator never returns if the new divider is smaller than the divider's present
/// count.
const IWDG: Block = ("IWDG", 0x4000_3000, &[0x08]);
/// Address of the watchdog's reload register RLR.
pub(super) const WATCHDOG_RELOAD: u32 = 0x4000_3008;
const IWDG_KEY: u32 = 0x4000_3000;
const IWDG_OPEN: u32 = 0x5555;

const RAM_END: u32 = 0x2002_0000;
const AIRCR: u32 = 0xE000_ED0C;
const AIRCR_KEY: u32 = 0x05FA_0000;
/// Distance in bytes from a register of the NVIC that sets bits to the register that clears the same bits.
const NVIC_CLEARS: u32 = 0x80;

impl Places {
    /// Lists the words and bits of a board in which a bit can flip. `read` has the words of RAM that its program has
    /// read.
    pub fn new(elf: &Elf, world: &mut World<'_>, read: &[u32]) -> Self {
        let stack_end = elf.address_of("_stack_start").unwrap_or(RAM_END);
        let statics = elf.address_of("__sheap").unwrap_or(stack_end);
        let words = read.iter().filter(|&&address| address < statics);
        let mut by_region: [Vec<u32>; REGIONS.len()] = Default::default();
        words.for_each(|&address| by_region[Region::at(elf, address) as usize].push(address));
        let before = world.snapshot();
        let mut bits_of = |(_, base, offsets): Block| {
            let mut bits = Vec::new();
            for address in offsets.iter().map(|&offset| base + u32::from(offset)) {
                for bit in 0..32 {
                    world.restore(&before);
                    let was = world.powered.mcu.peek(address);
                    flip_register(world, address, bit);
                    if (world.powered.mcu.peek(address) ^ was) >> bit & 1 == 1 {
                        bits.push((address, bit));
                    }
                }
            }
            bits
        };
        let bits = BLOCKS.into_iter().flat_map(&mut bits_of).collect();
        let watchdog = bits_of(IWDG);
        Self { words: by_region, bits, watchdog, stack_end }
    }

    pub fn words(&self, region: Region) -> &[u32] {
        &self.words[region as usize]
    }
}

/// Flips a bit of a register. For some registers, bits are set at one address and cleared at another, and some need a
/// key. This function does what the register needs.
pub fn flip_register(world: &mut World<'_>, address: u32, bit: u8) {
    let mcu = &mut world.powered.mcu;
    let (was, one) = (mcu.peek(address), 1 << bit);
    match address {
        AIRCR => mcu.poke(address, (was ^ one) & 0xFFFF | AIRCR_KEY),
        0xE000_E100..0xE000_E300 if was & one != 0 => mcu.poke(address + NVIC_CLEARS, one),
        0xE000_E100..0xE000_E300 => mcu.poke(address, one),
        0x4000_3004..=0x4000_3008 => {
            mcu.poke(IWDG_KEY, IWDG_OPEN);
            mcu.poke(address, was ^ one);
            mcu.poke(IWDG_KEY, 0);
        }
        _ => mcu.poke(address, was ^ one),
    }
}

/// Address and words of the symbol with this name.
pub fn words_of(elf: &Elf, world: &World<'_>, name: &str) -> Result<(u32, Vec<u32>), Failed> {
    let (from, size) = elf.place_of(name)?;
    let words = (from..from + size / 4 * 4).step_by(4).map(|at| word_at(world, at));
    Ok((from, words.collect()))
}

pub(super) fn word_at(world: &World<'_>, address: u32) -> u32 {
    let mut word = [0; 4];
    world.powered.mcu.read(address, &mut word);
    u32::from_le_bytes(word)
}

pub fn flip_word(world: &mut World<'_>, address: u32, bit: u8) {
    let flipped = word_at(world, address) ^ 1 << bit;
    world.powered.mcu.write(address, &flipped.to_le_bytes());
}

/// Number of core registers in which a bit can flip: 13 general ones, stack pointer, link register, program counter,
/// xPSR and the interrupt masks.
pub const CORE_REGISTERS: u8 = 20;

/// Flips a bit of a core register. Returns the register's name.
pub fn flip_core(world: &mut World<'_>, register: u8, bit: u8) -> String {
    let one = 1u32 << bit;
    world.powered.mcu.set_registers(|registers| match register {
        0..=12 | 14 => registers.r[usize::from(register)] ^= one,
        13 => {
            registers.msp ^= one;
            registers.r[13] ^= one;
        }
        15 => registers.r[15] ^= one & !1,
        16 => registers.xpsr ^= one,
        17 => registers.primask ^= true,
        18 => registers.basepri ^= 0x10 << (bit % 4),
        _ => registers.faultmask ^= true,
    });
    match register {
        0..=12 | 14 => return format!("r{register}"),
        13 => "msp",
        15 => "pc",
        16 => "xpsr",
        17 => "primask",
        18 => "basepri",
        _ => "faultmask",
    }
    .into()
}

/// Flips a bit of a further register. Kind 0 is the floating-point register with the number `float`, kind 1 is FPSCR,
/// and any other kind is CONTROL. Returns the register's name.
pub fn flip_further(world: &mut World<'_>, (kind, float): (u8, u8), bit: u8) -> String {
    let mcu = &mut world.powered.mcu;
    match kind {
        0 => {
            mcu.flip_float(float, 1 << bit);
            format!("s{float}")
        }
        1 => {
            mcu.flip_float(32, 1 << bit);
            "fpscr".into()
        }
        _ => {
            mcu.set_registers(|registers| registers.control ^= 1 << (bit % 3));
            "control".into()
        }
    }
}

pub fn register_name(address: u32) -> String {
    let is = |(_, base, offsets): &&Block| {
        offsets.iter().any(|&offset| base + u32::from(offset) == address)
    };
    let block = BLOCKS.iter().chain([&IWDG]).find(is);
    block.map_or_else(String::new, |(name, base, _)| format!("{name} + {:#x}", address - base))
}
