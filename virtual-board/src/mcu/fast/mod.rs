//! Runs most instructions without the emulator. A step of the emulator takes some ten times as long.
//!
//! This module runs instructions that access only the core's registers, flash and RAM. The emulator's own decoder
//! decodes each instruction once. An instruction takes as many cycles here as in the emulator. [`Mcu::may_run`] checks
//! that no exception is due and that no other event needs the emulator. The emulator runs all other instructions, and
//! instructions that would fault. Both ways give the same result, bit for bit and cycle for cycle. Tests run random
//! code and whole sessions in both ways.

mod arithmetic;
mod code;
mod floats;
mod memory;
mod run;
mod transfer;

#[cfg(test)]
mod tests;

use std::sync::atomic::Ordering::Relaxed;

use rsemu::{
    core::device::Device,
    cpu::arm::v7m::{
        Regs,
        sys::{Exception, Sys, control, fpccr},
        xpsr,
    },
};

use super::{FLASH, Mcu, PACE_IRQ, RAM, RAM_BYTES, SAMPLE, SUPPLY_IRQ, exception_of};
use code::Code;
use floats::Floats;
use memory::{Guard, Memory};
use run::{Batch, Core};

#[derive(Default)]
pub(super) struct Fast {
    code: Code,
    /// A copy of flash. `same_at` is the number of accesses to the flash registers when the copy was last found equal.
    flash: Vec<u8>,
    same_at: Option<u64>,
    floats: Floats,
    /// Number of cycles by which this module is ahead of the emulator. `None` means that the emulator has the same core
    /// registers.
    ahead: Option<u64>,
    /// Whether the core has left its reset and is not locked up.
    awake: bool,
    /// Whether the emulator runs every instruction.
    off: bool,
    run: u64,
}

/// System settings that affect instructions.
struct Permit {
    guard: Guard,
    moves_floats: bool,
    float_control: u32,
}

/// Offset of FLASH_CR, and its bit LOCK.
const FLASH_CR: u64 = 0x10;
const LOCK: u32 = 1 << 31;

impl Mcu {
    /// Sets whether the emulator runs every instruction. Tests compare the two ways.
    pub fn emulate_all(&mut self, all: bool) {
        self.fast.off = all;
    }

    /// How many of the [`instructions`](Self::instructions) ran without the emulator.
    pub fn instructions_here(&self) -> u64 {
        self.fast.run
    }

    /// Runs instructions until cycle `until`, or until an instruction that the emulator must run. Returns whether at
    /// least one instruction ran.
    #[inline]
    pub(super) fn run_here(&mut self, until: u64) -> bool {
        let Some(permit) = self.may_run() else { return false };
        let cpu = &self.soc.cpu;
        let (basepri, primask) = (self.registers.basepri, self.registers.primask);
        let reads = self.listeners.reads.as_ref().map(|words| &words[..]);
        let Permit { guard, moves_floats, float_control } = permit;
        let Fast { code, flash, floats, ahead, .. } = &mut self.fast;
        let mut core = Core {
            registers: &mut self.registers,
            memory: Memory { ram: &self.memories.ram, flash, guard, reads },
            floats,
            cpu,
            moves_floats,
            float_control,
            branched: false,
        };
        let Batch { instructions, cycles, lowest, stands } = core.run(code, until - self.now);
        if instructions == 0 {
            return false;
        }
        self.registers.msp = self.registers.r[13];
        *ahead = Some(ahead.unwrap_or_default() + cycles);
        self.now += cycles;
        self.instructions += instructions;
        self.fast.run += instructions;
        self.stands = stands;
        self.watch.steps(instructions, cycles, (primask, basepri), lowest);
        true
    }

    /// Writes the core's registers back to the emulator.
    pub(super) fn give_back(&mut self) {
        if let Some(cycles) = self.fast.ahead.take() {
            self.soc.cpu.set_regs(self.registers);
            self.soc.cpu.with_sys(|sys| sys.tick_cyccnt(cycles));
            self.fast.floats.give_back(&self.soc.cpu);
        }
        self.fast.floats.forget();
    }

    /// Checks whether the core is awake, after its registers were changed from outside.
    pub(super) fn look_anew(&mut self) {
        let cpu = &self.soc.cpu;
        self.fast.awake = !cpu.reset_pending() && !cpu.is_locked_up();
    }

    /// Marks the copy of flash as old, after flash or the chip was replaced.
    pub(super) fn forget_flash(&mut self) {
        self.fast.same_at = None;
    }

    /// Drops the core's state, as a reset does.
    pub(super) fn start_anew(&mut self) {
        self.fast.ahead = None;
        self.fast.floats = Floats::default();
        self.fast.awake = false;
        self.forget_flash();
    }

