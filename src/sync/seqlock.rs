//! The newest value of something, from a task to one that it preempts: one buffer, and a number that changes with every
//! value.
//!
//! The writer only stores and numbers. This is sound only because the writer runs above the reader on a single
//! core. So the reader never sees a half-written value, but a whole write may come in the middle of its copy. Then
//! the number has changed, and the reader copies again. Writes are far apart (a sample), so this happens at most
//! once.

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

// SAFETY: see the module; there is one end of each kind.
unsafe impl<T: Send> Sync for Seqlock<T> {}

/// Writing end of the seqlock that `P` names, for a task of higher priority than the reader's.
pub struct SeqlockWriter<T: 'static, P>(PhantomData<(*const T, P)>);

// SAFETY: it is moved to its task once, before the task first runs; `*const T` only keeps it from being shared.
unsafe impl<T: Send, P> Send for SeqlockWriter<T, P> {}

pub struct SeqlockReader<T: 'static> {
    snapshot: &'static Seqlock<T>,
    seen: u32,
}

impl<T: Copy> Seqlock<T> {
    /// With a value that counts as read, with the number `u32::MAX`.
    pub const fn new(value: T) -> Self {
        Self {
            taken: AtomicBool::new(false),
            number: AtomicU32::new(u32::MAX),
            value: UnsafeCell::new(MaybeUninit::new(value)),
        }
    }

    /// The two ends of the seqlock that `P` names. Call it once.
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

    /// The stored value, to be changed in place. Call [`publish`](Self::publish) after it, before this pass of the task
    /// ends.
    #[inline(always)]
    pub fn place(&mut self) -> &mut T {
        // SAFETY: there is a value since `new`; the reader cannot run meanwhile, see the module, and notices the change
        // later.
        unsafe { (*P::place().value.get()).assume_init_mut() }
    }

    /// Makes the stored value the newest one. `number` must differ from the last value's.
    #[inline(always)]
    pub fn publish(&mut self, number: u32) {
        compiler_fence(Release);
        P::place().number.store(number, Relaxed);
    }
}

impl<T: Copy> SeqlockReader<T> {
    /// The newest value, if there is one that was not read yet.
    #[inline(always)]
    pub fn read(&mut self) -> Option<T> {
        self.read_numbered().map(|(value, _)| value)
    }

    /// The same with its number.
    #[inline(always)]
    pub fn read_numbered(&mut self) -> Option<(T, u32)> {
        let snapshot = self.snapshot;
        let mut number = snapshot.number.load(Relaxed);
        if number == self.seen {
            return None;
        }
        loop {
            compiler_fence(Acquire);
            // SAFETY: in place and aligned. If a write changes bytes meanwhile, the copy is thrown away.
            let copy = unsafe { snapshot.value.get().read_volatile() };
            compiler_fence(Acquire);
            let after = snapshot.number.load(Relaxed);
            if after == number {
                self.seen = number;
                // SAFETY: something was written, and no write came during the copy.
                return Some((unsafe { copy.assume_init() }, number));
            }
            number = after;
        }
    }
}
