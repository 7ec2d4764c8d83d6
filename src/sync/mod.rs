//! Passes values between tasks of different priorities, without a lock.

#![allow(unsafe_code)]

/// A type that stands for a static `T`. Code that knows the type has the address of the static as a constant, so it
/// loads no pointer.
pub trait Static<T: 'static>: 'static {
    /// Returns the static. Every call must return the same static.
    fn place() -> &'static T;
}

mod double_buffer;
mod place;
pub mod position_ring;
mod seqlock;

pub use double_buffer::{DoubleBuffer, DoubleBufferReader, DoubleBufferWriter};
pub use place::{Owner, Place, Placed, Shown, Viewer};
pub use seqlock::{Seqlock, SeqlockReader, SeqlockWriter};
