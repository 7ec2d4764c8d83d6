//! A host's link to a board: the bytes of the RTT channels, and whether the board is connected. [`Link`] is the same
//! for a virtual board and a real board.

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

/// Number of the firmware's up channels. They carry the log, the telemetry and the replies.
pub const UP_CHANNELS: usize = 3;
pub const LOG: usize = 0;
pub const TELEMETRY: usize = 1;
pub const REPLIES: usize = 2;
pub const COMMANDS: usize = 0;

/// Time between two checks of a channel.
const LOOK: Duration = Duration::from_millis(1);
/// Time after which a client that reads nothing is disconnected. The board does not wait for this client.
const PATIENCE: Duration = Duration::from_secs(10);

/// Converts the result of reading or writing a non-blocking stream. `None` means that the stream is not ready.
fn at_once(done: io::Result<usize>) -> io::Result<Option<usize>> {
    match done {
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
            Ok(None)
        }
        done => done.map(Some),
    }
}

/// The channels of a board. No function of this trait waits.
pub trait Link: Send {
    /// Appends the bytes that up channel `channel` has received since the last read.
    fn read(&mut self, channel: usize, into: &mut Vec<u8>);

    /// Sends bytes down channel `channel`. Returns how many bytes had room.
    fn write(&mut self, channel: usize, bytes: &[u8]) -> usize;

    /// The reason why the board is lost. `None` while it is connected.
    fn lost(&self) -> Option<String>;
}
