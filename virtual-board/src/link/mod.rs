//! A board as its host sees it: bytes of RTT channels, and whether there is a board at all. Whoever talks to a board
//! uses this and nothing else, so that it cannot tell a virtual one from a real one.

mod core_board;
mod gdb;
mod live;
mod probe;
mod rtt_tcp;
pub mod serve;
mod stepped;
mod wires;

use std::{
    io::{self, ErrorKind},
    time::Duration,
};

pub use crate::world::Finger;
pub use core_board::CoreBoard;
pub use live::{Begin, LiveBoard};
pub use probe::{Core, Met, Probe, ProbeLink};
pub use rtt_tcp::RttTcp;
pub use stepped::SteppedBoard;
pub use wires::{Seen, WiredLink, Wires};

/// Up channels of the firmware: log, telemetry, replies.
pub const UP_CHANNELS: usize = 3;
/// Up channel of the defmt log.
pub const LOG: usize = 0;
/// Up channel of the telemetry.
pub const TELEMETRY: usize = 1;
/// Up channel of the replies.
pub const REPLIES: usize = 2;
/// Down channel of the commands.
pub const COMMANDS: usize = 0;

/// Between two looks at a channel.
const LOOK: Duration = Duration::from_millis(1);
/// A client that takes nothing for so long is let go: the board does not wait for it meanwhile.
const PATIENCE: Duration = Duration::from_secs(10);

/// What a read or write of a stream that does not wait came to; none: not now.
fn at_once(done: io::Result<usize>) -> io::Result<Option<usize>> {
    match done {
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
            Ok(None)
        }
        done => done.map(Some),
    }
}

/// The channels of a board. Nothing here waits.
pub trait Link: Send {
    /// Appends what has come on up channel `channel` since it was last read.
    fn read(&mut self, channel: usize, into: &mut Vec<u8>);

    /// Sends bytes down channel `channel`; returns how many found room.
    fn write(&mut self, channel: usize, bytes: &[u8]) -> usize;

    /// Why there is no board any more, once that is so.
    fn lost(&self) -> Option<String>;
}
