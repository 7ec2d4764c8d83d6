//! State of the board, for all pages.

use std::collections::VecDeque;

use serde::Serialize;
use zwidth::telemetry::{Flags, Record};

/// Largest count of lines that are kept for later pages.
const LINES: usize = 2_000;

/// Author of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum From {
    /// A person's command to the board.
    Person,
    /// A reply or a report of the board.
    Board,
    Log,
    /// The server: this program.
    Server,
}

/// A line of the console or the log.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Number that counts up.
    pub number: u64,
    pub from: From,
    pub text: String,
    /// The command that this line answers, if it answers one.
    pub answers: Option<String>,
}

/// A stop, and the time until the board reported that the force is off.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stopped {
    /// Identifier that the page gave to the stop.
    pub id: u64,
    /// Time from the stop's arrival in this program to the reply, ms.
    pub ms: f64,
}

/// State of the board as far as it is known.
#[derive(Debug, Default)]
pub struct Known {
    /// The newest record that is not from the black box.
    pub record: Option<Record>,
    /// The last replies to `get`, `status` and `version`.
    pub settings: String,
    /// Number of the last line before the settings came.
    pub settings_after: u64,
    pub status: String,
    pub version: String,
    /// The estimators in the board's image; empty if the board has not listed them.
    pub estimators: Vec<String>,
    /// Reason why the board is lost.
    pub lost: Option<String>,
    /// Lines, the oldest first.
    pub lines: VecDeque<Line>,
    pub(super) numbered: u64,
    /// Counts of received frames, of missing frames, and of bytes outside frames.
    pub counts: [u64; 3],
    pub stopped: VecDeque<Stopped>,
    /// Count of stops.
    pub stops: u64,
}

impl Known {
    /// Adds a line. `answers`: the command that it answers.
    pub(super) fn say(&mut self, from: From, text: String, answers: Option<String>) {
        self.numbered += 1;
        self.lines.push_back(Line { number: self.numbered, from, text, answers });
        if self.lines.len() > LINES {
            self.lines.pop_front();
        }
    }

    /// Whether the force is on, as far as is known.
    pub fn is_on(&self) -> bool {
        self.record.is_some_and(|record| record.flags.contains(Flags::ON))
    }
}
