use std::collections::VecDeque;

use serde::Serialize;
use zwidth::telemetry::{Flags, Record};

/// Largest number of lines that are stored for pages that open later.
const LINES: usize = 2_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum From {
    /// A person, who has typed a command.
    Person,
    /// The board, which has sent a reply or a report.
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
    /// The command that this line answers. `None` if the line answers no command.
    pub answers: Option<String>,
}

/// A stop, and how long it took until the board reported that the force is off.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stopped {
    /// Identifier that the page gave to the stop.
    pub id: u64,
    /// Time from the arrival of the stop in this program until the board's reply, in ms.
    pub ms: f64,
}

#[derive(Debug, Default)]
pub struct Known {
    /// The newest record of an output. Records from the black box are not stored here.
    pub record: Option<Record>,
    /// The board's last reply to `get`. `status` and `version` have the last replies to the commands of these names.
    pub settings: String,
    /// Number of the last line that came before the reply to `get`.
    pub settings_after: u64,
    pub status: String,
    pub version: String,
    /// The estimators in the board's image. Empty if the board has not listed them yet.
    pub estimators: Vec<String>,
    pub lost: Option<String>,
    /// Lines, the oldest first.
    pub lines: VecDeque<Line>,
    pub(super) numbered: u64,
    /// Three numbers: received frames, missing frames, and bytes outside frames.
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
