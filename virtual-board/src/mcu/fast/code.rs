//! The program in flash. Each instruction is decoded once.

use rsemu::cpu::arm::v7m::{
    fpisa::{FpInsn, UnaryOp},
    isa::{DualMulOp, ExtendOp, HintOp, Insn, decode, is_32bit},
};

use super::super::FLASH;

/// Kind of an entry of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Runs,
    /// The code continues at another index of the table.
    Elsewhere,
    /// An instruction that the emulator must run.
    Not,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub(super) instruction: Insn,
    pub(super) kind: Kind,
    /// Whether the instruction has two half-words.
    pub(super) wide: bool,
}

const NOT: Entry = Entry { instruction: Insn::Undefined, kind: Kind::Not, wide: false };
const ELSEWHERE: Entry = Entry { kind: Kind::Elsewhere, ..NOT };

/// Largest count of instructions that are decoded in one go.
const LONGEST: usize = 64;

#[derive(Default)]
pub(super) struct Code {
    /// For each half-word of flash, the index of its instruction in `entries`. 0 means that it is not decoded yet.
    places: Vec<u32>,
    /// Instructions in the order of flash, up to an entry `Elsewhere`.
    pub(super) entries: Vec<Entry>,
}

impl Code {
    /// An empty table for `bytes` bytes of flash.
    pub(super) fn new(bytes: usize) -> Self {
        Self { places: vec![0; bytes / 2], entries: vec![NOT] }
    }

    /// Index of the instruction at an address of flash.
    #[inline(always)]
    pub(super) fn place(&mut self, address: u32, flash: &[u8]) -> Option<usize> {
        let half = (address.wrapping_sub(FLASH) >> 1) as usize;
        match self.places.get(half) {
            None => None,
            Some(0) => Some(self.decode(half, flash)),
            Some(place) => Some(*place as usize),
        }
    }

    #[cold]
    fn decode(&mut self, mut half: usize, flash: &[u8]) -> usize {
        let first = self.entries.len();
        let word = |half: usize| {
            let bytes = flash.get(2 * half..2 * half + 2)?;
            Some(u16::from_le_bytes([bytes[0], bytes[1]]))
        };
        for _ in 0..LONGEST {
            match self.places.get(half) {
                Some(0) => {}
                _ => break,
            }
            self.places[half] = u32::try_from(self.entries.len()).unwrap_or_default();
            let one = word(half).unwrap_or_default();
            let wide = is_32bit(one);
            let two = if wide { word(half + 1) } else { Some(0) };
            let instruction = two.map_or(Insn::Undefined, |two| decode(one, two));
            if !runs(&instruction) {
                self.entries.push(NOT);
                return first;
            }
            self.entries.push(Entry { instruction, kind: Kind::Runs, wide });
            half += 1 + usize::from(wide);
        }
        self.entries.push(ELSEWHERE);
        first
    }
}

fn runs(instruction: &Insn) -> bool {
    match *instruction {
        Insn::DataProc { .. }
        | Insn::ShiftReg { .. }
        | Insn::Adr { .. }
        | Insn::MovImm16 { .. }
        | Insn::Mul { .. }
        | Insn::MulLong { .. }
        | Insn::Div { .. }
        | Insn::HalfMul { .. }
        | Insn::SatQ { .. }
        | Insn::Misc { .. }
        | Insn::Bitfield { .. }
        | Insn::LoadLiteral { .. }
        | Insn::LoadStore { unpriv: false, .. }
        | Insn::LoadStoreDual { .. }
        | Insn::LoadStoreMultiple { .. }
        | Insn::Branch { .. }
        | Insn::BranchLink { .. }
        | Insn::Bx { .. }
        | Insn::Blx { .. }
        | Insn::Cbz { .. }
        | Insn::TableBranch { .. }
        | Insn::It { .. }
        | Insn::Barrier { .. } => true,
        Insn::Sat { halves, .. } => !halves,
        Insn::DualMul { op, .. } => matches!(op, DualMulOp::Smmul | DualMulOp::Smmla),
        Insn::Extend { op, .. } => !matches!(op, ExtendOp::Sxtb16 | ExtendOp::Uxtb16),
        Insn::Hint { op } => {
            matches!(op, HintOp::Nop | HintOp::Yield | HintOp::Preload | HintOp::Dbg(_))
        }
        Insn::Fp(float) => match float {
            FpInsn::Unary { op, .. } => op == UnaryOp::Mov,
            FpInsn::MovImm { .. }
            | FpInsn::MovCore { .. }
            | FpInsn::MovCore2 { .. }
            | FpInsn::Mem { .. }
            | FpInsn::Multi { .. } => true,
            _ => false,
        },
        _ => false,
    }
}
