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

use rtt_target::{ChannelMode, UpChannel, rtt_init};
use zwidth::contract;

use super::control_block::Buffer;

pub type Telemetry = UpLink<1>;
pub type Replies = UpLink<2>;

pub struct Channels {
    pub telemetry: Telemetry,
    pub replies: Replies,
    pub commands: Commands,
}

/// The channel towards the host with this number. It drops a message that does not fit.
pub struct UpLink<const CHANNEL: usize>;

impl<const CHANNEL: usize> contract::UpChannel for UpLink<CHANNEL> {
    fn write(&mut self, bytes: &[u8]) -> bool {
        if !Buffer::<CHANNEL>::holds() {
            return false;
        }
        // SAFETY: the channel has been set up, and only the holder of this value uses it.
        let Some(mut channel) = (unsafe { UpChannel::conjure(CHANNEL) }) else { return false };
        channel.set_mode(ChannelMode::NoBlockSkip);
        channel.write(bytes) == bytes.len()
    }
}

pub struct Commands;

impl contract::CommandChannel for Commands {
    fn read(&mut self) -> Option<u8> {
        Buffer::<3>::take()
    }
}

/// Sets up the channels. Call it only once.
pub(in crate::board) fn init() -> Channels {
    rtt_init! {
        up: {
            0: { size: 4096, mode: ChannelMode::NoBlockSkip, name: "defmt" }
            1: { size: 8192, mode: ChannelMode::NoBlockSkip, name: "telemetry" }
            2: { size: 1024, mode: ChannelMode::NoBlockSkip, name: "replies" }
        }
        down: {
            0: { size: 256, mode: ChannelMode::NoBlockSkip, name: "commands" }
        }
    };
    Buffer::<0>::note();
    Buffer::<1>::note();
    Buffer::<2>::note();
    Buffer::<3>::note();
    Channels { telemetry: UpLink, replies: UpLink, commands: Commands }
}