    /// Whether the next instruction can run here. The core must be awake, privileged and on its main stack. No
    /// exception may be due. No observation or event may need single instructions.
    fn may_run(&mut self) -> Option<Permit> {
        let Regs { xpsr: state, faultmask, control: control_bits, r, .. } = self.registers;
        let exception = exception_of(state);
        let plain = control_bits & control::NPRIV == 0
            && (exception != 0 || control_bits & control::SPSEL == 0)
            && state & xpsr::T != 0
            && !faultmask
            && r[15] & 1 == 0;
        let in_flash = (r[15].wrapping_sub(FLASH) as usize) < self.chip.flash_bytes;
        let (event, waits) = self.event;
        let waited =
            waits && exception == SAMPLE && self.soc.encoder.read_at.load(Relaxed) >= event
                || self.soc.commanded_at.load(Relaxed) != self.commanded_at;
        let own_clock = self.clock.is_changed();
        if self.fast.off || !plain || !in_flash || waited || own_clock || !self.fast.awake {
            return None;
        }
        if !self.watch.takes_steps(exception) || self.soc.cpu.is_asleep() || !self.knows_flash() {
            return None;
        }
        let cpu = &self.soc.cpu;
        if cpu.nmi_asserted() {
            return None;
        }
        let asserted =
            [PACE_IRQ, SUPPLY_IRQ].map(|line| cpu.irq_asserted(line).then_some(line + 16));
        let registers = &self.registers;
        cpu.with_sys(|sys| {
            if sys.syst_csr & 1 != 0 || is_due(sys, registers, asserted) {
                return None;
            }
            let control = if sys.fpccr & fpccr::ASPEN != 0 { control::FPCA } else { 0 };
            Some(Permit {
                guard: guard(sys)?,
                moves_floats: sys.fp_enabled(true) && sys.fpccr & fpccr::LSPACT == 0,
                float_control: control,
            })
        })
    }

    /// Updates this module after the emulator has run a step. `to` is the new program counter. The step may end in a
    /// reset or lock-up.
    #[inline(always)]
    pub(super) fn follow_step(&mut self, to: u32) {
        self.fast.awake = to < run::RETURNS;
        let touched = self.soc.flash_touched.load(Relaxed);
        if self.fast.same_at.is_some_and(|at| at != touched) {
            // No single instruction can unlock flash, program it and lock it again.
            self.fast.same_at = self.flash_stays().then_some(touched);
        }
    }

    /// Whether flash is locked and no flash operation is in progress.
    fn flash_stays(&self) -> bool {
        let locked = self.soc.flash_registers.peek(FLASH_CR) & LOCK != 0;
        locked && self.soc.flash.next_event_tick().is_none()
    }

    /// Whether the copy of flash is up to date. Renews the copy if needed.
    fn knows_flash(&mut self) -> bool {
        let touched = self.soc.flash_touched.load(Relaxed);
        if self.fast.same_at == Some(touched) {
            return true;
        }
        if !self.flash_stays() {
            return false;
        }
        let contents = self.soc.flash.contents();
        if contents != self.fast.flash {
            self.fast.code = Code::new(contents.len());
            self.fast.flash = contents;
        }
        self.fast.same_at = Some(touched);
        true
    }
}

/// Whether the next step takes an exception, or an asserted interrupt line is not pending yet.
fn is_due(sys: &Sys, registers: &Regs, asserted: [Option<u16>; 2]) -> bool {
    let waits = |number: u16| {
        let exception = Exception(number);
        !sys.is_active(exception) && !sys.is_pending(exception)
    };
    if asserted.into_iter().flatten().any(waits) {
        return true;
    }
    let Some((_, priority)) = sys.highest_pending() else { return false };
    let mut running = sys.active_priority();
    if registers.primask {
        running = running.min(0);
    }
    if registers.basepri != 0 {
        running = running.min((registers.basepri & sys.group_mask()).into());
    }
    priority < running
}

/// The range of addresses that the protection unit refuses. It is empty or one region of RAM. `None` for other settings
/// of the unit, such as sub-regions.
fn guard(sys: &Sys) -> Option<Guard> {
    const ON: u32 = 1;
    const BACKGROUND: u32 = 1 << 2;
    const ACCESS: u32 = 7 << 24;
    const SUB_REGIONS: u32 = 0xFF << 8;
    if sys.mpu_ctrl & ON == 0 {
        return Some((0, 0));
    }
    let mut regions = sys.mpu_rasr.iter().zip(sys.mpu_rbar).filter(|(size, _)| *size & 1 != 0);
    let (Some((attributes, base)), None) = (regions.next(), regions.next()) else { return None };
    let bits = (attributes >> 1 & 31) + 1;
    let simple = attributes & (ACCESS | SUB_REGIONS) == 0 && (5..17).contains(&bits);
    if sys.mpu_ctrl & BACKGROUND == 0 || !simple {
        return None;
    }
    let length = 1 << bits;
    let first = base & !(length - 1);
    let inside = first.checked_sub(RAM)? <= RAM_BYTES - length;
    inside.then_some((first, length))
}
