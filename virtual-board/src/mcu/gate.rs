//! RCC's clock and reset bits for blocks that the emulator does not model.
//!
//! Without a clock, a register reads as 0 and ignores stores (RM0090 7.3.10, RM0390 6.3.10). While the bit in RSTR is
//! set, the block stays in its reset state (RM0090 7.3.5, RM0390 6.3.5). The emulator's own blocks need no gate.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering::Relaxed},
};

use rsemu::core::{
    space::{AccessConstraints, MemAttrs, MemOps, MemResult, Region},
    wire::{Level, WireId, WireSink},
};

use super::flag::Flag;

/// A block that can be reset.
pub(super) trait Block: MemOps {
    fn reset(&self);
}

/// A block with its clock bit and its reset bit.
#[derive(Debug)]
pub(super) struct Gate {
    block: Arc<dyn Block>,
    pub(super) clocked: Arc<Flag>,
    held: AtomicBool,
}

impl Gate {
    pub(super) fn of(block: Arc<dyn Block>) -> Arc<Self> {
        Arc::new(Self { block, clocked: Arc::default(), held: AtomicBool::new(false) })
    }

    pub(super) fn region(self: &Arc<Self>) -> Region {
        Region::io("block", 0x400, Arc::clone(self) as Arc<dyn MemOps>)
    }
}

/// The block's reset line.
impl WireSink for Gate {
    fn set_level(&self, _: WireId, _: u32, level: Level) {
        self.held.store(level.is_high(), Relaxed);
        if level.is_high() {
            self.block.reset();
        }
    }
}

impl MemOps for Gate {
    fn read(&self, offset: u64, into: &mut [u8], attributes: MemAttrs) -> MemResult {
        if !self.clocked.get() {
            into.fill(0);
            return Ok(());
        }
        self.block.read(offset, into, attributes)
    }

    fn write(&self, offset: u64, from: &[u8], attributes: MemAttrs) -> MemResult {
        if self.held.load(Relaxed) || !self.clocked.get() {
            return Ok(());
        }
        self.block.write(offset, from, attributes)
    }

    fn constraints(&self) -> AccessConstraints {
        self.block.constraints()
    }
}
