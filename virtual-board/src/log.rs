//! defmt frames from RTT up channel 0.

use defmt_decoder::{DecodeError, StreamDecoder, Table};

/// Decodes the defmt stream of one ELF.
pub struct Decoder<'a> {
    stream: Box<dyn StreamDecoder + Send + Sync + 'a>,
}

/// The stream does not fit the ELF.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;

/// The table of log messages of an ELF.
///
/// # Errors
/// The ELF has none, or it cannot be read.
pub fn table(elf: &[u8]) -> Result<Table, String> {
    Table::parse(elf)
        .map_err(|error| error.to_string())?
        .ok_or_else(|| "the ELF has no defmt table".to_owned())
}

impl<'a> Decoder<'a> {
    /// A decoder at the start of a stream.
    pub fn new(table: &'a Table) -> Self {
        Self { stream: table.new_stream_decoder() }
    }

    /// Takes bytes in and returns the lines that are complete.
    ///
    /// # Errors
    /// A frame is malformed.
    pub fn feed(&mut self, bytes: &[u8]) -> Result<Vec<String>, Malformed> {
        self.stream.received(bytes);
        let mut lines = Vec::new();
        loop {
            match self.stream.decode() {
                Ok(frame) => lines.push(frame.display_message().to_string()),
                Err(DecodeError::UnexpectedEof) => return Ok(lines),
                Err(DecodeError::Malformed) => return Err(Malformed),
            }
        }
    }
}
