//! A debugger at the board: while it halts the core, the plant stands still.

use super::{Ended, World};
use crate::{
    board::Powered,
    mcu::{AfterHalt, Halt, Met, Refused, Stops},
};

/// A halt that goes on.
#[derive(Debug)]
pub struct Halted {
    chip: Halt,
    begun: u64,
    /// Sum of the amplifier at the halt.
    sum: i64,
}

impl World<'_> {
    /// A debugger halts the core for `cycles`; the world goes on after it.
    pub fn halt(&mut self, cycles: u64, moe: AfterHalt) {
        self.powered.mcu.halt(cycles, moe);
        self.moved_to = self.powered.mcu.now();
    }

    /// The core stands from here on, and the plant with it. The plant's step is in the middle of the core's time, and
    /// goes on there.
    pub fn begin_halt(&mut self) -> Halted {
        let Powered { mcu, amplifier, .. } = &mut self.powered;
        let (sum, begun) = (amplifier.pause(mcu.now()), mcu.now());
        Halted { chip: mcu.begin_halt(), begun, sum }
    }

    /// So many cycles of it: what the debugger has not stopped runs on.
    pub fn stay_halted(&mut self, cycles: u64) {
        self.powered.mcu.stay_halted(cycles);
    }

    /// The core goes on, and the plant with it.
    pub fn end_halt(&mut self, halted: &Halted, moe: AfterHalt) {
        let Powered { mcu, amplifier, .. } = &mut self.powered;
        mcu.end_halt(&halted.chip, moe);
        amplifier.go_on(mcu.now(), halted.sum);
        let cycles = mcu.now() - halted.begun;
        mcu.shift_event(cycles);
        self.moved_to += cycles;
    }

    /// A debugger writes memory or registers in a halt.
    ///
    /// # Errors
    /// There is nothing that can be written.
    pub fn put(&mut self, halted: &mut Halted, address: u32, from: &[u8]) -> Result<(), Refused> {
        self.powered.mcu.put(&mut halted.chip, address, from)
    }

    /// One sample, or the rest of it, as [`sample`](Self::sample); or until a debugger's stop is met.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
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
