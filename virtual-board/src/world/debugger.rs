//! A debugger at the board. While the core is halted, the plant stands still.

use super::{Ended, World};
use crate::{
    board::Powered,
    mcu::{AfterHalt, Halt, Met, Refused, Stops},
};

/// A halt that has not ended.
#[derive(Debug)]
pub struct Halted {
    chip: Halt,
    begun: u64,
    /// Integral of the amplifier's command at the start of the halt.
    sum: i64,
}

impl World<'_> {
    /// Halts the core for `cycles`. The plant continues after the halt.
    pub fn halt(&mut self, cycles: u64, moe: AfterHalt) {
        self.powered.mcu.halt(cycles, moe);
        self.moved_to = self.powered.mcu.now();
    }

    /// Halts the core and the plant. An interrupted step of the plant continues after the halt.
    pub fn begin_halt(&mut self) -> Halted {
        let Powered { mcu, amplifier, .. } = &mut self.powered;
        let (sum, begun) = (amplifier.pause(mcu.now()), mcu.now());
        Halted { chip: mcu.begin_halt(), begun, sum }
    }

    /// Lets `cycles` of the halt pass. Blocks that the debugger has not stopped run on.
    pub fn stay_halted(&mut self, cycles: u64) {
        self.powered.mcu.stay_halted(cycles);
    }

    /// Ends the halt, so that the core and the plant continue.
    pub fn end_halt(&mut self, halted: &Halted, moe: AfterHalt) {
        let Powered { mcu, amplifier, .. } = &mut self.powered;
        mcu.end_halt(&halted.chip, moe);
        amplifier.go_on(mcu.now(), halted.sum);
        let cycles = mcu.now() - halted.begun;
        mcu.shift_event(cycles);
        self.moved_to += cycles;
    }

    /// Writes memory or registers in a halt, as a debugger does.
    ///
    /// # Errors
    /// The address has nothing that can be written.
    pub fn put(&mut self, halted: &mut Halted, address: u32, from: &[u8]) -> Result<(), Refused> {
        self.powered.mcu.put(&mut halted.chip, address, from)
    }

    /// Runs a sample as [`sample`](Self::sample) does, but returns early if a stop of the debugger is met. The next
    /// call completes this sample.
    pub fn sample_until_met(&mut self, stops: &Stops) -> Result<Option<Met>, Ended> {
        loop {
            let to = self.step_end();
            if let Some(met) = self.powered.mcu.run_until_met(to, stops)? {
                return Ok(Some(met));
            }
            if self.follow(to) {
                return Ok(None);
            }
        }
    }
}
