//! Exchange of values between tasks of different priorities, without a lock.

#![allow(unsafe_code)]

/// Names a static `T`. The address of the static is a constant in code that knows the type. Such code loads no pointer.
pub trait Static<T: 'static>: 'static {
    /// The static. Always the same one.
    fn place() -> &'static T;
}

mod double_buffer;
mod place;
pub mod position_ring;
mod seqlock;

pub use double_buffer::{DoubleBuffer, DoubleBufferReader, DoubleBufferWriter};
pub use place::{Owner, Place, Placed, Shown, Viewer};
pub use seqlock::{Seqlock, SeqlockReader, SeqlockWriter};
