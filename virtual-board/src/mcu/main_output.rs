//! Simulates TIM1's main output. It is controlled by the register BDTR, which has a lock, and by the break input.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
};

use rsemu::core::{
    device::Device,
    space::{MemAttrs, MemOps},
    wire::{Level, WireId, WireSink},
};

use super::{
    bus::{Clock, Lazy, Port, registers_of},
    crystal::Crystal,
};

const CCR1: u64 = 0x34;
const CCR2: u64 = 0x38;
const SR: u64 = 0x10;
const BREAK_FLAG: u32 = 1 << 7;
pub(super) const BDTR: u64 = 0x44;
pub(super) const MAIN_OUTPUT_ENABLE: u32 = 1 << 15;
const AUTOMATIC_OUTPUT_ENABLE: u32 = 1 << 14;
pub(super) const BREAK_ENABLE: u32 = 1 << 12;
const LOCK_LEVEL: u32 = 0b11 << 8;
/// Offsets of a port's registers for pin mode and pin function, then the values for the alternate-function mode and for
/// TIM1's function.
const MODER: u64 = 0x00;
const AFRL: u64 = 0x20;
const ALTERNATE: u32 = 0b10;
const TIM1: u32 = 1;
/// Register bits that each lock level freezes (RM0090 17.4.18, RM0390 16.4.18, LOCK). Level 1 freezes dead time, break
/// bits and idle levels. Level 2 also freezes polarities and off states, and level 3 modes and preloads. All channels
/// are treated as outputs.
const LOCKED: [&[(u64, u32)]; 3] = [
    &[(BDTR, 0x70FF), (0x04, 0x7F00)],
    &[(BDTR, 0x0C00), (0x20, 0x2AAA)],
    &[(0x18, 0x7878), (0x1C, 0x7878)],
];

/// TIM1's port. The port models BDTR's lock, the break input and the break flag. For all three, the emulator's timer
/// only stores the bits. The port also notes when the duty was written.
#[derive(Debug)]
pub(super) struct Break {
    pub(super) lazy: Lazy,
    pub(super) open: Arc<AtomicBool>,
    pub(super) crystal: Arc<Crystal>,
    /// The break flag of TIM1.
    pub(super) broken: Arc<AtomicBool>,
    pub(super) locked: Arc<AtomicBool>,
    pub(super) input: Option<BreakInput>,
    pub(super) clock: Arc<Clock>,
    pub(super) written_at: Arc<AtomicU64>,
}

/// The pin of the break input. The timer sees the pin only while the port connects it to TIM1 (alternate function 1;
/// RM0390 7.3.2, RM0090 8.3.2). Otherwise the timer sees a low level. The input is active high, so a low level means no
/// break.
#[derive(Clone, Debug)]
pub(super) struct BreakInput {
    port: Arc<dyn MemOps>,
    number: u8,
}

impl BreakInput {
    pub(super) fn new(port: &dyn Device, number: u8) -> Self {
        Self { port: registers_of(port), number }
    }

    pub(super) fn is_connected(&self) -> bool {
        let bits = |offset: u64, width: u8, index: u8| {
            let mut word = [0; 4];
            let _ = self.port.read(offset, &mut word, MemAttrs::DEBUG); // every port has these registers
            u32::from_le_bytes(word) >> (width * index) & ((1 << width) - 1)
        };
        let half = self.number / 8;
        bits(MODER, 2, self.number) == ALTERNATE
            && bits(AFRL + 4 * u64::from(half), 4, self.number % 8) == TIM1
    }
}

/// A reset of TIM1 opens the lock and clears the flag.
#[derive(Debug)]
pub(super) struct Unlock {
    pub(super) locked: Arc<AtomicBool>,
    pub(super) broken: Arc<AtomicBool>,
}

impl WireSink for Unlock {
    fn set_level(&self, _: WireId, _: u32, level: Level) {
        if level.is_high() {
            self.locked.store(false, Relaxed);
            self.broken.store(false, Relaxed);
        }
    }
}

impl Break {
    /// Whether the break input or the clock security system's flag is active (RM0090 17.4.18, BKE).
    fn is_active(&self) -> bool {
        let connected = || self.input.as_ref().is_some_and(BreakInput::is_connected);
        self.open.load(Relaxed) && connected() || self.crystal.flag.load(Relaxed)
    }

    /// The value of the register after a store of `value`. Locked bits do not change.
    fn unlocked(&self, offset: u64, value: u32) -> u32 {
        let written = self.locked.load(Relaxed);
        let level = if written { self.lazy.peek(BDTR) >> 8 & 3 } else { 0 };
        let mut kept = if offset == BDTR && written { LOCK_LEVEL } else { 0 };
        for (register, bits) in LOCKED[..level as usize].iter().copied().flatten() {
            if *register == offset {
                kept |= bits;
            }
        }
        self.locked.store(written || offset == BDTR, Relaxed);
        if kept == 0 { value } else { self.lazy.peek(offset) & kept | value & !kept }
    }
}

impl Port for Break {
    fn before(&self) {
        self.lazy.catch_up_by_edges();
    }

    fn write(&self, offset: u64, value: u32) -> u32 {
        let value = self.unlocked(offset, value);
        if matches!(offset, CCR1 | CCR2) {
            self.written_at.store(self.clock.now(), Relaxed);
        }
        if offset == SR && value & BREAK_FLAG == 0 {
            self.broken.store(self.is_active(), Relaxed);
        }
        if offset != BDTR {
            value
        } else if value & BREAK_ENABLE != 0 && self.is_active() {
            value & !MAIN_OUTPUT_ENABLE
        } else if value & AUTOMATIC_OUTPUT_ENABLE != 0 {
            value | MAIN_OUTPUT_ENABLE
        } else {
            value
        }
    }

    fn read(&self, offset: u64, value: u32) -> u32 {
        let flag = if self.broken.load(Relaxed) { BREAK_FLAG } else { 0 };
        if offset == SR { value & !BREAK_FLAG | flag } else { value }
    }
}
