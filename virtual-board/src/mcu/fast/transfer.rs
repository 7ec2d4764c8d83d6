//! Instructions that move several words, branch by a table, or move S0 to S31.

use rsemu::cpu::arm::v7m::{
    fpisa::{FpInsn, UnaryOp},
    isa::Insn,
};

use super::run::Core;

impl Core<'_> {
    pub(super) fn access(&mut self, instruction: &Insn) -> Option<u64> {
        match *instruction {
            Insn::LoadStoreDual { load, rt, rt2, rn, imm, index, add, wback } => {
                let base = if rn == 15 { self.get(15) & !3 } else { self.get(rn) };
                let moved = if add { base.wrapping_add(imm) } else { base.wrapping_sub(imm) };
                let address = if index { moved } else { base };
                if load {
                    let first = self.memory.load(address, 4)?;
                    let second = self.memory.load(address.wrapping_add(4), 4)?;
                    self.set(rt, first);
                    self.set(rt2, second);
                } else {
                    self.memory.holds(address, 2)?;
                    let (first, second) = (self.get(rt), self.get(rt2));
                    self.memory.store(address, 4, first)?;
                    self.memory.store(address + 4, 4, second)?;
                }
                if wback && rn != 15 {
                    self.set(rn, moved);
                }
                Some(3)
            }
            Insn::LoadStoreMultiple { load, rn, list, wback, before } => {
                self.multiple(load, rn, list, (wback, before))
            }
            Insn::TableBranch { rn, rm, half } => {
                let (base, index) = (self.get(rn), self.get(rm));
                let (shift, bytes) = if half { (1, 2) } else { (0, 1) };
                let offset = self.memory.load(base.wrapping_add(index << shift), bytes)?;
                Some(self.branch(self.get(15).wrapping_add(2 * offset))? + 1)
            }
            _ => None,
        }
    }

    fn multiple(
        &mut self,
        load: bool,
        rn: u8,
        list: u16,
        (writes_back, before): (bool, bool),
    ) -> Option<u64> {
        const PC: u16 = 1 << 15;
        let (count, base) = (list.count_ones(), self.get(rn));
        let lower = base.wrapping_sub(4 * count);
        let first = if before { lower } else { base };
        let moved = if before { lower } else { base.wrapping_add(4 * count) };
        self.memory.holds(first, count)?;
        if count == 0 {
            return None;
        }
        let leads = load && list & PC != 0;
        if leads {
            Self::leads_on(self.memory.load(first + 4 * (count - 1), 4)?)?;
        }
        if load && writes_back {
            self.set(rn, moved);
        }
        let (mut left, mut address) = (list, first);
        while left != 0 {
            let register = (left.trailing_zeros() & 15) as u8;
            left &= left - 1;
            if load {
                let value = self.memory.load(address, 4)?;
                self.set(register, value);
            } else {
                self.memory.store(address, 4, self.get(register))?;
            }
            address = address.wrapping_add(4);
        }
        if !load && writes_back {
            self.set(rn, moved);
        }
        if leads {
            return Some(self.branch(self.get(15))? + u64::from(count));
        }
        Some(1 + u64::from(count))
    }

    pub(super) fn move_floats(&mut self, instruction: FpInsn) -> Option<u64> {
        if !self.moves_floats {
            return None;
        }
        let taken = match instruction {
            FpInsn::Unary { op: UnaryOp::Mov, d, m } => {
                let value = self.floats.get(m, self.cpu);
                self.floats.set(d, value);
                1
            }
            FpInsn::MovImm { d, imm } => {
                self.floats.set(d, imm);
                1
            }
            FpInsn::MovCore { to_fp, rt, n } => {
                self.move_float(to_fp, rt, n);
                1
            }
            FpInsn::MovCore2 { to_fp, rt, rt2, m, .. } => {
                self.move_float(to_fp, rt, m);
                self.move_float(to_fp, rt2, m.wrapping_add(1));
                2
            }
            FpInsn::Mem { load, d, rn, imm, add, double } => {
                let base = if rn == 15 { self.get(15) & !3 } else { self.get(rn) };
                let address = if add { base.wrapping_add(imm) } else { base.wrapping_sub(imm) };
                self.move_words(load, d, address, if double { 2 } else { 1 })?
            }
            FpInsn::Multi { load, d, rn, count, add, writeback, .. } => {
                let (base, bytes) = (self.get(rn), 4 * u32::from(count));
                let lower = base.wrapping_sub(bytes);
                let first = if add { base } else { lower };
                let taken = self.move_words(load, d, first, count)?;
                if writeback {
                    self.set(rn, if add { base.wrapping_add(bytes) } else { lower });
                }
                taken
            }
            _ => return None,
        };
        self.registers.control |= self.float_control;
        Some(taken)
    }

    fn move_float(&mut self, to_float: bool, register: u8, float: u8) {
        if to_float {
            self.floats.set(float, self.get(register));
        } else {
            let value = self.floats.get(float, self.cpu);
            self.set(register, value);
        }
    }

    /// Loads or stores words in RAM, or loads one or two constants from flash.
    fn move_words(&mut self, load: bool, first: u8, address: u32, count: u8) -> Option<u64> {
        if count == 0 || self.memory.holds(address, count.into()).is_none() {
            self.load_constants(load, first, address, count)?;
        } else {
            for n in 0..count {
                let (float, at) = (first.wrapping_add(n), address + 4 * u32::from(n));
                if load {
                    let value = self.memory.load(at, 4)?;
                    self.floats.set(float, value);
                } else {
                    self.memory.store(at, 4, self.floats.get(float, self.cpu))?;
                }
            }
        }
        Some(1 + u64::from(count))
    }

    fn load_constants(&mut self, load: bool, first: u8, address: u32, count: u8) -> Option<()> {
        if !load || !(1..=2).contains(&count) {
            return None;
        }
        let one = self.memory.load(address, 4)?;
        if count == 2 {
            let two = self.memory.load(address.wrapping_add(4), 4)?;
            self.floats.set(first.wrapping_add(1), two);
        }
        self.floats.set(first, one);
        Some(())
    }
}
