//! Passes the newest value from a task to a task that preempts it. There are two buffers, and a pointer to the valid
//! one.
//!
//! The reader only loads a pointer. It makes no copy and no check. Without a lock, this is sound only because the
//! reader preempts the writer on a single core. The writer stands still during a whole pass of the reader. If the pass
//! comes before the pointer changes, the reader sees the old buffer. If the pass comes after the change, the reader
//! sees the new buffer. The writer never writes the valid buffer. Because there is a single core, only the compiler
//! must keep the order of the stores.

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

/// Two buffers, one of which has the newest `T`.
pub struct DoubleBuffer<T> {
    buffers: [UnsafeCell<MaybeUninit<T>>; 2],
    /// Points to the valid buffer. It is null before `split`. Only the writer changes it.
    newest: AtomicPtr<T>,
}

// SAFETY: see the module. One task only reads the valid buffer. One task only writes the other buffer.
unsafe impl<T: Send + Sync> Sync for DoubleBuffer<T> {}

pub struct DoubleBufferWriter<T: 'static>(&'static DoubleBuffer<T>);

/// The reader of the double buffer that `P` names. Its task must have a higher priority than the task of the writer.
pub struct DoubleBufferReader<T: 'static, P>(PhantomData<(*const T, P)>);

// SAFETY: it is moved to its task once, before the task first runs. `*const T` prevents sharing.
unsafe impl<T: Send + Sync, P> Send for DoubleBufferReader<T, P> {}

impl<T: Copy> DoubleBuffer<T> {
    pub const fn new() -> Self {
        Self {
            buffers: [const { UnsafeCell::new(MaybeUninit::uninit()) }; 2],
            newest: AtomicPtr::new(ptr::null_mut()),
        }
    }

    /// Returns writer and reader of the double buffer that `P` names. `value` is its first value. Call it only once.
    pub fn split<P: Static<Self>>(value: T) -> (DoubleBufferWriter<T>, DoubleBufferReader<T, P>) {
        let buffer = P::place();
        while !buffer.newest.load(Relaxed).is_null() {} // before any output is on
        let first = buffer.buffers[0].get();
        // SAFETY: there is no reader or writer yet, and no other call has got this far.
        let first = unsafe { (*first).write(value) };
        buffer.newest.store(first, Relaxed);
        (DoubleBufferWriter(buffer), DoubleBufferReader(PhantomData))
    }
}

impl<T: Copy + 'static> DoubleBuffer<T> {
    /// Copies the valid value, for a task of lower priority than the writer. Returns `None` if the writer published a
    /// new value during the copy.
    pub fn look<P: Static<Self>>() -> Option<T> {
        let buffer = P::place();
        let newest = buffer.newest.load(Relaxed);
        if newest.is_null() {
            return None;
        }
        compiler_fence(Acquire);
        // SAFETY: in place and aligned. The value is whole only if nothing was published during the copy, see below.
        let copy = unsafe { newest.cast::<MaybeUninit<T>>().read_volatile() };
        compiler_fence(Acquire);
        // SAFETY: nobody writes the valid buffer, and it was the valid one all the time.
        ptr::eq(buffer.newest.load(Relaxed), newest).then(|| unsafe { copy.assume_init() })
    }
}

impl<T: Copy> DoubleBufferWriter<T> {
    #[inline(always)]
    pub fn newest(&self) -> &T {
        // SAFETY: not null after `split`. Only this writer writes, and not while it is borrowed.
        unsafe { &*self.0.newest.load(Relaxed) }
    }

    /// Makes this value the valid one. The reader gets it as a whole, from its next pass on.
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
    /// Returns the valid value. The reference must not outlive this pass of the task. It borrows `self`, so it ends
    /// with the task's function at the latest.
    #[inline(always)]
    pub fn get(&mut self) -> &T {
        let newest = P::place().newest.load(Relaxed);
        compiler_fence(Acquire);
        // SAFETY: not null after `split`. Nobody writes this buffer while this task runs, see the module.
        unsafe { &*newest }
    }
}
