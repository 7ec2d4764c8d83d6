//! The console of a board on which no task runs, because its image or its device record is refused.

use core::fmt;

use super::{Command, LINE_MAX, Line, LineReader, parse, reply::Built, spoken::Spoken};
use crate::{
    device::record::{BadRecord, LAYOUT, WORDS_MAX, WORDS_MIN},
    image::BadImage,
    safety::Fault,
};

/// The reason why no task of the board runs.
#[derive(Clone, Debug, PartialEq)]
pub enum Unusable {
    /// The image differs from the build.
    Image(BadImage),
    /// The device record is refused.
    Record(BadRecord),
}

impl From<BadImage> for Unusable {
    fn from(why: BadImage) -> Self {
        Self::Image(why)
    }
}

impl From<BadRecord> for Unusable {
    fn from(why: BadRecord) -> Self {
        Self::Record(why)
    }
}

impl fmt::Display for Unusable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Image(why) => write!(f, "fault {}: {why}", Fault::Image),
            Self::Record(why) => write!(f, "no device record: {why}"),
        }
    }
}

/// The console of a board on which no task runs.
pub struct Refused<'a> {
    board: &'a str,
    commit: &'a str,
    why: &'a Unusable,
    reader: LineReader<LINE_MAX>,
}

/// A reply of a board on which no task runs.
pub struct RefusedLine<'a> {
    board: &'a str,
    commit: &'a str,
    why: &'a Unusable,
    command: Option<Command>,
}

impl<'a> Refused<'a> {
    /// Makes the console of a board on which nothing runs, for the reason `why`. `board` is the name of the board, and
    /// `commit` is the commit of the program.
    pub fn new(board: &'a str, commit: &'a str, why: &'a Unusable) -> Self {
        Self { board, commit, why, reader: LineReader::new() }
    }

    /// The line that says why nothing runs.
    pub fn reason(&self) -> RefusedLine<'a> {
        self.line(None)
    }

    /// Takes a typed byte. Returns the reply if the byte ends a line.
    pub fn push(&mut self, byte: u8) -> Option<RefusedLine<'a>> {
        let command = match self.reader.push(byte)? {
            Line::Text(text) => parse(text).ok(),
            Line::TooLong => None,
        };
        Some(self.line(command))
    }

    fn line(&self, command: Option<Command>) -> RefusedLine<'a> {
        RefusedLine { board: self.board, commit: self.commit, why: self.why, command }
    }
}

impl fmt::Display for RefusedLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { board, commit, why, command } = self;
        match command {
            Some(Command::Help) => f.write_str("ok help, version, status"),
            Some(Command::Version) => {
                write!(f, "{}, board {board}, {why}", Built(commit))
            }
            Some(Command::Status) => write!(f, "ok status off, {why}"),
            _ => write!(f, "error: {why}; nothing runs, see help"),
        }
    }
}

impl fmt::Display for BadRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Blank => f.write_str("there is none"),
            Self::Foreign => f.write_str("what is in its place is none"),
            Self::Layout(layout) => {
                write!(f, "its layout is {layout}, this firmware takes {LAYOUT}")
            }
            Self::Length(words) => {
                write!(f, "its length is {words} words, allowed {} to {WORDS_MAX}", WORDS_MIN)
            }
            Self::Damaged => f.write_str("it is damaged: its checksum is wrong"),
            Self::Board(name) => write!(f, "it is for the board {}", name.text()),
            Self::Name => f.write_str("a name in it is no text"),
            Self::Unknown => {
                f.write_str("it has flags or numbers that this firmware does not know")
            }
            Self::Output => f.write_str("its force output is not this board's"),
            Self::Estimator(id) => write!(f, "its estimator, number {id}, is not in this image"),
            Self::Designs => f.write_str("its designs are no table"),
            Self::Envelope => f.write_str("its envelope is no table"),
            Self::Unfit => f.write_str("the board cannot run its estimator at its output period"),
            Self::Range(error) => Spoken::AT_HANDLE.refusal(error).fmt(f),
        }
    }
}

impl core::error::Error for BadRecord {}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{string::ToString, vec::Vec};

    #[test]
    fn every_command_but_three_is_refused_with_the_reason() {
        let why = BadRecord::Damaged.into();
        let mut console = Refused::new("a-board", "unknown", &why);
        let why = "its checksum is wrong";
        assert!(console.reason().to_string().starts_with("error: no device record: it is damaged"));
        let mut ask = |line: &str| {
            let replies: Vec<_> = line.bytes().filter_map(|byte| console.push(byte)).collect();
            assert_eq!(replies.len(), 1, "{line}");
            replies[0].to_string()
        };
        assert_eq!(ask("help\n"), "ok help, version, status");
        let status =
            format_args!("ok status off, no device record: it is damaged: {why}").to_string();
        assert_eq!(ask("STATUS\n"), status);
        let version = concat!("ok version ", env!("CARGO_PKG_VERSION"), ", commit unknown, board ");
        assert!(ask("version\n").starts_with(version));
        for line in ["arm\n", "k 1000\n", "save\n", "clear\n", "rubbish\n", &"x".repeat(100)] {
            let reply = ask(&std::format!("{}\n", line.trim()));
            assert!(reply.starts_with("error: no device record") && reply.contains(why), "{reply}");
        }
    }
    #[test]
    fn an_image_that_is_not_what_was_built_is_a_fault_and_says_what_to_do() {
        let why = BadImage::Unsealed.into();
        let console = Refused::new("a-board", "unknown", &why);
        assert_eq!(
            console.reason().to_string(),
            "error: fault 46 (image): it is not sealed: cargo seal ELF, then flash that; nothing runs, see help"
        );
    }
}
