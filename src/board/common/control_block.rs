//! RTT's control block. It is in RAM, and the host writes there too. So the program checks a buffer's address and size
//! before each use.

/// Sizes of the buffers in bytes: up channels 0, 1 and 2, then down channel 0.
const SIZES: [u32; 4] = [4096, 8192, 1024, 256];

unsafe extern "C" {
    /// The control block that the macro `rtt_init` makes. It has a head of 24 bytes, then 24 bytes for each channel.
    static _SEGGER_RTT: u32;
}

/// Number of words that describe a channel. They are name, buffer, size, write offset, read offset and flags.
const WORDS: usize = 6;

/// Folds names, buffers and sizes of all channels into one word. After set-up a host writes only the other words of the
/// control block. So a changed sum shows that the control block is damaged.
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

/// Address of a channel's buffer, stored at set-up. A host can change the address in the control block. If the program
/// used a wrong address, it would write into the memory of a task.
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

    /// Offset, in the buffer, of the next byte that the program will read.
    pub(in crate::board) fn next_read(&self) -> u32 {
        Self::word(self.channel, 4)
    }

    /// Clears `count` bytes of the buffer that were read, beginning at offset `from`. Otherwise a flipped bit in the
    /// control block could make the program read a command twice.
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
