//! What goes between tasks of different priorities without a lock.

#![allow(unsafe_code)]

mod double_buffer;
mod place;
pub mod position_ring;
mod seqlock;

pub use double_buffer::{DoubleBuffer, DoubleBufferReader, DoubleBufferWriter};
pub use place::{Owner, Place, Placed, Shown, Viewer};
pub use seqlock::{Seqlock, SeqlockReader, SeqlockWriter};
