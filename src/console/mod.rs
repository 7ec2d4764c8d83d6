//! The text side of the board: one command a line, one reply a line.
//!
//! ```text
//! bytes -> LineReader -> parse -> Command -> allowed -> (the board acts) -> Reply -> Text
//! ```
//!
//! Runs at low priority, whenever bytes have come. Any bytes may come: garbage is refused with a
//! reply, never believed and never a reason to stop.

mod command;
mod line;
mod number;
mod reply;
mod rules;

pub use command::{Command, GridValue, ParseError, parse, usages};
pub use line::{Line, LineReader, Text};
pub use number::Decimal;
pub use reply::Reply;
pub use rules::{Activity, Situation, allowed, signs_allowed};

/// Longest line, bytes: the longest command has 31, and a human types no more than this.
pub const LINE_MAX: usize = 64;

/// Longest reply, bytes; `help` is the longest.
pub const REPLY_MAX: usize = 640;
