//! Reads the machine code of an ELF. Finds the targets of a function's branches, and the functions whose address is
//! stored somewhere. See the Armv7-M architecture reference manual, A5.

use std::collections::{BTreeMap, BTreeSet};

use virtual_board::elf::Elf;

/// An instruction. It has its address, its first half-word, and its second half-word or 0.
#[derive(Clone, Copy, Debug)]
pub struct Instruction {
    pub at: u32,
    pub first: u16,
    pub second: u16,
}

pub struct Code<'a> {
    elf: &'a Elf,
    /// Size and name of each function, by its address.
    functions: BTreeMap<u32, (u32, &'a str)>,
}

/// The calls and jumps of a function.
#[derive(Debug, Default)]
pub struct Flow {
    /// Functions that are called or jumped to directly.
    pub to: BTreeSet<u32>,
    /// Whether there is a call or jump through a register.
    pub indirect: bool,
}

impl<'a> Code<'a> {
    pub fn of(elf: &'a Elf) -> Self {
        let text = elf.section(".text").unwrap();
        let inside = |address: u32| (text.0..text.0 + text.1).contains(&address);
        let mut functions = BTreeMap::new();
        for (name, address, size) in &elf.symbols {
            let known = functions.get(address).map_or(0, |&(size, _)| size);
            if inside(*address) && *size > known {
                functions.insert(*address, (*size, name.as_str()));
            }
        }
        Self { elf, functions }
    }

    /// Name of the function, as the linker writes it.
    pub fn name(&self, function: u32) -> &'a str {
        self.functions.get(&function).map_or("?", |&(_, name)| name)
    }

    /// The functions whose name contains `part`.
    pub fn named(&self, part: &str) -> Vec<u32> {
        let found = self.functions.iter().filter(|(_, (_, name))| name.contains(part));
        found.map(|(address, _)| *address).collect()
    }

    /// The function that contains `address`.
    fn holding(&self, address: u32) -> Option<u32> {
        let (&start, &(size, _)) = self.functions.range(..=address).next_back()?;
        (address < start + size).then_some(start)
    }

    fn bytes(&self, from: u32, length: u32) -> &'a [u8] {
        let holds =
            |piece: &&(u32, Vec<u8>)| (piece.0..piece.0 + piece.1.len() as u32).contains(&from);
        let (base, bytes) = self.elf.flash.iter().find(holds).unwrap();
        &bytes[(from - base) as usize..(from - base + length) as usize]
    }

    /// All words in flash that are not code: constants, tables, initial values of `.data`. The vector table is left
    /// out, since only the hardware uses it.
    pub fn constants(&self) -> Vec<u32> {
        let (vectors, size) = self.elf.section(".vector_table").unwrap();
        let mut words = Vec::new();
        for (base, bytes) in &self.elf.flash {
            for (n, word) in bytes.chunks_exact(4).enumerate() {
                let at = base + 4 * n as u32;
                if self.holding(at).is_none() && !(vectors..vectors + size).contains(&at) {
                    words.push(u32::from_le_bytes(word.try_into().unwrap()));
                }
            }
        }
        words
    }

    /// The handlers in the vector table, each once, without the reset handler.
    pub fn handlers(&self) -> BTreeSet<u32> {
        let (base, size) = self.elf.section(".vector_table").unwrap();
        let words = self.bytes(base, size).chunks_exact(4);
        let words = words.map(|word| u32::from_le_bytes(word.try_into().unwrap()));
        words.skip(2).filter(|word| word & 1 == 1).map(|word| word & !1).collect()
    }

    /// The instructions of the function at `start`, and the data between them.
    pub fn instructions(&self, start: u32) -> Vec<Instruction> {
        let (size, _) = self.functions[&start];
        let halves: Vec<u16> = self
            .bytes(start, size)
            .chunks_exact(2)
            .map(|half| u16::from_le_bytes([half[0], half[1]]))
            .collect();
        let (mut n, mut all) = (0, Vec::new());
        while n < halves.len() {
            let first = halves[n];
            let wide = first >> 11 >= 0b11101;
            let second = if wide { halves.get(n + 1).copied().unwrap_or(0) } else { 0 };
            all.push(Instruction { at: start + 2 * n as u32, first, second });
            n += if wide { 2 } else { 1 };
        }
        all
    }

    /// Targets of the function at `start`. Branches within the function are left out.
    pub fn flow(&self, start: u32) -> Flow {
        let mut flow = Flow::default();
        for instruction in self.instructions(start) {
            flow.indirect |= instruction.is_indirect();
            let target = instruction.target().and_then(|target| self.holding(target));
            flow.to.extend(target.filter(|&function| function != start));
        }
        flow
    }

    /// Functions whose address is in a constant, in a literal after code, or built in code (`movw`, `movt`).
    pub fn address_taken(&self) -> BTreeSet<u32> {
        let mut words: BTreeSet<u32> = self.constants().into_iter().collect();
        for (&start, &(size, _)) in &self.functions {
            let mut low = [0u32; 16];
            for instruction in self.instructions(start) {
                match instruction.move_16() {
                    Some((false, to, value)) => low[to] = value,
                    Some((true, to, value)) => {
                        words.insert(value << 16 | low[to]);
                    }
                    None => {}
                }
            }
            for at in (start.next_multiple_of(4)..(start + size) & !3).step_by(4) {
                words.insert(u32::from_le_bytes(self.bytes(at, 4).try_into().unwrap()));
            }
        }
        let functions = words.into_iter().filter(|word| word & 1 == 1).map(|word| word & !1);
        functions.filter(|function| self.functions.contains_key(function)).collect()
    }
}

