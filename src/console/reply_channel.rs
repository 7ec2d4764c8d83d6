//! The console's lines for people.
//!
//! If nobody reads, the last line is kept until somebody does. Until then only commands that end something are obeyed,
//! so that nothing changes without an acknowledgement.

use core::fmt::{self, Write as _};

use super::{Port, REPLY_MAX, Text};

/// Passes between two tries, because a line on the log delays the output task a little.
const PASSES: u8 = 32;

/// The last line, and whether it is out.
#[derive(Clone)]
pub struct ReplyChannel {
    line: Text<{ REPLY_MAX + 1 }>,
    /// Nobody has taken it yet.
    kept: bool,
    /// Counts since this line: lines that were lost, and commands that were not obeyed.
    lost: u32,
    ignored: u32,
    /// Passes since the last try to send it.
    passes: u8,
}

impl ReplyChannel {
    pub const fn new() -> Self {
        Self { line: Text::new(), kept: false, lost: 0, ignored: 0, passes: 0 }
    }

    /// Sends a line; it is lost while another one waits.
    pub fn say(&mut self, port: &mut impl Port, line: &dyn fmt::Display) {
        if self.is_mute(port) {
            self.lost = self.lost.saturating_add(1);
        } else {
            self.tell(port, line);
        }
    }

    /// Whether a line still waits for room. Tries to send it again now and then.
    pub fn is_mute(&mut self, port: &mut impl Port) -> bool {
        if self.kept {
            self.passes = self.passes.wrapping_add(1);
            if self.passes.is_multiple_of(PASSES) {
                self.try_again(port);
            }
        }
        self.kept
    }

    /// A command came that is not obeyed, because nobody would read the acknowledgement.
    pub fn ignore(&mut self) {
        self.ignored = self.ignored.saturating_add(1);
    }

    fn try_again(&mut self, port: &mut impl Port) {
        self.send(port);
        let Self { kept, lost, ignored, .. } = *self;
        if !kept && (lost > 0 || ignored > 0) {
            (self.lost, self.ignored) = (0, 0);
            self.tell(
                port,
                &format_args!(
                    "error: nobody was reading: {ignored} commands ignored, {lost} lines lost"
                ),
            );
        }
    }

    fn tell(&mut self, port: &mut impl Port, line: &dyn fmt::Display) {
        self.line = Text::new();
        // A line that is too long is cut. No reply is: see the tests.
        let _ = writeln!(self.line, "{line}");
        self.send(port);
    }

    fn send(&mut self, port: &mut impl Port) {
        self.kept = !port.write_line(self.line.as_str());
    }
}
