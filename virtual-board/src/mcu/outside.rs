//! Drives the inputs of the chip from outside: pins, the emergency stop and the supply.

use super::{Mcu, Pin, SUPPLY_IRQ};

impl Mcu {
    pub fn set_pin(&mut self, pin: Pin, high: bool) {
        self.outside.insert(pin, (high, None));
        self.soc.set_pin(pin, high);
    }

    /// Drives the pins from outside again after a reset. A reset moves no switch.
    pub(super) fn drive_pins(&self) {
        for (pin, (high, alternate)) in &self.outside {
            self.soc.set_pin(*pin, *high);
            if let Some(high) = alternate {
                self.soc.set_alternate(*pin, *high);
            }
        }
    }

    /// Drives the pin of TIM1's break input, which is active high.
    pub fn set_break(&mut self, open: bool) {
        self.clock.set(self.now);
        if let Some(pin) = self.listeners.stop {
            // The emulator's port takes the level of an alternate-function pin from inside the chip. So the level of
            // the alternate function is also set.
            self.outside.insert(pin, (open, Some(open)));
        }
        self.drive_pins();
        self.soc.set_break(open);
    }

    /// Sets the supply, in mV. The initial supply is [`SUPPLY_MV`](super::SUPPLY_MV). The supply affects only the
    /// voltage detector.
    pub fn set_supply_mv(&mut self, mv: u32) {
        self.clock.set(self.now);
        self.soc.supply.set_mv(mv);
        self.soc.cpu.set_irq(SUPPLY_IRQ, self.soc.supply_line.get());
    }
}
