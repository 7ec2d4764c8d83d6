use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering::Relaxed},
};

use rsemu::core::wire::{Level, WireId, WireSink};

#[derive(Debug, Default)]
pub(super) struct Flag(pub(super) AtomicBool);

impl Flag {
    pub(super) fn get(&self) -> bool {
        self.0.load(Relaxed)
    }

    pub(super) fn take(&self) -> bool {
        self.0.swap(false, Relaxed)
    }
}

impl WireSink for Flag {
    fn set_level(&self, _: WireId, _: u32, level: Level) {
        self.0.store(level.is_high(), Relaxed);
    }
}

/// A flag that stays set after its wire was high.
#[derive(Debug, Default)]
pub(super) struct Latch(pub(super) Arc<Flag>);

impl WireSink for Latch {
    fn set_level(&self, _: WireId, _: u32, level: Level) {
        if level.is_high() {
            self.0.0.store(true, Relaxed);
        }
    }
}
