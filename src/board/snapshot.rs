//! The newest value of something, from a task to one that it preempts: one buffer and a number that
//! counts up with every value.
//!
//! The writer stores and counts, nothing else. That is sound only because of who uses it: the writer
//! runs above the reader on a single core, so the reader never sees a half-written value in place;
//! but a whole write may come in the middle of its copy. Then the number has moved, and it copies
//! once more. Writes are far apart (a sample), so that happens once at most.

use core::{
    cell::UnsafeCell,
    mem::MaybeUninit,
    sync::atomic::{
        AtomicU32,
        Ordering::{Acquire, Relaxed, Release},
        compiler_fence,
    },
};

/// The newest `T`, and how many there were; wraps.
pub struct Snapshot<T> {
    count: AtomicU32,
    value: UnsafeCell<MaybeUninit<T>>,
}

// SAFETY: see the module; there is one end of each kind.
unsafe impl<T: Send> Sync for Snapshot<T> {}

/// The writing end, for a task of higher priority than the reader's.
pub struct Writing<T: 'static>(&'static Snapshot<T>);

/// The reading end.
pub struct Reading<T: 'static> {
    snapshot: &'static Snapshot<T>,
    seen: u32,
}

impl<T: Copy> Snapshot<T> {
    /// Without a value yet.
    pub const fn new() -> Self {
        Self { count: AtomicU32::new(0), value: UnsafeCell::new(MaybeUninit::uninit()) }
    }

    /// Its two ends.
    pub fn split(&'static mut self) -> (Writing<T>, Reading<T>) {
        (Writing(self), Reading { snapshot: self, seen: 0 })
    }
}

impl<T: Copy> Writing<T> {
    /// Replaces what was there.
    #[inline(always)]
    pub fn write(&mut self, value: T) {
        let snapshot = self.0;
        // SAFETY: the reader cannot run meanwhile, see the module, and finds out afterwards.
        unsafe { (*snapshot.value.get()).write(value) };
        compiler_fence(Release);
        snapshot.count.store(snapshot.count.load(Relaxed).wrapping_add(1), Relaxed);
    }
}

impl<T: Copy> Reading<T> {
    /// The newest value, if there is one that was not read yet.
    #[inline(always)]
    pub fn read(&mut self) -> Option<T> {
        let snapshot = self.snapshot;
        let mut count = snapshot.count.load(Relaxed);
        if count == self.seen {
            return None;
        }
        loop {
            compiler_fence(Acquire);
            // SAFETY: in place and aligned; bytes that a write changes meanwhile are thrown away.
            let copy = unsafe { snapshot.value.get().read_volatile() };
            compiler_fence(Acquire);
            let after = snapshot.count.load(Relaxed);
            if after == count {
                self.seen = count;
                // SAFETY: something was written, and nothing came in between.
                return Some(unsafe { copy.assume_init() });
            }
            count = after;
        }
    }
}
