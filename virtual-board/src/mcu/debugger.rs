//! What a debugger can do to the chip: it halts the core, sets breakpoints, steps, and accesses registers and memory.

use std::{collections::BTreeSet, ops::Range, sync::atomic::Ordering::Relaxed};

use rsemu::{
    core::{space::MemAttrs, value::Width},
    cpu::arm::v7m::sys::{in_ppb, in_vendor_ppb},
};

use super::{
    FLASH, Mcu, RAM, RAM_BYTES, Stopped,
    main_output::{BDTR, MAIN_OUTPUT_ENABLE},
};

/// State of TIM1's main output enable after a halt that has switched the outputs off. The manuals leave this open: they
/// say that the outputs are off "as if" the bit were reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterHalt {
    /// The bit keeps its value, so the outputs are on again after the halt.
    Kept,
    /// The bit is reset, so the outputs stay off after the halt.
    Reset,
}

/// A halt that has not ended.
#[derive(Debug)]
pub struct Halt {
    /// Whether TIM1 is stopped, with its outputs off.
    masked: bool,
    /// Whether TIM1's main output was enabled before the halt.
    enabled: bool,
    stored: u64,
    resets: u64,
}

/// Conditions at which the core is to halt.
#[derive(Clone, Debug, Default)]
pub struct Stops {
    pub breakpoints: BTreeSet<u32>,
    /// Stop after the first instruction that leads out of this range.
    pub step: Option<Range<u32>>,
}

/// Reason why the core stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Met {
    /// The next instruction has a breakpoint.
    Breakpoint(u32),
    Step,
}

/// The core's registers, as a debugger reads them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Registers {
    /// R0 to R15. R13 is the stack pointer in use.
    pub core: [u32; 16],
    pub xpsr: u32,
    /// MSP, PSP, PRIMASK, BASEPRI, FAULTMASK, CONTROL.
    pub system: [u32; 6],
    pub float: [u32; 32],
    pub fpscr: u32,
}

/// Reason why memory cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// Flash is programmed by the program only.
    Flash,
    /// No memory has this address.
    Nothing,
}

/// Bus address of TIM1's BDTR.
const TIM1_BDTR: u32 = 0x4001_0044;
/// Index of SP in the core's registers, and the CONTROL bit that selects the process stack.
const SP: usize = 13;
const SPSEL: u32 = 1 << 1;

impl Mcu {
    /// Halts the core for `cycles`, as a debugger does. A block stops if its DBGMCU bit is set. If TIM1 stops, its
    /// outputs are off during the halt. `moe` says what happens to the main output enable after the halt.
    pub fn halt(&mut self, cycles: u64, moe: AfterHalt) {
        let halt = self.begin_halt();
        self.stay_halted(cycles);
        self.end_halt(&halt, moe);
    }

    /// Begins a halt. From now on the core is halted.
    pub fn begin_halt(&mut self) -> Halt {
        self.settle();
        let masked = self.soc.tim1_stops();
        let mut halt =
            Halt { masked, enabled: false, stored: self.stored_by_dma, resets: self.resets };
        self.mask_outputs(&mut halt);
        halt
    }

    fn mask_outputs(&mut self, halt: &mut Halt) {
        let bdtr = self.soc.pwm.peek(BDTR);
        halt.enabled = bdtr & MAIN_OUTPUT_ENABLE != 0;
        if halt.masked {
            self.soc.pwm.poke(BDTR, bdtr & !MAIN_OUTPUT_ENABLE);
        }
    }

    /// Lets `cycles` of the halt pass.
    pub fn stay_halted(&mut self, cycles: u64) {
        self.soc.stand_still(cycles);
        self.now += cycles;
        self.settle();
        self.service(); // the watchdog may reset the core before it runs on
    }

    pub fn end_halt(&mut self, halt: &Halt, moe: AfterHalt) {
        // If DMA2 stored a word during the halt, this store has switched the outputs off. The outputs stay off until
        // the program acts.
        let kept = halt.stored == self.stored_by_dma;
        let running = halt.resets == self.resets && kept && !self.soc.stop.load(Relaxed);
        if halt.masked && running && moe == AfterHalt::Kept {
            let enabled = if halt.enabled { MAIN_OUTPUT_ENABLE } else { 0 };
            self.soc.pwm.poke(BDTR, self.soc.pwm.peek(BDTR) | enabled);
        }
    }

    /// Call this after a halt of `cycles` cycles. If the sampling timer was stopped, moves the last sampling event
    /// `cycles` later. The next event then also comes `cycles` later.
    pub fn shift_event(&mut self, cycles: u64) {
        if self.event.0 > 0 && self.soc.tim5_stops() {
            self.event.0 += cycles;
        }
    }

    /// Sets DBGMCU's bits of APB1, as a debugger does. These blocks then also stop in a halt.
    pub fn stop_in_halts(&mut self, apb1_bits: u32) {
        self.soc.dbgmcu.set(0x08, self.soc.dbgmcu.get(0x08) | apb1_bits);
    }

