//! Passes the newest value from a task to a task that it preempts. There is one buffer, and a number that changes with
//! every value.
//!
//! The writer only stores and numbers. Without a lock, this is sound only because the writer preempts the reader on a
//! single core. So the reader never sees a half-written value. But a whole write may come while the reader copies. Then
//! the number has changed, and the reader copies again. Writes are far apart (a sample), so this happens at most once.

use core::{
    cell::UnsafeCell,
    marker::PhantomData,
    mem::MaybeUninit,
    sync::atomic::{
        AtomicBool, AtomicU32,
        Ordering::{Acquire, Relaxed, Release},
        compiler_fence,
    },
};

use super::Static;

/// The newest `T`, and its number.
pub struct Seqlock<T> {
    taken: AtomicBool,
    number: AtomicU32,
    value: UnsafeCell<MaybeUninit<T>>,
}

// SAFETY: see the module; there is one writer and one reader.
unsafe impl<T: Send> Sync for Seqlock<T> {}

/// The writer of the seqlock that `P` names. Its task must have a higher priority than the task of the reader.
pub struct SeqlockWriter<T: 'static, P>(PhantomData<(*const T, P)>);

// SAFETY: it is moved to its task once, before the task first runs. `*const T` prevents sharing.
unsafe impl<T: Send, P> Send for SeqlockWriter<T, P> {}

pub struct SeqlockReader<T: 'static> {
    snapshot: &'static Seqlock<T>,
    seen: u32,
}

impl<T: Copy> Seqlock<T> {
    /// Makes a seqlock whose first value counts as already read. Its number is `u32::MAX`.
    pub const fn new(value: T) -> Self {
        Self {
            taken: AtomicBool::new(false),
            number: AtomicU32::new(u32::MAX),
            value: UnsafeCell::new(MaybeUninit::new(value)),
        }
    }

    /// Returns writer and reader of the seqlock that `P` names. Call it only once.
    pub fn split<P: Static<Self>>() -> (SeqlockWriter<T, P>, SeqlockReader<T>) {
        let snapshot = P::place();
        while snapshot.taken.swap(true, Relaxed) {} // before any output is on
        (SeqlockWriter(PhantomData), SeqlockReader { snapshot, seen: u32::MAX })
    }
}

impl<T: Copy, P: Static<Seqlock<T>>> SeqlockWriter<T, P> {
    /// Replaces the value. `number` must differ from the last value's.
    #[inline(always)]
    pub fn write(&mut self, value: T, number: u32) {
        *self.place() = value;
        self.publish(number);
    }

    /// Returns the stored value, so that it can be changed in place. After the change call [`publish`](Self::publish),
    /// before this pass of the task ends.
    #[inline(always)]
    pub fn place(&mut self) -> &mut T {
        // SAFETY: there is a value since `new`. The reader cannot run meanwhile, see the module, and notices the change
        // later.
        unsafe { (*P::place().value.get()).assume_init_mut() }
    }

    /// Makes the stored value the newest value. `number` must differ from the last value's.
    #[inline(always)]
    pub fn publish(&mut self, number: u32) {
        compiler_fence(Release);
        P::place().number.store(number, Relaxed);
    }
}

impl<T: Copy> SeqlockReader<T> {
    /// Returns the newest value, if it was not read yet.
    #[inline(always)]
    pub fn read(&mut self) -> Option<T> {
        self.read_numbered().map(|(value, _)| value)
    }

    /// Like [`read`](Self::read), but also returns the value's number.
    #[inline(always)]
    pub fn read_numbered(&mut self) -> Option<(T, u32)> {
        let snapshot = self.snapshot;
        let mut number = snapshot.number.load(Relaxed);
        if number == self.seen {
            return None;
        }
        loop {
            compiler_fence(Acquire);
            // SAFETY: in place and aligned. If a write changes bytes meanwhile, the copy is discarded.
            let copy = unsafe { snapshot.value.get().read_volatile() };
            compiler_fence(Acquire);
            let after = snapshot.number.load(Relaxed);
            if after == number {
                self.seen = number;
                // SAFETY: a value was written, and no write came during the copy.
                return Some((unsafe { copy.assume_init() }, number));
            }
            number = after;
        }
    }
}
