//! Reads the level of a pin or holds it low, through the registers of the pin's port. This works whatever peripheral
//! drives the pin.

use core::ptr;

#[derive(Clone, Copy)]
pub struct BoardPin {
    /// Address of the port.
    port: u32,
    /// Number in the port, 0 to 15.
    number: u32,
}

/// Address of GPIOA. The other ports follow, `PORT_BYTES` apart.
const GPIOA: u32 = 0x4002_0000;
const PORT_BYTES: u32 = 0x400;
/// Offsets of three registers of a port: the modes of its pins (MODER), their levels (IDR), and the register that sets
/// and clears outputs (BSRR).
const MODE: u32 = 0x00;
const INPUT: u32 = 0x10;
const SET_CLEAR: u32 = 0x18;

impl BoardPin {
    /// The pin with this port letter and this number in the data sheet.
    pub const fn new(port: char, number: u32) -> Self {
        Self { port: GPIOA + PORT_BYTES * (port as u32 - 'A' as u32), number }
    }

    fn read(self, offset: u32) -> u32 {
        let address = (self.port + offset) as usize;
        // SAFETY: a register of this chip, aligned, whose reading has no effect.
        unsafe { ptr::read_volatile(ptr::without_provenance::<u32>(address)) }
    }

    pub fn is_high(self) -> bool {
        self.read(INPUT) >> self.number & 1 != 0
    }

    /// Makes the pin an output of its port and drives it low, whatever its mode was before.
    #[cold]
    pub fn hold_low(self) {
        let Self { port, number } = self;
        let mode = self.read(MODE) & !(0b11 << (2 * number)) | 0b01 << (2 * number);
        // SAFETY: registers of this chip. The pin is first set low, then made an output. Nothing else in this program
        // writes these registers after `init`.
        unsafe {
            ptr::without_provenance_mut::<u32>((port + SET_CLEAR) as usize)
                .write_volatile(1 << (16 + number));
            ptr::without_provenance_mut::<u32>((port + MODE) as usize).write_volatile(mode);
        }
    }
}
