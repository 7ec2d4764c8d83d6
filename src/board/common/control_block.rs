//! RTT's control block. It is in RAM, and the host writes there too. So the program checks a buffer's address and size
//! before each use.

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Sizes of the buffers in bytes: up channels 0, 1 and 2, then down channel 0.
const SIZES: [u32; 4] = [4096, 8192, 1024, 256];
/// Number of words before the first channel, and of words that describe a channel. The latter are name, buffer, size,
/// write offset, read offset and flags.
const HEAD: usize = 6;
const WORDS: usize = 6;
const BUFFER: usize = 1;
const SIZE: usize = 2;
const WRITE: usize = 3;
const READ: usize = 4;

unsafe extern "C" {
    /// The control block that the macro `rtt_init` makes.
    static _SEGGER_RTT: u32;
}

/// Addresses of the buffers, stored at set-up. A host can change the addresses in the control block. If the program
/// used a wrong address, it would write into the memory of a task.
static ADDRESSES: [AtomicU32; SIZES.len()] = [const { AtomicU32::new(0) }; SIZES.len()];

fn place(word: usize) -> *const u32 {
    (&raw const _SEGGER_RTT).wrapping_add(word)
}

fn word(word: usize) -> u32 {
    // SAFETY: within the control block, aligned; a host may write there, hence volatile.
    unsafe { place(word).read_volatile() }
}

/// Folds half of what stays as it is after set-up into one word: name, buffer and size of each channel, or the head and
/// the stored addresses. So a changed sum shows that a channel is damaged. Its offsets and flags change.
#[inline(always)]
pub(in crate::board) fn sum(of_channels: bool) -> u32 {
    let mut sum = 0u32;
    let mut fold = |value: u32| sum = sum.rotate_left(1) ^ value;
    if of_channels {
        for channel in 0..SIZES.len() {
            (0..=SIZE).for_each(|at| fold(word(HEAD + WORDS * channel + at)));
        }
    } else {
        (0..HEAD).for_each(|at| fold(word(at)));
        for address in &ADDRESSES {
            fold(address.load(Relaxed));
        }
    }
    sum
}

/// The buffer of a channel. It has no state of its own that a flipped bit could change.
pub(in crate::board) struct Buffer<const CHANNEL: usize>;

impl<const CHANNEL: usize> Buffer<CHANNEL> {
    const SIZE: u32 = SIZES[CHANNEL];

    /// Stores the buffer's address. Call it at set-up.
    pub(in crate::board) fn note() {
        ADDRESSES[CHANNEL].store(Self::word(BUFFER), Relaxed);
    }

    fn word(at: usize) -> u32 {
        word(HEAD + WORDS * CHANNEL + at)
    }

    fn set(at: usize, value: u32) {
        // SAFETY: as in `word`.
        unsafe { place(HEAD + WORDS * CHANNEL + at).cast_mut().write_volatile(value) }
    }

    /// Whether the control block still has this buffer's address and size.
    #[inline]
    pub(in crate::board) fn holds() -> bool {
        Self::word(BUFFER) == ADDRESSES[CHANNEL].load(Relaxed) && Self::word(SIZE) == Self::SIZE
    }

    /// Takes a byte from the host, and clears its place. Otherwise a flipped bit in an offset could make the program
    /// read a command twice. If an offset lies outside the buffer, everything in the buffer is lost.
    pub(in crate::board) fn take() -> Option<u8> {
        if !Self::holds() {
            return None;
        }
        let [write, read] = [WRITE, READ].map(Self::word);
        if write.max(read) >= Self::SIZE {
            Self::set(WRITE, 0);
            Self::set(READ, 0);
            return None;
        }
        if write == read {
            return None;
        }
        let address = ADDRESSES[CHANNEL].load(Relaxed) + read;
        let place = core::ptr::with_exposed_provenance_mut::<u8>(address as usize);
        // SAFETY: within the channel's buffer, of which only this task reads and a host writes.
        let byte = unsafe { place.replace(0) };
        Self::set(READ, (read + 1) % Self::SIZE);
        Some(byte)
    }
}
