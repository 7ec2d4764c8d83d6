//! Runs instructions with the same cycles as the emulator. An instruction takes one cycle, each access one more, and a
//! branch two more.

use rsemu::cpu::arm::v7m::{
    ArmV7m, Regs,
    isa::{
        BitfieldOp, Cond, DualMulOp, ExtendOp, HalfMulOp, Insn, MemOffset, MiscOp, Operand, SatQOp,
    },
    xpsr,
};

use super::{
    arithmetic::{Before, extended, half, low, operate, saturated, shift, shift_by},
    code::{Code, Kind},
    floats::Floats,
    memory::Memory,
};

/// A jump to this address or above is a return from an exception.
pub(super) const RETURNS: u32 = 0xF000_0000;

/// The core's state in this module.
pub(super) struct Core<'a> {
    pub(super) registers: &'a mut Regs,
    pub(super) memory: Memory<'a>,
    pub(super) floats: &'a mut Floats,
    pub(super) cpu: &'a ArmV7m,
    /// Whether this module can run instructions that move S0 to S31.
    pub(super) moves_floats: bool,
    /// Bits of CONTROL that an instruction on S0 to S31 sets.
    pub(super) float_control: u32,
    /// Whether the present instruction has set the program counter.
    pub(super) branched: bool,
}

#[derive(Debug)]
pub(super) struct Batch {
    pub(super) instructions: u64,
    pub(super) cycles: u64,
    /// Lowest stack pointer during these instructions.
    pub(super) lowest: u32,
    /// Whether the last instruction branches to itself.
    pub(super) stands: bool,
}

