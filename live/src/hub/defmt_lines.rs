//! The board's log, read by its program.

use std::{sync::mpsc, thread};

use virtual_board::log;

/// A decoder with its table, in a thread of its own: the one borrows the other.
pub struct Lines {
    bytes: mpsc::Sender<Vec<u8>>,
    lines: mpsc::Receiver<Vec<String>>,
}

impl Lines {
    /// For the log of that program; none if it has no table.
    pub fn of(elf: Vec<u8>) -> Option<Self> {
        let table = log::table(&elf).ok()?;
        let (bytes, inside) = mpsc::channel::<Vec<u8>>();
        let (outside, lines) = mpsc::channel();
        thread::spawn(move || {
            let mut decoder = log::Decoder::new(&table);
            for bytes in inside {
                // A log that makes no sense, of another program or begun in the middle, is passed over.
                let lines = decoder.feed(&bytes).unwrap_or_default();
                if outside.send(lines).is_err() {
                    return;
                }
            }
        });
        Some(Self { bytes, lines })
    }

    /// The lines that are complete; those of these bytes may come with the next ones.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<String> {
        if !bytes.is_empty() {
            let _ = self.bytes.send(bytes.to_vec());
        }
        self.lines.try_iter().flatten().collect()
    }
}
