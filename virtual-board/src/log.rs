//! Decodes defmt frames from RTT up channel 0.

use defmt_decoder::{DecodeError, StreamDecoder, Table};

/// Decodes the defmt stream of one ELF file.
pub struct Decoder<'a> {
    stream: Box<dyn StreamDecoder + Send + Sync + 'a>,
    /// The bytes of an incomplete frame. Every frame can be decoded without earlier frames.
    pub(crate) begun: Vec<u8>,
}

/// The byte at the end of a frame. The log is encoded by reverse zero-compressing COBS, so this byte occurs nowhere
/// else.
const FRAME_END: u8 = 0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;

/// The table of log messages of an ELF.
pub fn table(elf: &[u8]) -> Result<Table, String> {
    Table::parse(elf)
        .map_err(|error| error.to_string())?
        .ok_or_else(|| "the ELF has no defmt table".to_owned())
}

impl<'a> Decoder<'a> {
    pub fn new(table: &'a Table) -> Self {
        Self { stream: table.new_stream_decoder(), begun: Vec::new() }
    }

    /// Adds bytes of the stream, and returns the lines that are now complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Result<Vec<String>, Malformed> {
        let mut lines = Vec::new();
        self.begun.extend_from_slice(bytes);
        let Some(end) = self.begun.iter().rposition(|byte| *byte == FRAME_END) else {
            return Ok(lines);
        };
        self.stream.received(&self.begun[..=end]);
        self.begun.drain(..=end);
        loop {
            match self.stream.decode() {
                Ok(frame) => lines.push(frame.display_message().to_string()),
                Err(DecodeError::UnexpectedEof) => return Ok(lines),
                Err(DecodeError::Malformed) => return Err(Malformed),
            }
        }
    }
}
