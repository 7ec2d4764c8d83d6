//! The newest value of something, from a task to one that preempts it: two buffers and a pointer to
//! the one that counts.
//!
//! The reader takes a reference and nothing else: no copy, no check, one load. That is sound only
//! because of who uses it. The reader runs above the writer on a single core, so from where the
//! writer stands a whole pass of the reader takes no time: it comes before the pointer is changed,
//! and sees the old buffer, or after it, and sees the new one. The buffer that is written is never
//! the one that counts. For the same reason the order of the stores is the compiler's matter only.

use core::{
    cell::UnsafeCell,
    marker::PhantomData,
    mem::MaybeUninit,
    ptr,
    sync::atomic::{
        AtomicPtr,
        Ordering::{Acquire, Relaxed, Release},
        compiler_fence,
    },
};

use super::Static;

/// Two buffers, one of which holds the newest `T`.
pub struct DoubleBuffer<T> {
    buffers: [UnsafeCell<MaybeUninit<T>>; 2],
    /// The buffer that counts. Stored by the publisher only; null before the ends are made.
    newest: AtomicPtr<T>,
}

// SAFETY: see the module: the buffer that counts is only read, the other one only written, each by
// one task.
unsafe impl<T: Send + Sync> Sync for DoubleBuffer<T> {}

pub struct DoubleBufferWriter<T: 'static>(&'static DoubleBuffer<T>);

/// The reading end, for a task of higher priority than the publisher's, of the buffers that `P` names.
pub struct DoubleBufferReader<T: 'static, P>(PhantomData<(*const T, P)>);

// SAFETY: it is moved to its task once, before the task first runs; `*const T` only keeps it from
// being shared.
unsafe impl<T: Send + Sync, P> Send for DoubleBufferReader<T, P> {}

impl<T: Copy> DoubleBuffer<T> {
    /// Without a value yet.
    pub const fn new() -> Self {
        Self {
            buffers: [const { UnsafeCell::new(MaybeUninit::uninit()) }; 2],
            newest: AtomicPtr::new(ptr::null_mut()),
        }
    }

    /// The two ends of those that `P` names, with `value` published. To be called once: there are no others.
    pub fn split<P: Static<Self>>(value: T) -> (DoubleBufferWriter<T>, DoubleBufferReader<T, P>) {
        let buffer = P::place();
        while !buffer.newest.load(Relaxed).is_null() {} // before any output is on
        let first = buffer.buffers[0].get();
        // SAFETY: there are no ends yet, and nobody else has got this far.
        let first = unsafe { (*first).write(value) };
        buffer.newest.store(first, Relaxed);
        (DoubleBufferWriter(buffer), DoubleBufferReader(PhantomData))
    }
}

impl<T: Copy + 'static> DoubleBuffer<T> {
    /// What counts now, for a task below the writer that knows that nothing is published meanwhile; none if something was.
    pub fn look<P: Static<Self>>() -> Option<T> {
        let buffer = P::place();
        let newest = buffer.newest.load(Relaxed);
        if newest.is_null() {
            return None;
        }
        compiler_fence(Acquire);
        // SAFETY: in place and aligned. It is a whole value only if nobody has published meanwhile, see below.
        let copy = unsafe { newest.cast::<MaybeUninit<T>>().read_volatile() };
        compiler_fence(Acquire);
        // SAFETY: the buffer that counts is written by nobody, and it has counted all the time.
        ptr::eq(buffer.newest.load(Relaxed), newest).then(|| unsafe { copy.assume_init() })
    }
}

impl<T: Copy> DoubleBufferWriter<T> {
    /// The value that counts now.
    #[inline(always)]
    pub fn newest(&self) -> &T {
        // SAFETY: not null, because the ends exist; only this end writes, and not while it is borrowed.
        unsafe { &*self.0.newest.load(Relaxed) }
    }

    /// From the reader's next pass on this is what counts, whole.
    #[inline(always)]
    pub fn publish(&mut self, value: T) {
        let [first, second] = &self.0.buffers;
        let newest = self.0.newest.load(Relaxed);
        let [first, second] = [first, second].map(|buffer| buffer.get().cast::<T>());
        let free = if ptr::eq(newest, first) { second } else { first };
        // SAFETY: nobody reads this buffer, see the module.
        unsafe { free.write(value) };
        compiler_fence(Release);
        self.0.newest.store(free, Relaxed);
    }
}

impl<T: Copy, P: Static<DoubleBuffer<T>>> DoubleBufferReader<T, P> {
    /// What counts now. The reference must not outlive this pass of the task, which the borrow of
    /// `self` sees to as long as the task's function ends.
    #[inline(always)]
    pub fn get(&mut self) -> &T {
        let newest = P::place().newest.load(Relaxed);
        compiler_fence(Acquire);
        // SAFETY: not null, because the ends exist; nobody writes this buffer while this task runs,
        // see the module.
        unsafe { &*newest }
    }
}
