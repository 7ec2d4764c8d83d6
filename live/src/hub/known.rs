use std::collections::VecDeque;

use serde::Serialize;
use zwidth::telemetry::{Flags, Record};

/// Largest number of lines that are stored for later pages.
const LINES: usize = 2_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum From {
    /// A person, by a command.
    Person,
    /// The board, by a reply or a report.
    Board,
    Log,
    /// This program.
    Server,
}

#[derive(Clone, Debug, Serialize)]
pub struct Line {
    pub number: u64,
    pub from: From,
    pub text: String,
    /// The command that this line answers; `None` if it answers no command.
    pub answers: Option<String>,
}

/// A stop, and the time until the board reported that the force is off.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stopped {
    /// Identifier that the page gave to the stop.
    pub id: u64,
    /// Time from the arrival of the stop in this program to the board's reply, ms.
    pub ms: f64,
}

/// What is known about the board.
#[derive(Debug, Default)]
pub struct Known {
    /// The newest record of an output; records from the black box are ignored.
    pub record: Option<Record>,
    /// The last reply to `get`. `status` and `version` are the last replies to the commands of the same names.
    pub settings: String,
    /// Number of the last line before the reply to `get`.
    pub settings_after: u64,
    pub status: String,
    pub version: String,
    /// The estimators in the board's image; empty if the board has not listed them.
    pub estimators: Vec<String>,
    pub lost: Option<String>,
    /// Lines, the oldest first.
    pub lines: VecDeque<Line>,
    pub(super) numbered: u64,
    /// Numbers of received frames, of missing frames, and of bytes outside frames.
    pub counts: [u64; 3],
    pub stopped: VecDeque<Stopped>,
    pub stops: u64,
}

impl Known {
    pub(super) fn say(&mut self, from: From, text: String, answers: Option<String>) {
        self.numbered += 1;
        self.lines.push_back(Line { number: self.numbered, from, text, answers });
        if self.lines.len() > LINES {
            self.lines.pop_front();
        }
    }

    /// Whether the newest record says that the force is on.
    pub fn is_on(&self) -> bool {
        self.record.is_some_and(|record| record.flags.contains(Flags::ON))
    }
}
