//! What the link says to people: each line on the log and on the channel for replies.
//!
//! A line that neither of them takes, because nobody reads, is kept until one does. Until then no
//! command is obeyed but those that end something: nothing changes without an acknowledgement.

use core::fmt::{self, Write as _};

use zwidth::console::{REPLY_MAX, Text};

use crate::board::{self, UpLink};

/// Longest piece of a line in one frame of the log, bytes. The logger keeps `render` waiting while it
/// copies one.
const LOG_LINE: usize = 200;

/// Passes between two tries: putting a line on the log holds `render` up a little.
const PASSES: u8 = 32;

/// Both channels for people.
pub struct ReplyChannel {
    replies: UpLink,
    /// The last line.
    line: Text<{ REPLY_MAX + 1 }>,
    /// Nobody has taken it yet.
    kept: bool,
    /// What came after it: lines that are lost, and commands that were not obeyed.
    lost: u32,
    ignored: u32,
    /// Passes since the last try to tell it.
    passes: u8,
}

impl ReplyChannel {
    /// Over that channel and the log.
    pub fn new(replies: UpLink) -> Self {
        Self { replies, line: Text::new(), kept: false, lost: 0, ignored: 0, passes: 0 }
    }

    /// One line on both channels; several on the log, if it is longer than a frame there.
    pub fn say(&mut self, line: &dyn fmt::Display) {
        if self.is_mute() {
            self.lost = self.lost.saturating_add(1);
        } else {
            self.tell(line);
        }
    }

    /// Whether a line waits still, for which there was no room. Tries it again now and then.
    pub fn is_mute(&mut self) -> bool {
        if self.kept {
            self.passes = self.passes.wrapping_add(1);
            if self.passes.is_multiple_of(PASSES) {
                self.try_again();
            }
        }
        self.kept
    }

    /// A command came that is not obeyed for want of an acknowledgement.
    pub fn ignore(&mut self) {
        self.ignored = self.ignored.saturating_add(1);
    }

    fn try_again(&mut self) {
        self.send();
        let Self { kept, lost, ignored, .. } = *self;
        if !kept && (lost > 0 || ignored > 0) {
            (self.lost, self.ignored) = (0, 0);
            self.tell(&format_args!(
                "error: nobody was reading: {ignored} commands ignored, {lost} lines lost"
            ));
        }
    }

    fn tell(&mut self, line: &dyn fmt::Display) {
        self.line = Text::new();
        // What is too long is cut; no reply is, see its tests.
        let _ = writeln!(self.line, "{line}");
        self.send();
    }

    /// Keeps the line unless one of the channels has taken it whole.
    fn send(&mut self) {
        let before = board::log_dropped();
        let text = self.line.as_str();
        let mut rest = text.strip_suffix('\n').unwrap_or(text);
        while let Some((piece, after)) = rest.split_at_checked(LOG_LINE) {
            defmt::info!("{=str}~", piece);
            rest = after;
        }
        defmt::info!("{=str}", rest);
        let logged = board::log_dropped() == before;
        self.kept = !(self.replies.write(text.as_bytes()) || logged);
    }
}
