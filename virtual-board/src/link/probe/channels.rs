//! The channels of a board behind a probe. This file receives and sends bytes, and checks that the board is connected.

use std::time::{Duration, Instant};

use super::{Core, PATIENCE, Probe, rest};
use crate::{
    link::UP_CHANNELS,
    rtt::{Block, Ring, Rtt},
};

/// Time without a byte after which the link checks whether the core runs.
pub(super) const QUIET: Duration = Duration::from_millis(500);
/// Largest number of bytes of one channel that can wait for a reader. Further bytes stay on the board.
const WAITING: usize = 1 << 16;
/// Number of attempts to find out whether the board has received the sent bytes.
const TRIES: u32 = 3;
/// The message that says why a halted board is lost.
const HALTED: &str = "the core is halted, by a debugger or by its own fault: the board has to be reset. Its force is \
                      off, by hardware";

#[derive(Default)]
pub(super) struct Up {
    /// Offset of the next byte to read, and the read offset that was last written to the board.
    next: u32,
    released: u32,
    pub(super) bytes: Vec<u8>,
    /// Whether an access has served the channel since its last read.
    pub(super) fresh: bool,
}

/// The channels of a board whose control block was found.
pub(super) struct Channels {
    rtt: Rtt,
    /// Address and size of each buffer, as the program has set it up.
    buffers: [[u32; 2]; 4],
    pub(super) up: [Up; UP_CHANNELS],
    /// Time since which every access has failed. `None` if the last access succeeded.
    pub(super) failing: Option<Instant>,
    /// Time of the last byte, or of the last check that found the core running.
    heard: Instant,
    pub(super) lost: Option<String>,
}

impl Channels {
    /// Waits until the program has set up the control block.
    ///
    /// # Errors
    /// There is no control block, the block is another program's, or the core is halted. The error is one line of text.
    pub(super) fn met(probe: &mut impl Probe, rtt: Rtt) -> Result<Self, String> {
        let address = rtt.address();
        let end = Instant::now() + PATIENCE;
        loop {
            let mut core = probe.core()?;
            match rtt.look(&mut core)? {
                Some(block) if block.counts() == [3, 1] => return Ok(Self::of(rtt, &block)),
                Some(block) => {
                    let [up, down] = block.counts();
                    return Err(format!(
                        "the RTT control block at 0x{address:08x} names {up} channels up and {down} down, this \
                         firmware has 3 and 1: the board runs another program"
                    ));
                }
                None if core.is_halted()? => return Err(HALTED.to_owned()),
                None if Instant::now() > end => {
                    return Err(format!(
                        "no RTT control block at 0x{address:08x}, where the program has its _SEGGER_RTT: it is held in \
                         reset, or does not get so far"
                    ));
                }
                None => drop(core),
            }
            rest(false)?;
        }
    }

    fn of(rtt: Rtt, block: &Block) -> Self {
        let up = [0, 1, 2].map(|n| {
            let read = block.up(n).map_or(0, |ring| ring.read);
            Up { next: read, released: read, ..Up::default() }
        });
        let buffers = block.buffers();
        Self { rtt, buffers, up, failing: None, heard: Instant::now(), lost: None }
    }

    /// Reads the control block, and checks that it is still the same block.
    fn look(&self, core: &mut impl Core) -> Result<Block, String> {
        let address = self.rtt.address();
        match self.rtt.look(core)? {
            Some(block) if self.buffers == block.buffers() => Ok(block),
            Some(_) => Err(format!(
                "the RTT control block at 0x{address:08x} has other buffers than before: the board runs another program"
            )),
            None => Err(format!(
                "no RTT control block at 0x{address:08x} any more: the board is held in reset, or runs another program"
            )),
        }
    }

    /// Takes the received bytes of all channels.
    ///
    /// # Errors
    /// The control block is missing or could not be reached. The error is one line of text. Bytes that were taken
    /// before the error are kept.
    pub(super) fn exchange(&mut self, core: &mut impl Core) -> Result<(), String> {
        let block = self.look(core)?;
        for (n, up) in (0..).zip(&mut self.up) {
            if let Some(ring) = block.up(n) {
                match up.take(core, ring)? {
                    Some(0) => {}
                    Some(_) => self.heard = Instant::now(),
                    None => {
                        self.lost = Some(format!(
                            "another program reads up channel {n} of this board, so bytes are missing: one owner at a \
                             time"
                        ));
                    }
                }
            }
            up.fresh = true;
        }
        if self.heard.elapsed() > QUIET {
            if core.is_halted()? {
                self.lost = Some(HALTED.to_owned());
            }
            self.heard = Instant::now();
        }
        Ok(())
    }

    /// Puts bytes into the command channel. Returns how many bytes had room.
    ///
    /// # Errors
    /// No byte had room, or the board is lost. The error is one line of text.
    pub(super) fn send(&mut self, core: &mut impl Core, bytes: &[u8]) -> Result<usize, String> {
        let Some(ring) = self.look(core)?.down(0) else { return Ok(0) };
        let (count, next) = ring.fill(core, bytes)?;
        let mut failed = match ring.publish(core, next) {
            Ok(()) => return Ok(count),
            Err(error) => error,
        };
        // A command that is sent twice may be dangerous. So the link reads back whether the board has the bytes.
        for _ in 0..TRIES {
            match self.look(core) {
                Ok(block) if block.down(0).is_some_and(|now| now.write == next) => {
                    return Ok(count);
                }
                Ok(_) => return Err(failed),
                Err(error) => failed = error,
            }
        }
        self.lost = Some(format!("nobody knows whether a command has reached the board: {failed}"));
        Err(failed)
    }
}

impl Up {
    /// Takes the bytes in a channel's buffer. Returns the number of bytes. `None` if another reader has taken some
    /// bytes.
    fn take(&mut self, core: &mut impl Core, mut ring: Ring) -> Result<Option<usize>, String> {
        if ring.read == self.released {
            // The write of the read offset had failed. The bytes before `next` are not read again.
            ring.read = self.next;
        } else if ring.read == self.next || ring.read == 0 {
            // The write of the read offset had reached the board after all, or the board was reset.
            (self.next, self.released) = (ring.read, ring.read);
        } else {
            return Ok(None);
        }
        let (taken, next) = ring.copy(core, WAITING.saturating_sub(self.bytes.len()))?;
        let count = taken.len();
        self.bytes.extend(taken);
        self.next = next;
        if self.next != self.released {
            ring.release(core, next)?;
            self.released = next;
        }
        Ok(Some(count))
    }
}
