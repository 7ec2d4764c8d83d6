//! Copies of S0 to S31. A register is fetched from the emulator when it is needed. The register is written back before
//! the emulator may need it.

use rsemu::cpu::arm::v7m::ArmV7m;

#[derive(Debug, Default)]
pub(super) struct Floats {
    values: [u32; 32],
    /// Bit n is set if register Sn was fetched. In `newer`, bit n is set if the copy of Sn is newer than the emulator's
    /// register.
    fetched: u32,
    newer: u32,
}

impl Floats {
    #[inline(always)]
    pub(super) fn get(&mut self, register: u8, cpu: &ArmV7m) -> u32 {
        let place = usize::from(register & 31);
        if self.fetched >> place & 1 == 0 {
            self.fetched |= 1 << place;
            self.values[place] = cpu.s(register & 31);
        }
        self.values[place]
    }

    #[inline(always)]
    pub(super) fn set(&mut self, register: u8, value: u32) {
        let place = usize::from(register & 31);
        self.values[place] = value;
        self.fetched |= 1 << place;
        self.newer |= 1 << place;
    }

    pub(super) fn give_back(&mut self, cpu: &ArmV7m) {
        while self.newer != 0 {
            let place = self.newer.trailing_zeros();
            self.newer &= self.newer - 1;
            let register = (place & 31) as u8;
            cpu.set_s(register, self.values[usize::from(register)]);
        }
    }

    /// Drops the copies, since the emulator may change the registers.
    pub(super) fn forget(&mut self) {
        self.fetched = 0;
    }
}
