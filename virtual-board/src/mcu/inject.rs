//! Causes faults inside the chip: bits that flip, an interrupt that does not come, a program counter that jumps. The
//! program in flash stays the same.

use std::sync::atomic::Ordering::Relaxed;

use rsemu::{
    core::{space::MemAttrs, value::Width},
    cpu::arm::v7m::sys::{Exception, in_ppb},
};

use super::{Mcu, Stopped, exception_of};

/// Bits of ITSTATE and the Thumb bit in xPSR.
const IT_BITS: u32 = super::IT_BITS;
const TIM1: u32 = 0x4001_0000;
const TIM8: u32 = 0x4001_0400;
const DMA2: u32 = 0x4002_6400;

impl Mcu {
    /// Masks or unmasks an interrupt by its enable bit in the NVIC.
    pub fn mask(&mut self, exception: u16, masked: bool) {
        self.soc.cpu.with_sys(|sys| sys.set_enable(Exception(exception), !masked));
    }

    /// Runs until the core executes in `exception`. With 0 it runs until the core is awake and in no exception.
    ///
    /// # Errors
    /// The core locked up.
    ///
    /// # Panics
    /// The exception does not run within a quarter of a second.
    pub fn run_into(&mut self, exception: u16) -> Result<(), Stopped> {
        let limit = self.now + self.core_hz() / 4;
        loop {
            // One more instruction, so that the entry has ended.
            self.run_until(self.now + 1)?;
            let inside = exception_of(self.soc.cpu.xpsr()) == exception;
            if inside && !self.soc.cpu.is_asleep() {
                return Ok(());
            }
            assert!(self.now < limit, "exception {exception} is never taken");
        }
    }

    /// Runs until the program masks interrupts by BASEPRI.
    ///
    /// # Errors
    /// The core locked up.
    ///
    /// # Panics
    /// The program does not mask interrupts within a quarter of a second.
    pub fn run_into_mask(&mut self) -> Result<(), Stopped> {
        let limit = self.now + self.core_hz() / 4;
        while self.soc.cpu.regs().basepri == 0 {
            self.run_until(self.now + 1)?;
            assert!(self.now < limit, "nothing masks interrupts");
        }
        Ok(())
    }

    /// From now on a lock-up of the core is no error. Everything else runs on until the watchdog resets the core.
    pub fn outlive_lock_up(&mut self) {
        self.outlives = true;
    }

    /// Writes a word as the core would. The address can be in a peripheral, in memory or in a register of the core.
    pub fn poke(&mut self, address: u32, value: u32) {
        self.clock.set(self.now);
        self.forget_flash();
        if !self.soc.cpu.with_sys(|sys| in_ppb(address) && sys.write_word(address, value)) {
            let (at, value) = (u64::from(address), u64::from(value));
            let _ = self.soc.space.write(at, Width::U32, value, MemAttrs::default());
        }
        self.service();
    }

    /// Inverts a bit of a register of TIM1, TIM8 or DMA2, even if no store could change it.
    ///
    /// # Panics
    /// The address is not one of these registers.
    pub fn flip_behind_the_bus(&mut self, address: u32, bit: u8) {
        self.clock.set(self.now);
        let (offset, one) = (u64::from(address & 0x3FF), 1 << bit);
        let timer = match address & !0x3FF {
            DMA2 => {
                let registers = &self.soc.dma.registers;
                registers.set(offset, registers.get(offset) ^ one);
                return self.service();
            }
            TIM1 => &self.soc.pwm,
            TIM8 => &self.soc.output_timer,
            _ => panic!("{address:#x} is of none of these"),
        };
        timer.poke(offset, timer.peek(offset) ^ one);
        self.service();
    }

    /// Inverts a bit of the word that waits in DMA2's stream.
    pub fn flip_fetched(&mut self, bit: u8) {
        self.soc.dma.fetched.fetch_xor(1 << bit, Relaxed);
    }

    /// Overwrites flash from `address` on.
    pub fn program(&mut self, address: u32, bytes: &[u8]) {
        let offset = u64::from(address - super::FLASH);
        self.soc.flash.load_image(offset, bytes).expect("inside of the flash");
        self.flash_saved = None;
        self.forget_flash();
    }

    /// Reads a word as the core would.
    pub fn peek(&mut self, address: u32) -> u32 {
        self.clock.set(self.now);
        if in_ppb(address) {
            return self.soc.cpu.with_sys(|sys| sys.read_word(address, true)).unwrap_or_default();
        }
        let word = self.soc.space.read(u64::from(address), Width::U32, MemAttrs::default());
        word.map_or(0, |word| u32::try_from(word).unwrap_or_default())
    }

    /// Makes an exception pending. For an interrupt, the enable bit is also set.
    pub fn pend(&mut self, exception: u16) {
        self.soc.cpu.with_sys(|sys| {
            sys.set_enable(Exception(exception), true);
            sys.set_pending(Exception(exception), true);
        });
    }

    pub fn stack_pointer(&self) -> u32 {
        self.registers.msp
    }

    /// Inverts bits of S0 to S31 (registers 0 to 31) or of FPSCR.
    pub fn flip_float(&mut self, register: u8, bits: u32) {
        let cpu = &self.soc.cpu;
        if register < 32 {
            cpu.set_s(register, cpu.s(register) ^ bits);
        } else {
            cpu.set_fpscr(cpu.fpscr() ^ bits);
        }
    }

    pub fn set_registers(&mut self, change: impl FnOnce(&mut rsemu::cpu::arm::v7m::Regs)) {
        let mut registers = self.soc.cpu.regs();
        change(&mut registers);
        self.soc.cpu.set_regs(registers);
        self.registers = self.soc.cpu.regs();
        self.look_anew();
    }

    pub fn jump(&mut self, address: u32) {
        let cpu = &self.soc.cpu;
        cpu.set_xpsr(cpu.xpsr() & !IT_BITS);
        cpu.set_pc(address & !1);
        self.registers = cpu.regs();
        self.look_anew();
    }

    /// Freezes channel A (0) or B (1) of the encoder at its present level, or lets it work again.
    pub fn kill_channel(&mut self, channel: usize, dead: bool) {
        self.soc.encoder.kill(channel, dead);
    }

    /// Reads the registers that set the force. The first two are TIM1's compare registers of channels 1 and 2, which
    /// have magnitude and sign of a PWM. The third has the DAC's code.
    pub fn force_registers(&self) -> [u32; 3] {
        [self.soc.pwm.peek(0x34), self.soc.pwm.peek(0x38), self.soc.dac.get(0x08)]
    }
}
