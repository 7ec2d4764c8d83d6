//! The text commands of the board: one command per line, one reply per line.
//!
//! ```text
//! bytes -> LineReader -> parse -> Command -> allowed -> dispatch -> Order -> (the output task acts) -> Report
//!                                                           └─────────────── Reply -> Text <────────────┘
//! ```
//!
//! [`Console`] contains all of this. [`Port`] is its interface to the board.
//!
//! The console runs at low priority, whenever bytes have come. Any bytes may come: garbage is refused with a reply, and
//! never stops the board.

mod command;
mod dispatch;
mod line;
mod lines;
mod number;
mod pace;
mod port;
mod refused;
mod reply;
mod reply_channel;
mod rules;
mod session;
mod spoken;

pub use command::{Command, GridValue, ParseError, parse, parse_in, usages};
pub use line::{Line, LineReader, Text};
pub use lines::is_answer;
pub use number::{Decimal, Limit};
pub use pace::Pace;
pub use port::Port;
pub use refused::{Refused, RefusedLine, Unusable};
pub use reply::Reply;
pub use reply_channel::Unread;
pub use rules::{Situation, allowed, is_off};
pub use session::Console;
pub use spoken::Spoken;

#[cfg(test)]
mod tests;

/// Length of the longest line from the host, in bytes. The longest command has 31.
pub const LINE_MAX: usize = 64;

/// Length of the longest reply, in bytes. This is the reply to `help`.
pub const REPLY_MAX: usize = 768;