    /// Runs until `cycle` as [`run_until`](Self::run_until) does, or until one of the stops is met.
    ///
    /// # Errors
    /// The core locked up.
    pub fn run_until_met(&mut self, cycle: u64, stops: &Stops) -> Result<Option<Met>, Stopped> {
        while self.now < cycle {
            let at = self.registers.r[15];
            if stops.breakpoints.contains(&at) && !self.soc.cpu.is_asleep() {
                return Ok(Some(Met::Breakpoint(at)));
            }
            let ran = self.advance::<false>(cycle)? && !self.soc.cpu.is_asleep();
            let at = self.registers.r[15];
            if ran && stops.step.as_ref().is_some_and(|range| !range.contains(&at)) {
                return Ok(Some(Met::Step));
            }
        }
        self.clock.set(self.now);
        Ok(None)
    }

    pub fn core_registers(&self) -> Registers {
        let cpu = &self.soc.cpu;
        let from = cpu.regs();
        let mut float = [0; 32];
        for (number, value) in (0..).zip(&mut float) {
            *value = cpu.s(number);
        }
        let system = [
            from.msp,
            from.psp,
            from.primask.into(),
            from.basepri.into(),
            from.faultmask.into(),
            from.control,
        ];
        Registers { core: from.r, xpsr: from.xpsr, system, float, fpscr: cpu.fpscr() }
    }

    /// Writes the core's registers. SP and the stack pointer in use are one register. If both values differ, a changed
    /// SP has precedence.
    pub fn set_core_registers(&mut self, to: &Registers) {
        let before = self.core_registers();
        self.set_registers(|registers| {
            let [msp, psp, primask, basepri, faultmask, control] = to.system;
            registers.r = to.core;
            registers.r[15] &= !1;
            (registers.msp, registers.psp) = (msp, psp);
            if to.core[SP] != before.core[SP] {
                let thread = before.xpsr & 0x1FF == 0 && before.system[5] & SPSEL != 0;
                *(if thread { &mut registers.psp } else { &mut registers.msp }) = to.core[SP];
            }
            registers.xpsr = to.xpsr;
            registers.primask = primask & 1 != 0;
            registers.faultmask = faultmask & 1 != 0;
            registers.basepri = (basepri & 0xF0) as u8;
            registers.control = control;
        });
        for (number, value) in (0..).zip(to.float) {
            self.soc.cpu.set_s(number, value);
        }
        self.soc.cpu.set_fpscr(to.fpscr);
    }

    /// Reads memory or registers without the side effects of a read by the core. Returns how many of the bytes exist.
    pub fn look(&mut self, address: u32, into: &mut [u8]) -> usize {
        self.clock.set(self.now);
        let mut done = 0;
        while done < into.len() {
            let Some(at) = u32::try_from(done).ok().and_then(|done| address.checked_add(done))
            else {
                break;
            };
            let word = if in_ppb(at) && !in_vendor_ppb(at) {
                self.soc.cpu.with_sys(|sys| sys.read_word(at & !3, true))
            } else {
                let word = self.soc.space.read((at & !3).into(), Width::U32, MemAttrs::DEBUG);
                word.ok().and_then(|word| u32::try_from(word).ok())
            };
            let Some(word) = word else { break };
            for byte in &word.to_le_bytes()[(at & 3) as usize..] {
                if let Some(to) = into.get_mut(done) {
                    *to = *byte;
                    done += 1;
                }
            }
        }
        done
    }

    /// Writes memory or registers in a halt as the core would, but TIM1's outputs stay off.
    ///
    /// # Errors
    /// No writable memory has this address.
    pub fn put(&mut self, halt: &mut Halt, address: u32, from: &[u8]) -> Result<(), Refused> {
        let end = address.checked_add(u32::try_from(from.len()).unwrap_or(u32::MAX));
        let end = end.ok_or(Refused::Nothing)?;
        let flash_bytes = u32::try_from(self.chip.flash_bytes).unwrap_or_default();
        if address < FLASH + flash_bytes && end > FLASH {
            return Err(Refused::Flash);
        }
        if address >= RAM && end <= RAM + RAM_BYTES {
            self.write(address, from);
            return Ok(());
        }
        let (mut at, mut rest) = (address, from);
        while !rest.is_empty() {
            let (width, bytes) = match (at % 4, rest.len()) {
                (0, 4..) => (Width::U32, 4u8),
                (0 | 2, 2..) => (Width::U16, 2),
                _ => (Width::U8, 1),
            };
            let (now, later) = rest.split_at(bytes.into());
            self.put_piece(at, width, now)?;
            if at & !3 == TIM1_BDTR {
                self.mask_outputs(halt);
            }
            (at, rest) = (at + u32::from(bytes), later);
        }
        Ok(())
    }

    fn put_piece(&mut self, at: u32, width: Width, bytes: &[u8]) -> Result<(), Refused> {
        self.clock.set(self.now);
        self.forget_flash();
        let mut word = [0; 4];
        let done = if in_ppb(at) && !in_vendor_ppb(at) {
            let start = (at & 3) as usize;
            self.soc.cpu.with_sys(|sys| {
                word = sys.read_word(at & !3, true)?.to_le_bytes();
                word[start..start + bytes.len()].copy_from_slice(bytes);
                Some(sys.write_word(at & !3, u32::from_le_bytes(word)))
            }) == Some(true)
        } else {
            word[..bytes.len()].copy_from_slice(bytes);
            let value = u32::from_le_bytes(word).into();
            self.soc.space.write(at.into(), width, value, MemAttrs::default()).is_ok()
        };
        self.service();
        if done { Ok(()) } else { Err(Refused::Nothing) }
    }
}
