//! The memory of a task, its owner. Another task, the viewer, may copy a part of it. The owner preempts the viewer, and
//! has no work because of the copy.
//!
//! The owner works in its place and ignores the viewer. Without a lock, this is sound only because the owner preempts
//! the viewer on a single core. The viewer stands still during a whole pass of the owner. Between two passes no
//! reference to the data exists. Each pass counts up a number. If a pass comes during a copy, this number differs
//! before and after the copy. Then the viewer copies again. Passes are far apart (a sample), so this happens at most
//! once.

use core::{
    cell::UnsafeCell,
    marker::PhantomData,
    mem::MaybeUninit,
    sync::atomic::{
        AtomicBool,
        Ordering::{Acquire, Relaxed},
        compiler_fence,
    },
};

use super::Static;

/// Data of a task. A viewer may see only `shown`.
pub struct Shown<S, R> {
    pub shown: S,
    pub rest: R,
}

/// Static memory for a task's data.
pub struct Place<S, R> {
    taken: AtomicBool,
    value: UnsafeCell<MaybeUninit<Shown<S, R>>>,
}

// SAFETY: there is one owner, see `take`. The viewer only copies values that are `Copy`, see the module.
unsafe impl<S: Copy + Send, R: Send> Sync for Place<S, R> {}

/// Names a place in static memory.
pub trait Placed: Static<Place<Self::Shown, Self::Rest>> {
    /// The part that a viewer may see.
    type Shown: Copy + Send + 'static;
    /// The rest. No viewer sees it.
    type Rest: Send + 'static;

    /// A number that changes with every pass of the owner.
    fn number(shown: &Self::Shown) -> u64;
}

/// The owner's end of a place.
pub struct Owner<P>(PhantomData<P>);

/// The viewer's end, for a task of lower priority.
pub struct Viewer<P>(PhantomData<P>);

impl<P> Clone for Viewer<P> {
    fn clone(&self) -> Self {
        Self(PhantomData)
    }
}

impl<S, R> Place<S, R> {
    pub const fn new() -> Self {
        Self { taken: AtomicBool::new(false), value: UnsafeCell::new(MaybeUninit::uninit()) }
    }
}

impl<P: Placed> Owner<P> {
    /// Puts this data into the place, and returns its owner and its viewer. Call it only once, because there must be
    /// only one owner.
    pub fn take(shown: P::Shown, rest: P::Rest) -> (Self, Viewer<P>) {
        let place = P::place();
        while place.taken.swap(true, Relaxed) {} // before any output is on
        // SAFETY: no other call has got this far, and there is no owner or viewer yet.
        unsafe { (*place.value.get()).write(Shown { shown, rest }) };
        (Self(PhantomData), Viewer(PhantomData))
    }

    /// The data, for one pass of the owner.
    #[inline(always)]
    pub fn get(&mut self) -> &mut Shown<P::Shown, P::Rest> {
        // SAFETY: written before the only owner was made. The viewer cannot run meanwhile, see the module.
        unsafe { (*P::place().value.get()).assume_init_mut() }
    }
}

impl<P: Placed> Viewer<P> {
    fn copy(&self) -> P::Shown {
        let place = P::place().value.get().cast::<Shown<P::Shown, P::Rest>>();
        compiler_fence(Acquire);
        // SAFETY: in place, aligned, and written before the viewer was made. A pass may change words meanwhile, but
        // each word is either old or new.
        let copy = unsafe { (&raw const (*place).shown).read_volatile() };
        compiler_fence(Acquire);
        copy
    }

    /// Calls `see` with the data as they are after a pass of the owner, and returns its result. It copies no data.
    #[inline(always)]
    pub fn look<R>(&self, see: impl Fn(&P::Shown) -> R) -> R {
        let place = P::place().value.get().cast::<Shown<P::Shown, P::Rest>>();
        loop {
            // SAFETY: in place, aligned, and written before the viewer was made. A pass may change words meanwhile, but
            // each word is either old or new, and then the result is discarded.
            let shown = unsafe { &(*place).shown };
            let before = P::number(shown);
            compiler_fence(Acquire);
            let seen = see(shown);
            compiler_fence(Acquire);
            if P::number(shown) == before {
                return seen;
            }
        }
    }

    /// Returns a copy of the data after the last pass of the owner.
    pub fn read(&self) -> P::Shown {
        let mut before = P::number(&self.copy());
        loop {
            let shown = self.copy();
            let after = P::number(&self.copy());
            if before == after {
                return shown;
            }
            before = after;
        }
    }
}
