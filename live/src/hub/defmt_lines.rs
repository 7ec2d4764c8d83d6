//! The board's log, read by its program.

use virtual_board::log;

/// A decoder with its table.
pub struct Lines {
    decoder: log::Decoder<'static>,
    waiting: Vec<u8>,
}

impl Lines {
    /// For the log of that program; none if it has no table.
    pub fn of(elf: &[u8]) -> Option<Self> {
        // Kept for good: the decoder borrows it, and there is one of each program.
        let table = Box::leak(Box::new(log::table(elf).ok()?));
        Some(Self { decoder: log::Decoder::new(table), waiting: vec![] })
    }

    /// The lines that were complete when it was last called: the replies that have come with them have been read by now.
    /// A log that makes no sense, of another program or begun in the middle, is passed over.
    pub fn feed(&mut self, bytes: Vec<u8>) -> Vec<String> {
        let bytes = std::mem::replace(&mut self.waiting, bytes);
        self.decoder.feed(&bytes).unwrap_or_default()
    }
}
