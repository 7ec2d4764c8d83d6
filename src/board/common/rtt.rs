//! The probe link: RTT channels in RAM that a debug probe reads and writes while the core runs.
//!
//! | channel | carries                         | bytes | when full                    |
//! |---------|---------------------------------|-------|------------------------------|
//! | up 0    | defmt                           | 4096  | whole frames are dropped     |
//! | up 1    | telemetry, binary               | 8192  | whole frames are dropped, counted |
//! | up 2    | replies, one line of text each  | 1024  | whole lines are dropped |
//! | down 0  | commands, one line of text each | 256   | the host waits               |
//!
//! Nothing here waits for the host, whatever mode a debugger writes into a channel, and nothing is written or read where
//! the control block does not name the buffers that it was set up with. What a reply is
//! worth when neither up 0 nor up 2 has room for it: `console/reply_channel.rs`.

use rtt_target::{ChannelMode, DownChannel, UpChannel, rtt_init};
use zwidth::contract;

pub use super::logger::dropped as log_dropped;

/// What the link task owns.
pub struct Channels {
    /// Up 1.
    pub telemetry: UpLink,
    /// Up 2.
    pub replies: UpLink,
    /// Down 0.
    pub commands: Commands,
}

/// Sizes of the buffers of up 0 to 2 and of down 0, in the order of the control block.
const SIZES: [u32; 4] = [4096, 8192, 1024, 256];

unsafe extern "C" {
    /// The control block, as `rtt_init` has it: 24 bytes, then 24 for each channel.
    static _SEGGER_RTT: u32;
}

/// A channel's words: name, buffer, size, write, read, flags.
const WORDS: usize = 6;

/// Where a channel's buffer is. The control block is in RAM, and a host writes there: a wrong address or size would send
/// what is written into the memory of a task.
pub(in crate::board) struct Buffer {
    channel: usize,
    address: u32,
}

impl Buffer {
    fn of(channel: usize) -> Self {
        Self { channel, address: Self::word(channel, 1) }
    }

    fn word(channel: usize, word: usize) -> u32 {
        // SAFETY: within the control block, aligned; a host may write there, hence volatile.
        unsafe { (&raw const _SEGGER_RTT).add(WORDS * (1 + channel) + word).read_volatile() }
    }

    /// The control block still says so.
    #[inline]
    pub(in crate::board) fn holds(&self) -> bool {
        let size = SIZES.get(self.channel).copied();
        Self::word(self.channel, 1) == self.address && Some(Self::word(self.channel, 2)) == size
    }
}

/// A channel towards the host that drops what does not fit.
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

/// The channel from the host.
pub struct Commands(DownChannel, Buffer);

impl contract::CommandChannel for Commands {
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        if self.1.holds() { self.0.read(bytes) } else { 0 }
    }
}

/// Sets up the channels; up 0 goes to the logger. Call once.
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
