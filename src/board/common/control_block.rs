//! RTT's control block. It is in RAM, and the host writes there too. So the program checks a buffer's address and size
//! before each use.

/// Sizes of the buffers of up 0 to 2 and of down 0, in the order of the control block.
const SIZES: [u32; 4] = [4096, 8192, 1024, 256];

unsafe extern "C" {
    /// The control block, as `rtt_init` has it: 24 bytes, then 24 for each channel.
    static _SEGGER_RTT: u32;
}

/// A channel's words: name, buffer, size, write, read, flags.
const WORDS: usize = 6;

/// Names, buffers and sizes of all channels, folded into one word. They do not change after set-up. A host writes only
/// the other words.
#[inline(always)]
pub(in crate::board) fn sum() -> u32 {
    let mut sum = 0u32;
    for channel in 0..SIZES.len() {
        for word in 0..3 {
            sum = sum.rotate_left(1) ^ Buffer::word(channel, word);
        }
    }
    sum
}

/// Address of a channel's buffer. A host writes into the control block. With a wrong address or size the program would
/// write into the memory of a task.
pub(in crate::board) struct Buffer {
    channel: usize,
    address: u32,
}

impl Buffer {
    pub(in crate::board) fn of(channel: usize) -> Self {
        Self { channel, address: Self::word(channel, 1) }
    }

    fn word(channel: usize, word: usize) -> u32 {
        // SAFETY: within the control block, aligned; a host may write there, hence volatile.
        unsafe { (&raw const _SEGGER_RTT).add(WORDS * (1 + channel) + word).read_volatile() }
    }

    /// Offset in the buffer of the next byte that the program reads.
    pub(in crate::board) fn next_read(&self) -> u32 {
        Self::word(self.channel, 4)
    }

    /// Clears these bytes. Otherwise a command could be read twice after a flipped bit in the control block.
    pub(in crate::board) fn clear(&self, from: u32, count: usize) {
        let Some(&size) = SIZES.get(self.channel) else { return };
        for at in (from..).take(count) {
            let place =
                core::ptr::with_exposed_provenance_mut::<u8>((self.address + at % size) as usize);
            // SAFETY: within the channel's buffer, of which only this task reads and a host writes.
            unsafe { place.write_volatile(0) };
        }
    }

    /// Whether the control block still has this buffer's address and size.
    #[inline]
    pub(in crate::board) fn holds(&self) -> bool {
        let size = SIZES.get(self.channel).copied();
        Self::word(self.channel, 1) == self.address && Some(Self::word(self.channel, 2)) == size
    }
}
