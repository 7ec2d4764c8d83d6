//! The errors, and their exit codes.

use std::{borrow::Cow, fmt, io, path::PathBuf};

/// Exit code of a command interrupted by Ctrl-C, the same as a shell reports.
pub const INTERRUPTED: u8 = 130;

/// Reason why a command ended without a result.
#[derive(Debug)]
pub enum Error {
    /// Exit code 2: the input is not valid. The text is one line: the place, the wrong value and the allowed values.
    Input(String),
    /// Exit code 1: a file could not be written, or only a part of it could be read.
    File { path: PathBuf, source: io::Error },
    /// An error of the program itself: exit code 1.
    Internal(String),
    /// Ctrl-C or a termination signal: exit code 130.
    Interrupted,
}

impl Error {
    pub fn input(text: impl fmt::Display) -> Self {
        Self::Input(text.to_string())
    }

    pub fn file(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }

    /// Puts `name` and a colon before the text of an [`Error::Input`]. Other errors stay as they are.
    #[must_use]
    pub fn of(self, name: &str) -> Self {
        match self {
            Self::Input(text) => Self::Input(format!("{name}: {text}")),
            other => other,
        }
    }

    /// The kind of the error, as a word for programs that read the output.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Input(_) => "input",
            Self::File { .. } => "file",
            Self::Internal(_) => "internal",
            Self::Interrupted => "interrupted",
        }
    }

    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input(_) => 2,
            Self::File { .. } | Self::Internal(_) => 1,
            Self::Interrupted => INTERRUPTED,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(text) | Self::Internal(text) => f.write_str(text),
            Self::File { path, source } => write!(f, "{}: {source}", path.display()),
            Self::Interrupted => f.write_str("interrupted; no file was left half-written"),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::File { source, .. } => Some(source),
            _ => None,
        }
    }
}

/// Largest number of characters in a message.
const LONGEST: usize = 1000;
/// Number of characters kept at the end of a shortened message, because the end has the allowed values.
const TAIL: usize = 300;

/// The text as one printable line of at most about a thousand characters. Control characters are escaped. In a longer
/// text, the middle is left out.
pub fn one_line(text: &str) -> String {
    let length = text.chars().count();
    if length <= LONGEST {
        return printable(text, false).into_owned();
    }
    let head: String = text.chars().take(LONGEST - TAIL).collect();
    let tail: String = text.chars().skip(length - TAIL).collect();
    let left_out = length - LONGEST;
    let text = format!("{head} [.. {left_out} characters ..] {tail}");
    printable(&text, false).into_owned()
}

/// The text without characters that control a terminal. With `lines`, line ends stay in the text.
pub fn printable(text: &str, lines: bool) -> Cow<'_, str> {
    let steers =
        |c: char| c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let harmful = |c: char| steers(c) && !(lines && c == '\n');
    if !text.contains(harmful) {
        return Cow::Borrowed(text);
    }
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        if harmful(c) { safe.extend(c.escape_default()) } else { safe.push(c) }
    }
    Cow::Owned(safe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_one_printable_line_of_bounded_length() {
        assert_eq!(one_line("K is 3 N/m, \u{b5}m"), "K is 3 N/m, \u{b5}m");
        assert_eq!(one_line("a\u{1b}[31m\nb\u{202e}"), "a\\u{1b}[31m\\nb\\u{202e}");
        assert_eq!(printable("a\nb\r", true), "a\nb\\r");
        let long = format!("begin {} allowed 1 to 2", "\u{1b}".repeat(100_000));
        let line = one_line(&long);
        assert!(line.starts_with("begin ") && line.ends_with(" allowed 1 to 2"));
        assert!(line.contains("[.. 99021 characters ..]") && line.len() < 7000, "{}", line.len());
    }
}
