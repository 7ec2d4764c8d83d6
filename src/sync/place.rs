//! The memory of a task, part of which a task that it preempts may copy, at no cost to the owner.
//!
//! The owner works in its place as if nobody looked. That is sound only because of who uses it: the owner runs above
//! the viewer on a single core, so from where the viewer stands a whole pass of the owner takes no time, and between two of
//! them nobody holds a reference. A pass may come in the middle of a copy; then the number that each pass counts up has
//! moved between the copy before and the copy after, and the viewer copies once more. Passes are far apart (a sample),
//! so that happens once at most.

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

/// What a task owns: what may be seen, and the rest.
pub struct Shown<S, R> {
    /// A viewer may copy this.
    pub shown: S,
    pub rest: R,
}

/// Static place of a task's data.
pub struct Place<S, R> {
    taken: AtomicBool,
    value: UnsafeCell<MaybeUninit<Shown<S, R>>>,
}

// SAFETY: one owner, see `take`; the viewer only copies what is `Copy`, see the module.
unsafe impl<S: Copy + Send, R: Send> Sync for Place<S, R> {}

/// Names a place in static memory.
pub trait Placed: Static<Place<Self::Shown, Self::Rest>> {
    /// What may be seen.
    type Shown: Copy + Send + 'static;
    /// The rest, which no viewer sees.
    type Rest: Send + 'static;

    /// Another number with every pass of the owner.
    fn number(shown: &Self::Shown) -> u64;
}

/// The owner's end of a place.
pub struct Owner<P>(PhantomData<P>);

/// The viewer's, for a task of lower priority.
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
    /// Both ends, with that value in the place. To be called once: there is no second owner.
    pub fn take(shown: P::Shown, rest: P::Rest) -> (Self, Viewer<P>) {
        let place = P::place();
        while place.taken.swap(true, Relaxed) {} // before any output is on
        // SAFETY: nobody else has got this far, and there are no ends yet.
        unsafe { (*place.value.get()).write(Shown { shown, rest }) };
        (Self(PhantomData), Viewer(PhantomData))
    }

    /// The data, for one pass of the owner.
    #[inline(always)]
    pub fn get(&mut self) -> &mut Shown<P::Shown, P::Rest> {
        // SAFETY: written before this end was made, the only one; the viewer cannot run meanwhile, see the module.
        unsafe { (*P::place().value.get()).assume_init_mut() }
    }
}

impl<P: Placed> Viewer<P> {
    fn copy(&self) -> P::Shown {
        let place = P::place().value.get().cast::<Shown<P::Shown, P::Rest>>();
        compiler_fence(Acquire);
        // SAFETY: in place, aligned, and written before this end was made. Words that a pass changes meanwhile are
        // whole words of the old value or the new one.
        let copy = unsafe { (&raw const (*place).shown).read_volatile() };
        compiler_fence(Acquire);
        copy
    }

    /// What `see` says of it as the owner's last pass has left it, without a copy.
    #[inline(always)]
    pub fn look<R>(&self, see: impl Fn(&P::Shown) -> R) -> R {
        let place = P::place().value.get().cast::<Shown<P::Shown, P::Rest>>();
        loop {
            // SAFETY: in place, aligned, and written before this end was made. What a pass changes meanwhile are whole words
            // of the old value or the new one, and what was seen of both is thrown away.
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

    /// As the owner's last pass has left it.
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
