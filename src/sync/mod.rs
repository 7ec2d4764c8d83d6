//! What goes between tasks of different priorities without a lock.

#![allow(unsafe_code)]

mod double_buffer;
pub mod position_ring;
mod seqlock;

pub use double_buffer::{DoubleBuffer, DoubleBufferReader, DoubleBufferWriter};
pub use seqlock::{Seqlock, SeqlockReader, SeqlockWriter};
