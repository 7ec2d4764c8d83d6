//! Notes the words of RAM that the program reads.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering::Relaxed},
};

use rsemu::core::space::{AccessConstraints, MemAttrs, MemOps, MemResult, RamStore, Region};

use super::{Mcu, RAM};

/// RAM that notes which words are read.
#[derive(Debug)]
pub(super) struct Noted {
    ram: Arc<RamStore>,
    words: Arc<Vec<AtomicBool>>,
}

impl Noted {
    pub(super) fn region(ram: &Arc<RamStore>, words: &Arc<Vec<AtomicBool>>) -> Region {
        let noted = Self { ram: Arc::clone(ram), words: Arc::clone(words) };
        Region::io("ram", ram.len(), Arc::new(noted))
    }
}

impl MemOps for Noted {
    fn read(&self, offset: u64, into: &mut [u8], _: MemAttrs) -> MemResult {
        let end = offset + into.len() as u64;
        for word in offset / 4..end.div_ceil(4) {
            if let Some(word) = usize::try_from(word).ok().and_then(|word| self.words.get(word)) {
                word.store(true, Relaxed);
            }
        }
        let _ = self.ram.read_at(offset, into); // the address is within its length
        Ok(())
    }

    fn write(&self, offset: u64, from: &[u8], _: MemAttrs) -> MemResult {
        let _ = self.ram.write_at(offset, from);
        Ok(())
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::ANY
    }
}

impl Mcu {
    /// Resets the chip and starts to note the words of RAM that are read. Restore a snapshot only after this call.
    pub fn note_reads(&mut self) {
        let words = self.memories.ram.len() / 4;
        self.listeners.reads = Some(Arc::new((0..words).map(|_| AtomicBool::new(false)).collect()));
        self.restart("porrst");
    }

    /// Addresses of the words of RAM that were read since [`note_reads`](Self::note_reads), in ascending order.
    pub fn words_read(&self) -> Vec<u32> {
        let words = self.listeners.reads.iter().flat_map(|words| words.iter());
        words
            .zip((RAM..).step_by(4))
            .filter(|(word, _)| word.load(Relaxed))
            .map(|(_, address)| address)
            .collect()
    }
}
