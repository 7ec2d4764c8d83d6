//! The channel on which the console sends its lines for people.
//!
//! If nobody reads, the last line waits until somebody reads. Until then only `stop` and `disarm` are obeyed. So
//! nothing changes without an acknowledgement.

use core::{
    fmt::{self, Write as _},
    str::FromStr,
};

use super::{Port, REPLY_MAX, Text};

/// Number of passes from one try to send a line to the next. The tries are rare, because a line on the log delays the
/// task `render` a little.
const PASSES: u8 = 32;
/// How a refusal begins that answers no command, see [`Unread`].
pub(super) const NOBODY: &str = "nobody was reading";

/// Tells a host that reads again what happened while it did not read. [`FromStr`] reads the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unread {
    /// Number of commands that were ignored.
    pub ignored: u32,
    /// Number of lines that were lost.
    pub lost: u32,
}

impl fmt::Display for Unread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { ignored, lost } = self;
        write!(f, "error: {NOBODY}: {ignored} commands ignored, {lost} lines lost")
    }
}

impl FromStr for Unread {
    type Err = ();

    /// # Errors
    /// The line is another line.
    fn from_str(line: &str) -> Result<Self, ()> {
        let told = line.strip_prefix("error: ").and_then(|line| line.strip_prefix(NOBODY));
        let numbers = told.and_then(|told| told.strip_prefix(": ")?.strip_suffix(" lines lost"));
        let numbers = numbers.and_then(|numbers| numbers.split_once(" commands ignored, "));
        let (ignored, lost) = numbers.ok_or(())?;
        let number = |digits: &str| digits.parse().map_err(|_| ());
        Ok(Self { ignored: number(ignored)?, lost: number(lost)? })
    }
}

/// The last line, and whether it was sent.
#[derive(Clone)]
pub struct ReplyChannel {
    line: Text<{ REPLY_MAX + 1 }>,
    /// Whether the line still waits, because the channel had no room.
    kept: bool,
    /// The number of lines that were lost since this line. `ignored` is the number of commands that were ignored since
    /// then.
    lost: u32,
    ignored: u32,
    /// Passes since the last try to send the line.
    passes: u8,
}

impl ReplyChannel {
    pub const fn new() -> Self {
        Self { line: Text::new(), kept: false, lost: 0, ignored: 0, passes: 0 }
    }

    /// Sends a line. The line is lost if an older line still waits.
    pub fn say(&mut self, port: &mut impl Port, line: &dyn fmt::Display) {
        if self.is_mute(port) {
            self.lost = self.lost.saturating_add(1);
        } else {
            self.tell(port, line);
        }
    }

    /// Whether a line still waits for room. Each 32nd call tries to send it again.
    pub fn is_mute(&mut self, port: &mut impl Port) -> bool {
        if self.kept {
            self.passes = self.passes.wrapping_add(1);
            if self.passes.is_multiple_of(PASSES) {
                self.try_again(port);
            }
        }
        self.kept
    }

    /// Counts a command that is ignored, because nobody would read the acknowledgement.
    pub fn ignore(&mut self) {
        self.ignored = self.ignored.saturating_add(1);
    }

    fn try_again(&mut self, port: &mut impl Port) {
        self.send(port);
        let Self { kept, lost, ignored, .. } = *self;
        if !kept && (lost > 0 || ignored > 0) {
            (self.lost, self.ignored) = (0, 0);
            self.tell(port, &Unread { ignored, lost });
        }
    }

    fn tell(&mut self, port: &mut impl Port, line: &dyn fmt::Display) {
        self.line = Text::new();
        // A line that is too long is cut. No reply is too long: see the tests.
        let _ = writeln!(self.line, "{line}");
        self.send(port);
    }

    fn send(&mut self, port: &mut impl Port) {
        self.kept = !port.write_line(self.line.as_str());
    }
}
