//! What is known of the board, for all pages.

use std::collections::VecDeque;

use serde::Serialize;
use zwidth::telemetry::{Flags, Record};

/// Lines that are kept for pages that come later.
const LINES: usize = 2_000;

/// Who a line is from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum From {
    /// A person, to the board.
    Person,
    /// The board, in reply or by itself.
    Board,
    Log,
    /// The server: this program.
    Server,
}

/// A line of console and log.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Number that counts up.
    pub number: u64,
    pub from: From,
    pub text: String,
    /// The command that it answers, if one.
    pub answers: Option<String>,
}

/// A stop, and how long it took until the board said that the force is off.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stopped {
    /// Identifier that the page gave it.
    pub id: u64,
    /// From its arrival here to the reply, ms.
    pub ms: f64,
}

/// What is known of the board.
#[derive(Debug, Default)]
pub struct Known {
    /// The newest record that is not from the black box.
    pub record: Option<Record>,
    /// The last replies to `get`, `status` and `version`.
    pub settings: String,
    /// The last line that was said before the settings came.
    pub settings_after: u64,
    pub status: String,
    pub version: String,
    /// The estimators that its image has; none: it has not said.
    pub estimators: Vec<String>,
    /// Why there is no board any more.
    pub lost: Option<String>,
    /// Lines, the oldest first.
    pub lines: VecDeque<Line>,
    pub(super) numbered: u64,
    /// Frames that were found, that are missing, and bytes that belong to none.
    pub counts: [u64; 3],
    pub stopped: VecDeque<Stopped>,
    /// How many stops there were.
    pub stops: u64,
}

impl Known {
    /// A line more; `answers`: the command that it answers.
    pub(super) fn say(&mut self, from: From, text: String, answers: Option<String>) {
        self.numbered += 1;
        self.lines.push_back(Line { number: self.numbered, from, text, answers });
        if self.lines.len() > LINES {
            self.lines.pop_front();
        }
    }

    /// The force acts, as far as is known.
    pub fn is_on(&self) -> bool {
        self.record.is_some_and(|record| record.flags.contains(Flags::ON))
    }
}
