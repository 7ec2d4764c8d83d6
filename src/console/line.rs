//! Collects bytes to lines, and writes text into bytes. All buffers have a fixed length.

use core::fmt;

/// Collects bytes until a line is complete. CR, LF and both together end a line. Blank lines and bytes of 0 are skipped.
/// A line of more than `N` bytes is refused as a whole at its end.
#[derive(Clone, Copy, Debug)]
pub struct LineReader<const N: usize> {
    bytes: [u8; N],
    len: usize,
    too_long: bool,
    done: bool,
}

/// A complete line, or a line that did not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line<'a> {
    /// The bytes of a line that is not blank, without the line end.
    Text(&'a [u8]),
    /// The line did not fit.
    TooLong,
}

impl<const N: usize> Default for LineReader<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> LineReader<N> {
    /// A reader that has no byte yet.
    pub const fn new() -> Self {
        Self { bytes: [0; N], len: 0, too_long: false, done: false }
    }

    /// Takes one byte. If this byte ends a line, returns the line.
    pub fn push(&mut self, byte: u8) -> Option<Line<'_>> {
        if byte == 0 {
            return None;
        }
        if self.done {
            *self = Self::new();
        }
        if !matches!(byte, b'\r' | b'\n') {
            match self.bytes.get_mut(self.len) {
                Some(place) => {
                    *place = byte;
                    self.len += 1;
                }
                None => self.too_long = true,
            }
            return None;
        }
        self.done = true;
        if self.too_long {
            return Some(Line::TooLong);
        }
        let text = self.bytes.get(..self.len)?;
        let blank = text.iter().all(u8::is_ascii_whitespace);
        (!blank).then_some(Line::Text(text))
    }
}

/// Text of at most `N` bytes. A longer text is cut off, and then ends in `~`.
#[derive(Clone, Copy, Debug)]
pub struct Text<const N: usize> {
    bytes: [u8; N],
    len: usize,
}

impl<const N: usize> Default for Text<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Text<N> {
    /// An empty text, without a byte.
    pub const fn new() -> Self {
        Self { bytes: [0; N], len: 0 }
    }

    /// Writes `value` as text, and cuts it off after `N` bytes.
    pub fn of(value: impl fmt::Display) -> Self {
        let mut text = Self::new();
        // Text that is cut off is no error here.
        let _ = fmt::write(&mut text, format_args!("{value}"));
        text
    }

    /// Bytes of the text so far.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }

    /// Returns the text, or an empty text if it is not UTF-8.
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(self.as_bytes()).unwrap_or_default()
    }
}

impl<const N: usize> fmt::Write for Text<N> {
    /// Text beyond ASCII becomes `?`, so that the text can be cut anywhere.
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let byte = u8::try_from(character).ok().filter(u8::is_ascii).unwrap_or(b'?');
            match self.bytes.get_mut(self.len) {
                Some(place) => {
                    *place = byte;
                    self.len += 1;
                }
                None => {
                    if let Some(last) = self.bytes.last_mut() {
                        *last = b'~';
                    }
                    return Err(fmt::Error);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn lines(bytes: &[u8]) -> Vec<Option<Vec<u8>>> {
        let mut reader = LineReader::<8>::new();
        bytes
            .iter()
            .filter_map(|&byte| {
                reader.push(byte).map(|line| match line {
                    Line::Text(text) => Some(text.to_vec()),
                    Line::TooLong => None,
                })
            })
            .collect()
    }

    #[test]
    fn every_line_end_ends_one_line() {
        let expected = [Some(b"ab".to_vec()), Some(b"c".to_vec())];
        for text in ["ab\nc\n", "ab\r\nc\r\n", "ab\rc\r", "\n\nab\n \t\nc\n", "ab\nc\nunfinished"] {
            assert_eq!(lines(text.as_bytes()), expected, "{text:?}");
        }
    }

    #[test]
    fn a_line_that_is_too_long_is_refused_once_and_the_next_is_taken() {
        assert_eq!(lines(b"12345678\n"), [Some(b"12345678".to_vec())]);
        assert_eq!(lines(b"123456789\nab\n"), [None, Some(b"ab".to_vec())]);
        assert_eq!(lines(&[b'x'; 1000]), []);
    }

    #[test]
    fn text_that_does_not_fit_is_cut_visibly() {
        assert_eq!(Text::<4>::of("abcd").as_str(), "abcd");
        assert_eq!(Text::<4>::of("abcde").as_str(), "abc~");
        assert_eq!(Text::<4>::of("\u{e4}b").as_str(), "?b");
        assert_eq!(Text::<0>::of("a").as_str(), "");
    }
}