impl Core<'_> {
    /// Runs for `cycles` cycles, or until an instruction that the emulator must run.
    pub(super) fn run(&mut self, code: &mut Code, cycles: u64) -> Batch {
        let mut batch = Batch { instructions: 0, cycles: 0, lowest: u32::MAX, stands: false };
        'blocks: while batch.cycles < cycles {
            let Some(mut place) = code.place(self.registers.r[15], self.memory.flash) else {
                break;
            };
            loop {
                let entry = &code.entries[place];
                match entry.kind {
                    Kind::Runs => {}
                    Kind::Elsewhere => continue 'blocks,
                    Kind::Not => break 'blocks,
                }
                let at = self.registers.r[15];
                let Some(taken) = self.one(&entry.instruction, entry.wide) else { break 'blocks };
                batch.instructions += 1;
                batch.cycles += taken;
                batch.lowest = batch.lowest.min(self.registers.r[13]);
                if self.branched {
                    batch.stands = self.registers.r[15] == at;
                    continue 'blocks;
                }
                batch.stands = false;
                if batch.cycles >= cycles {
                    break 'blocks;
                }
                place += 1;
            }
        }
        batch
    }

    /// Runs one instruction and returns its cycles. `None` means that the emulator must run the instruction. Nothing
    /// was changed then.
    #[inline(always)]
    fn one(&mut self, instruction: &Insn, wide: bool) -> Option<u64> {
        let at = self.registers.r[15];
        self.registers.r[15] = at.wrapping_add(4);
        self.branched = false;
        let taken = if self.registers.xpsr & xpsr::IT_MASK == 0 {
            self.execute(instruction, true)
        } else {
            self.in_it_block(instruction, wide)
        };
        if taken.is_none() {
            self.registers.r[15] = at;
        } else if !self.branched {
            self.registers.r[15] = at.wrapping_add(if wide { 4 } else { 2 });
        }
        taken
    }

    fn in_it_block(&mut self, instruction: &Insn, wide: bool) -> Option<u64> {
        let state = self.registers.xpsr >> 10 & 0x3F;
        let state = state << 2 | self.registers.xpsr >> 25 & 3;
        let taken = if Cond((state >> 4).to_le_bytes()[0]).passes(self.registers.xpsr) {
            self.execute(instruction, wide)?
        } else {
            1
        };
        if !matches!(instruction, Insn::It { .. }) {
            let next = if state & 7 == 0 { 0 } else { state & 0xE0 | state << 1 & 0x1F };
            self.set_it_state(next);
        }
        Some(taken)
    }

    fn set_it_state(&mut self, state: u32) {
        let bits = state >> 2 << 10 | (state & 3) << 25;
        self.registers.xpsr = self.registers.xpsr & !xpsr::IT_MASK | bits;
    }

    #[inline(always)]
    pub(super) fn get(&self, register: u8) -> u32 {
        self.registers.r[usize::from(register & 15)]
    }

    /// Writes a register. A write to the program counter is ignored, as in the emulator.
    #[inline(always)]
    pub(super) fn set(&mut self, register: u8, value: u32) {
        self.registers.r[usize::from(register & 15)] = value;
    }

    fn carry(&self) -> bool {
        self.registers.xpsr & xpsr::C != 0
    }

    #[inline(always)]
    fn set_negative_and_zero(&mut self, value: u32) {
        let zero = if value == 0 { xpsr::Z } else { 0 };
        self.registers.xpsr = self.registers.xpsr & !(xpsr::N | xpsr::Z) | value & xpsr::N | zero;
    }

    #[inline(always)]
    fn set_carry(&mut self, carry: bool) {
        self.registers.xpsr = self.registers.xpsr & !xpsr::C | if carry { xpsr::C } else { 0 };
    }

    fn saturates(&mut self, saturated: bool) {
        if saturated {
            self.registers.xpsr |= xpsr::Q;
        }
    }

    pub(super) fn branch(&mut self, to: u32) -> Option<u64> {
        self.registers.r[15] = to & !1;
        self.branched = true;
        Some(3)
    }

    /// Checks that a branch to this address neither faults nor returns from an exception.
    pub(super) fn leads_on(to: u32) -> Option<()> {
        (to & 1 != 0 && to < RETURNS).then_some(())
    }

    /// Runs an instruction. `sets` tells whether a short instruction sets the flags. In an IT block a short instruction
    /// does not set the flags.
    #[inline(always)]
    #[expect(clippy::too_many_lines, reason = "one arm for each form")]
    fn execute(&mut self, instruction: &Insn, sets: bool) -> Option<u64> {
        match *instruction {
            Insn::DataProc { op, s, rd, rn, operand } => {
                let carry = self.carry();
                let (b, shifted) = match operand {
                    Operand::Imm { value, carry: given } => (value, given.unwrap_or(carry)),
                    Operand::Reg { rm, shift: by } => shift(by, self.get(rm), carry),
                };
                let overflow = self.registers.xpsr & xpsr::V != 0;
                let before = Before { carry, shifted, overflow };
                let (result, carry, overflow) = operate(op, self.get(rn), b, before);
                if s && (sets || op.is_test()) {
                    self.set_negative_and_zero(result);
                    self.set_carry(carry);
                    let overflow = if overflow { xpsr::V } else { 0 };
                    self.registers.xpsr = self.registers.xpsr & !xpsr::V | overflow;
                }
                if op.is_test() {
                } else if rd == 15 {
                    return self.branch(result);
                } else {
                    self.set(rd, result);
                }
                Some(1)
            }
            Insn::MovImm16 { top, rd, imm } => {
                let imm = u32::from(imm);
                let kept = self.get(rd) & 0xFFFF;
                self.set(rd, if top { imm << 16 | kept } else { imm });
                Some(1)
            }
            Insn::LoadStore { load, size, signed, rt, rn, offset, index, add, wback, .. } => {
                let base = self.get(rn);
                let offset = match offset {
                    MemOffset::Imm(value) => value,
                    MemOffset::Reg { rm, lsl } => self.get(rm) << lsl,
                };
                let moved = if add { base.wrapping_add(offset) } else { base.wrapping_sub(offset) };
                let address = if index { moved } else { base };
                let bytes = size.bytes();
                if !load {
                    self.memory.store(address, bytes, self.get(rt))?;
                    if wback {
                        self.set(rn, moved);
                    }
                    return Some(2);
                }
                let value = extended(self.memory.load(address, bytes)?, bytes, signed);
                if rt == 15 {
                    Self::leads_on(value)?;
                }
                if wback {
                    self.set(rn, moved);
                }
                if rt == 15 {
                    return Some(self.branch(value)? + 1);
                }
                self.set(rt, value);
                Some(2)
            }
            Insn::Branch { cond, offset } => {
                if cond.is_some_and(|cond| !cond.passes(self.registers.xpsr)) {
                    return Some(1);
                }
                self.branch(self.get(15).wrapping_add_signed(offset))
            }
            Insn::Cbz { nonzero, rn, offset } => {
                if (self.get(rn) != 0) != nonzero {
                    return Some(1);
                }
                self.branch(self.get(15).wrapping_add(offset))
            }
            Insn::It { cond, mask } => {
                self.set_it_state(u32::from(cond.0 << 4 | mask));
                Some(1)
            }
            Insn::BranchLink { offset } => {
                let here = self.get(15);
                self.set(14, here | 1);
                self.branch(here.wrapping_add_signed(offset))
            }
            Insn::Bx { rm } => {
                let to = self.get(rm);
                Self::leads_on(to)?;
                self.branch(to)
            }
            Insn::Blx { rm } => {
                let to = self.get(rm);
                Self::leads_on(to)?;
                self.set(14, self.get(15).wrapping_sub(2) | 1);
                self.branch(to)
            }
            Insn::ShiftReg { ty, s, rd, rn, rm } => {
                let amount = self.get(rm) & 0xFF;
                let (result, carry) = shift_by(ty, self.get(rn), amount, self.carry());
                self.set(rd, result);
                if s && sets {
                    self.set_negative_and_zero(result);
                    self.set_carry(carry);
                }
                Some(1)
            }
            Insn::Mul { rd, rn, rm, ra, sub, s } => {
                let product = self.get(rn).wrapping_mul(self.get(rm));
                let result = match ra {
                    None => product,
                    Some(ra) if sub => self.get(ra).wrapping_sub(product),
                    Some(ra) => self.get(ra).wrapping_add(product),
                };
                self.set(rd, result);
                if s && sets {
                    self.set_negative_and_zero(result);
                }
                Some(1)
            }
            Insn::LoadLiteral { size, signed, rt, imm, add } => {
                let base = self.get(15) & !3;
                let address = if add { base.wrapping_add(imm) } else { base.wrapping_sub(imm) };
                let value = self.memory.load(address, size.bytes())?;
                let value = extended(value, size.bytes(), signed);
                if rt == 15 {
                    Self::leads_on(value)?;
                    return Some(self.branch(value)? + 1);
                }
                self.set(rt, value);
                Some(2)
            }
            Insn::Barrier { .. } | Insn::Hint { .. } => Some(1),
            _ => self.execute_more(instruction),
        }
    }

    /// Runs the less frequent instructions.
    fn execute_more(&mut self, instruction: &Insn) -> Option<u64> {
        match *instruction {
            Insn::LoadStoreDual { .. }
            | Insn::LoadStoreMultiple { .. }
            | Insn::TableBranch { .. } => self.access(instruction),
            Insn::Fp(instruction) => self.move_floats(instruction),
            Insn::Adr { rd, imm, add } => {
                let base = self.get(15) & !3;
                self.set(rd, if add { base.wrapping_add(imm) } else { base.wrapping_sub(imm) });
                Some(1)
            }
            Insn::MulLong { signed, accumulate, rdlo, rdhi, rn, rm, umaal } => {
                let [a, b, lower, upper] = [rn, rm, rdlo, rdhi].map(|register| self.get(register));
                let product = if signed && !umaal {
                    (i64::from(a.cast_signed()) * i64::from(b.cast_signed())).cast_unsigned()
                } else {
                    u64::from(a) * u64::from(b)
                };
                let result = if umaal {
                    product + u64::from(lower) + u64::from(upper)
                } else if accumulate {
                    product.wrapping_add(u64::from(upper) << 32 | u64::from(lower))
                } else {
                    product
                };
                self.set(rdlo, low(result));
                self.set(rdhi, low(result >> 32));
                Some(2)
            }
            Insn::Div { signed, rd, rn, rm } => {
                let (a, b) = (self.get(rn), self.get(rm));
                let result = match b {
                    0 => return None,
                    _ if signed => a.cast_signed().wrapping_div(b.cast_signed()).cast_unsigned(),
                    _ => a / b,
                };
                self.set(rd, result);
                Some(3)
            }
            Insn::Extend { op, rd, rn, rm, rotate } => {
                let value = self.get(rm).rotate_right(rotate.into());
                let value = match op {
                    ExtendOp::Sxtb => extended(value, 1, true),
                    ExtendOp::Sxth => extended(value, 2, true),
                    ExtendOp::Uxtb => value & 0xFF,
                    ExtendOp::Uxth => value & 0xFFFF,
                    ExtendOp::Sxtb16 | ExtendOp::Uxtb16 => return None,
                };
                let sum = if rn == 15 { value } else { self.get(rn).wrapping_add(value) };
                self.set(rd, sum);
                Some(1)
            }
            Insn::Misc { op, rd, rm } => {
                let value = self.get(rm);
                let result = match op {
                    MiscOp::Clz => value.leading_zeros(),
                    MiscOp::Rbit => value.reverse_bits(),
                    MiscOp::Rev => value.swap_bytes(),
                    MiscOp::Rev16 => value.swap_bytes().rotate_right(16),
                    MiscOp::Revsh => extended(value.swap_bytes() >> 16, 2, true),
                };
                self.set(rd, result);
                Some(1)
            }
            Insn::Bitfield { op, rd, rn, lsb, width } => {
                let (place, width) = (u32::from(lsb) & 31, u32::from(width).clamp(1, 32));
                let mask = u32::MAX >> (32 - width);
                let (value, hole) = (self.get(rn), mask << place);
                let result = match op {
                    BitfieldOp::Ubfx => value >> place & mask,
                    BitfieldOp::Sbfx => {
                        let spare = 32 - width;
                        ((value >> place << spare).cast_signed() >> spare).cast_unsigned()
                    }
                    BitfieldOp::Bfi => self.get(rd) & !hole | (value & mask) << place,
                    BitfieldOp::Bfc => self.get(rd) & !hole,
                };
                self.set(rd, result);
                Some(1)
            }
            Insn::Sat { unsigned, rd, rn, imm, shift: by, .. } => {
                let value = shift(by, self.get(rn), self.carry()).0.cast_signed();
                let (result, saturated) = saturated(value.into(), imm.into(), !unsigned);
                self.set(rd, result);
                self.saturates(saturated);
                Some(1)
            }
            Insn::SatQ { op, rd, rn, rm } => {
                let [n, m] = [rn, rm].map(|register| i64::from(self.get(register).cast_signed()));
                let twice = matches!(op, SatQOp::Qdadd | SatQOp::Qdsub);
                let (n, first) = saturated(if twice { 2 * n } else { n }, 32, true);
                let n = i64::from(n.cast_signed());
                let adds = matches!(op, SatQOp::Qadd | SatQOp::Qdadd);
                let (result, second) = saturated(if adds { m + n } else { m - n }, 32, true);
                self.set(rd, result);
                self.saturates(first | second);
                Some(1)
            }
            Insn::HalfMul { op, rd, rn, rm, ra, x, y } => {
                let (n, m) = (self.get(rn), half(self.get(rm), y));
                let product = match op {
                    HalfMulOp::Smulw | HalfMulOp::Smlaw => (i64::from(n.cast_signed()) * m) >> 16,
                    _ => half(n, x) * m,
                };
                match op {
                    HalfMulOp::Smul | HalfMulOp::Smulw => {
                        self.set(rd, low(product.cast_unsigned()))
                    }
                    HalfMulOp::Smla | HalfMulOp::Smlaw => {
                        let sum = product + i64::from(self.get(ra).cast_signed());
                        self.saturates(i32::try_from(sum).is_err());
                        self.set(rd, low(sum.cast_unsigned()));
                    }
                    HalfMulOp::Smlal => self.add_long([rd, ra], product),
                }
                Some(2)
            }
            Insn::DualMul { op, rd, rn, rm, ra, x } => {
                let [n, m] = [rn, rm].map(|register| i64::from(self.get(register).cast_signed()));
                let sum = match op {
                    DualMulOp::Smmul => n * m,
                    DualMulOp::Smmla => {
                        (i64::from(self.get(ra).cast_signed()) << 32).wrapping_add(n * m)
                    }
                    _ => return None,
                };
                let sum = if x { sum.wrapping_add(0x8000_0000) } else { sum };
                self.set(rd, low(sum.cast_unsigned() >> 32));
                Some(2)
            }
            _ => None,
        }
    }

    /// Adds `value` to a 64-bit number in two registers, given as upper and lower register.
    fn add_long(&mut self, [upper, lower]: [u8; 2], value: i64) {
        let before = u64::from(self.get(upper)) << 32 | u64::from(self.get(lower));
        let sum = before.wrapping_add_signed(value);
        self.set(lower, low(sum));
        self.set(upper, low(sum >> 32));
    }
}
