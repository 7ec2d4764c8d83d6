//! The probe link: RTT channels in RAM that a debug probe reads and writes while the core runs.
//!
//! | channel | carries                         | bytes | when full                    |
//! |---------|---------------------------------|-------|------------------------------|
//! | up 0    | defmt                           | 4096  | whole frames are dropped     |
//! | up 1    | telemetry, binary               | 8192  | whole frames are dropped, counted |
//! | up 2    | replies, one line of text each  | 1024  | whole lines are dropped |
//! | down 0  | commands, one line of text each | 256   | the host waits               |
//!
//! No function here waits for the host, even if a debugger writes another mode into a channel. If the control block has
//! another address or size of a buffer than at set-up, nothing is read or written. `console/reply_channel.rs` handles a
//! reply for which up 0 and up 2 have no room.

use rtt_target::{ChannelMode, DownChannel, UpChannel, rtt_init};
use zwidth::contract;

use super::control_block::Buffer;

pub use super::logger::dropped as log_dropped;

pub struct Channels {
    pub telemetry: UpLink,
    pub replies: UpLink,
    pub commands: Commands,
}

/// A channel towards the host. It drops a message that does not fit.
pub struct UpLink(UpChannel, Buffer);

impl contract::UpChannel for UpLink {
    fn write(&mut self, bytes: &[u8]) -> bool {
        if !self.1.holds() {
            return false;
        }
        self.0.set_mode(ChannelMode::NoBlockSkip);
        self.0.write(bytes) == bytes.len()
    }
}

pub struct Commands(DownChannel, Buffer);

impl contract::CommandChannel for Commands {
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        if !self.1.holds() {
            return 0;
        }
        let from = self.1.next_read();
        let count = self.0.read(bytes);
        self.1.clear(from, count);
        count
    }
}

/// Sets up the channels, and gives channel 0 to the logger. Call it only once.
pub(in crate::board) fn init() -> Channels {
    let channels = rtt_init! {
        up: {
            0: { size: 4096, mode: ChannelMode::NoBlockSkip, name: "defmt" }
            1: { size: 8192, mode: ChannelMode::NoBlockSkip, name: "telemetry" }
            2: { size: 1024, mode: ChannelMode::NoBlockSkip, name: "replies" }
        }
        down: {
            0: { size: 256, mode: ChannelMode::NoBlockSkip, name: "commands" }
        }
    };
    super::logger::start(channels.up.0, Buffer::of(0));
    Channels {
        telemetry: UpLink(channels.up.1, Buffer::of(1)),
        replies: UpLink(channels.up.2, Buffer::of(2)),
        commands: Commands(channels.down.0, Buffer::of(3)),
    }
}
