//! A queue from one task to another that never waits: one writer, one reader, each of which may
//! interrupt the other.
//!
//! `heapless::spsc` does the same, but its ends do not know the length at compile time: every step
//! divides by it and checks for zero, which is 24 cycles and a panic path in the sampling task.

use core::{
    cell::UnsafeCell,
    mem::MaybeUninit,
    sync::atomic::{AtomicU32, Ordering},
};

/// Room for `N` values, a power of two.
pub struct Queue<T, const N: usize> {
    slots: [UnsafeCell<MaybeUninit<T>>; N],
    /// Values written, ever; wraps. Stored by the writer only.
    written: AtomicU32,
    /// Values read, ever; wraps. Stored by the reader only.
    read: AtomicU32,
}

// SAFETY: a slot is touched by the writer while it is free and by the reader while it is full; the
// two counters, stored after the slot is done with, say which. There is one end of each kind.
unsafe impl<T: Send, const N: usize> Sync for Queue<T, N> {}

/// The writing end.
pub struct Writer<T: 'static, const N: usize>(&'static Queue<T, N>);

/// The reading end.
pub struct Reader<T: 'static, const N: usize>(&'static Queue<T, N>);

impl<T: Copy, const N: usize> Queue<T, N> {
    #[expect(clippy::cast_possible_truncation, reason = "at most 2^16")]
    const MASK: u32 = {
        assert!(N.is_power_of_two() && N <= 1 << 16);
        N as u32 - 1
    };

    /// Empty.
    pub const fn new() -> Self {
        Self {
            slots: [const { UnsafeCell::new(MaybeUninit::uninit()) }; N],
            written: AtomicU32::new(0),
            read: AtomicU32::new(0),
        }
    }

    /// Its two ends.
    pub fn split(&'static mut self) -> (Writer<T, N>, Reader<T, N>) {
        (Writer(self), Reader(self))
    }

    #[inline(always)]
    fn slot(&self, count: u32) -> *mut MaybeUninit<T> {
        self.slots[(count & Self::MASK) as usize].get()
    }
}

impl<T: Copy, const N: usize> Writer<T, N> {
    /// Whether there is room.
    #[inline(always)]
    pub fn has_room(&self) -> bool {
        let queue = self.0;
        let written = queue.written.load(Ordering::Relaxed);
        written.wrapping_sub(queue.read.load(Ordering::Acquire)) <= Queue::<T, N>::MASK
    }

    /// Appends `value`, or drops it if there is no room; says which.
    #[inline(always)]
    pub fn write(&mut self, value: T) -> bool {
        self.write_with(|| value)
    }

    /// Appends what `make` gives, made in its place; nothing is made if there is no room.
    #[inline(always)]
    pub fn write_with(&mut self, make: impl FnOnce() -> T) -> bool {
        let queue = self.0;
        let written = queue.written.load(Ordering::Relaxed);
        let waiting = written.wrapping_sub(queue.read.load(Ordering::Acquire));
        let room = waiting <= Queue::<T, N>::MASK;
        if room {
            // SAFETY: the slot is free, see `Sync`, and this is the only writer.
            unsafe { queue.slot(written).write(MaybeUninit::new(make())) };
            queue.written.store(written.wrapping_add(1), Ordering::Release);
        }
        room
    }
}

impl<T: Copy, const N: usize> Reader<T, N> {
    /// Takes the oldest value.
    #[inline(always)]
    pub fn read(&mut self) -> Option<T> {
        let queue = self.0;
        let read = queue.read.load(Ordering::Relaxed);
        if queue.written.load(Ordering::Acquire) == read {
            return None;
        }
        // SAFETY: the slot is full, see `Sync`, and this is the only reader.
        let value = unsafe { queue.slot(read).read().assume_init() };
        queue.read.store(read.wrapping_add(1), Ordering::Release);
        Some(value)
    }
}
