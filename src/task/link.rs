//! `link`: pended by `render`, priority 1. The probe link: commands in, replies and telemetry out.

use core::sync::atomic::Ordering::Relaxed;

use heapless::spsc::{Consumer, Producer};
use zwidth::Control;

use super::{FLAGS, Record};
use crate::board;

/// The link task. It alone talks to the host, but for the logger.
pub struct Link {
    link: board::Link,
    records: Consumer<'static, Record>,
    proposals: Producer<'static, Control>,
    passes: u32,
}

impl Link {
    pub(super) fn new(
        link: board::Link,
        records: Consumer<'static, Record>,
        proposals: Producer<'static, Control>,
    ) -> Self {
        defmt::info!("zwidth on {=str}, {=u32} Hz", board::NAME, board::CORE_HZ);
        Self {
            link,
            records,
            proposals,
            passes: 0,
        }
    }

    /// Passes on what has come since. Late: records are dropped by `render`, nothing else.
    pub fn run(&mut self) {
        while let Some(record) = self.records.dequeue() {
            if record.motion.sample % 10_000 == 0 {
                defmt::info!(
                    "sample {=u64} position {=i32}",
                    record.motion.sample,
                    record.motion.position.counts()
                );
            }
        }
        self.passes = self.passes.wrapping_add(1);
        FLAGS.links.store(self.passes, Relaxed);
    }
}