impl Instruction {
    /// Whether the instruction branches through a register and is no return: `blx`, `bx`, a move to the program
    /// counter, or a load of the program counter.
    pub fn is_indirect(self) -> bool {
        let register = (self.first >> 3) & 0xF;
        let branch = self.first & 0xFF00 == 0x4700 && register != 14;
        let moved = self.first & 0xFF87 == 0x4687 && register != 14; // mov pc, register
        // ldr pc, [...]; a load from the stack is a return
        let load =
            self.first & 0xFF70 == 0xF850 && self.second >> 12 == 15 && self.first & 15 != 13;
        branch || moved || load
    }

    /// Target of a direct branch or call.
    pub fn target(self) -> Option<u32> {
        let (first, second) = (u32::from(self.first), u32::from(self.second));
        let signed = |value: u32, bits: u32| (value << (32 - bits)).cast_signed() >> (32 - bits);
        let offset = if first >> 11 == 0b11110 && second >> 15 == 1 {
            let sign = first >> 10 & 1;
            if second >> 12 & 1 == 1 {
                // bl, or b with a 24-bit offset
                let bit = |j: u32| 1 ^ (second >> j & 1) ^ sign;
                let low = (first & 0x3FF) << 12 | (second & 0x7FF) << 1;
                signed(sign << 24 | bit(13) << 23 | bit(11) << 22 | low, 25)
            } else if second >> 14 == 0b10 && first >> 7 & 7 != 7 {
                // conditional branch with a 20-bit offset
                let high = (second >> 11 & 1) << 19 | (second >> 13 & 1) << 18;
                signed(sign << 20 | high | (first & 0x3F) << 12 | (second & 0x7FF) << 1, 21)
            } else {
                return None;
            }
        } else if first >> 12 == 0b1101 && first >> 8 & 0xF < 14 {
            signed((first & 0xFF) << 1, 9)
        } else if first >> 11 == 0b11100 {
            signed((first & 0x7FF) << 1, 12)
        } else {
            return None; // cbz and cbnz reach only 126 bytes forward, and never leave a function
        };
        Some(self.at.wrapping_add(4).wrapping_add_signed(offset))
    }

    /// For an instruction that moves 16 bits into a register, returns three values: whether the bits are the upper
    /// half, the register, and the bits.
    fn move_16(self) -> Option<(bool, usize, u32)> {
        let (first, second) = (u32::from(self.first), u32::from(self.second));
        let upper = match first & 0xFBF0 {
            0xF240 => false,
            0xF2C0 => true,
            _ => return None,
        };
        let value =
            (first & 15) << 12 | (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF;
        Some((upper, (second >> 8 & 15) as usize, value))
    }
}
