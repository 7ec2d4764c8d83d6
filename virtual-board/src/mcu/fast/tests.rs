use rsemu::cpu::arm::v7m::Regs;

use super::super::{Chip, FLASH, Listeners, Mcu, RAM, RAM_BYTES};
use crate::board::NUCLEO_F446RE;

/// Random numbers by xorshift64*.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let bytes = self.0.wrapping_mul(0x2545_F491_4F6C_DD1D).to_le_bytes();
        u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]])
    }

    fn half(&mut self) -> u16 {
        let [low, high, ..] = self.next().to_le_bytes();
        u16::from_le_bytes([low, high])
    }

    fn below(&mut self, limit: u32) -> u32 {
        self.next() % limit
    }

    fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(u32::try_from(all.len()).unwrap()) as usize]
    }

    /// A random word. It is an address, an operand near a limit, or any value.
    fn word(&mut self) -> u32 {
        match self.below(8) {
            0 => RAM + self.below(RAM_BYTES),
            1 => RAM + (self.below(RAM_BYTES) & !3),
            2 => CODE + (self.below(2 * HALF_WORDS) | 1),
            3 => self.one_of(&[0, 1, 2, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, 31, 32, 33, 0xFFFF]),
            4 => self.below(64),
            5 => GUARD.wrapping_sub(16).wrapping_add(self.below(300)) & !3,
            _ => self.next(),
        }
    }
}

const CODE: u32 = FLASH + 0x400;
const HALF_WORDS: u32 = 0x4000;
const GUARD: u32 = RAM + 0x4000;
const MPU_CTRL: u32 = 0xE000_ED94;
const CPACR: u32 = 0xE000_ED88;
const CYCCNT: u32 = 0xE000_1004;

/// Random code. It has all short encodings, and long encodings whose first half-word the manual defines.
fn code(random: &mut Random) -> Vec<u8> {
    let mut halves = Vec::new();
    while halves.len() < HALF_WORDS as usize {
        let half = random.half();
        match random.below(8) {
            0..4 => halves.push(half),
            4 => halves.extend([0xBF00 | half & 0xFF, random.half()]),
            5 => halves.extend([0xED00 | half & 0xFF, 0x0A00 | random.half() & 0xF1FF]),
            6 => halves.extend([0xEE00 | half & 0xFF, 0x0A00 | random.half() & 0xF1FF]),
            _ => halves.extend([0xE800 | half & 0x17FF, random.half()]),
        }
    }
    halves.truncate(HALF_WORDS as usize);
    halves.into_iter().flat_map(u16::to_le_bytes).collect()
}

/// A chip that has left its reset. Its floating-point unit is on, and a region of its RAM is protected. With `off` the
/// emulator runs every instruction.
fn chip(program: &[(u32, Vec<u8>)], off: bool) -> Mcu {
    let chip = Chip { flash_bytes: 0x1_0000, ..NUCLEO_F446RE.chip };
    let mut mcu = Mcu::new(chip, program, Listeners::default());
    mcu.emulate_all(off);
    mcu.run_until(1).unwrap();
    mcu.outlive_lock_up();
    mcu.poke(CPACR, 0xF << 20);
    mcu.poke(0xE000_EDFC, 1 << 24);
    mcu.poke(0xE000_1000, 1);
    mcu.poke(MPU_CTRL + 8, GUARD | 1 << 4);
    mcu.poke(MPU_CTRL + 12, 7 << 1 | 1);
    mcu.poke(MPU_CTRL, 0b111);
    mcu
}

fn program(random: &mut Random) -> Vec<(u32, Vec<u8>)> {
    let vectors = (0..64u32).map(|n| if n == 0 { RAM + 0x8000 } else { FLASH + 0x201 });
    let vectors = vectors.flat_map(u32::to_le_bytes).collect();
    let stays = [0xFE, 0xE7].to_vec();
    vec![(FLASH, vectors), (FLASH + 0x200, stays), (CODE, code(random))]
}

/// The state that must be equal after a run by the emulator alone and after a faster run.
fn all_of(mcu: &mut Mcu) -> (Regs, Vec<u32>, [u64; 3], u32, String) {
    let registers = mcu.core_registers();
    let mut floats = registers.float.to_vec();
    floats.push(registers.fpscr);
    let cycles = mcu.peek(CYCCNT);
    let times = [mcu.now(), mcu.instructions(), mcu.stands.into()];
    (mcu.soc.cpu.regs(), floats, times, cycles, format!("{:?}", mcu.watch()))
}

#[test]
fn random_code_does_the_same_here_and_in_the_emulator() {
    const PIECES: u64 = 5_000;
    let mut here = 0;
    for seed in 1..=4 {
        let mut random = Random(seed);
        let program = program(&mut random);
        let [mut fast, mut slow] = [false, true].map(|off| chip(&program, off));
        let begin = fast.snapshot();
        let mut memories = [0, 1].map(|_| vec![0; RAM_BYTES as usize]);
        for trial in 0..PIECES {
            let place = CODE + 2 * random.below(HALF_WORDS - 64);
            let words: Vec<_> = (0..15).map(|_| random.word()).collect();
            let flags = random.next() & 0xF80F_0000;
            let it = if random.below(4) == 0 { random.next() & 0x0600_FC00 } else { 0 };
            let (stack, cycles) = (RAM + (random.below(RAM_BYTES) & !3), 1 + random.below(40));
            let mask = random.one_of(&[0u8, 0, 0x10, 0x40]);
            let at = random.below(RAM_BYTES - 64) & !3;
            let data: Vec<_> = (0..16).flat_map(|_| random.word().to_le_bytes()).collect();
            let floats: Vec<_> = (0..32).map(|_| random.word()).collect();
            let begin_there = |mcu: &mut Mcu| {
                mcu.restore(&begin);
                mcu.write(RAM + at, &data);
                for (register, value) in (0..).zip(&floats) {
                    mcu.soc.cpu.set_s(register, *value);
                }
                mcu.set_registers(|registers| {
                    registers.r[..15].copy_from_slice(&words);
                    registers.r[15] = place;
                    registers.msp = stack;
                    registers.basepri = mask;
                    registers.xpsr = 1 << 24 | flags | it;
                });
                mcu.run_until(mcu.now() + u64::from(cycles)).unwrap();
            };
            begin_there(&mut fast);
            begin_there(&mut slow);
            let (a, b) = (all_of(&mut fast), all_of(&mut slow));
            assert!(
                a == b,
                "seed {seed}, trial {trial} from {place:#x}:\n{a:x?}\n{b:x?}\n{words:x?} {it:x}"
            );
            for (mcu, memory) in [&fast, &slow].into_iter().zip(&mut memories) {
                mcu.read(RAM, memory);
            }
            assert!(memories[0] == memories[1], "seed {seed}, trial {trial}: RAM");
        }
        here += fast.instructions_here();
        assert_eq!(slow.instructions_here(), 0);
    }
    assert!(here > 4 * PIECES, "{here} instructions here");
}
