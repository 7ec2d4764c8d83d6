//! What the console needs of the board it runs on.

use crate::{
    LoopParameters,
    experiment::Order,
    safety::GuardedSampler,
    self_test::{Found, Part},
    store::{Loaded, Stored},
    units::Position,
};

/// Bytes in; lines, frames and orders out; settings in flash. Nothing here waits, except for flash.
pub trait Port {
    /// The commit that the program was built from, see [`Reply::Version`](super::Reply::Version).
    const COMMIT: &'static str;

    /// The next byte that was typed, if there is one.
    fn read(&mut self) -> Option<u8>;

    /// Writes one line, with its end; returns whether somebody has taken it whole.
    fn write_line(&mut self, line: &str) -> bool;

    /// Puts out a frame of telemetry, or drops it; says which.
    fn write_frame(&mut self, frame: &[u8]) -> bool;

    /// The positions of the samples up to `newest`, which is over, oldest first; and the sampler as that sample or a
    /// later one has left it. None if the positions are no longer known.
    fn samples(&mut self, newest: u64, places: &mut [Position]) -> Option<GuardedSampler>;

    /// Passes an order to the output task. There is room, because only one is under way; returns whether there was.
    fn order(&mut self, order: Order) -> bool;

    /// Whether the loop runs with these parameters, as the last answered order asked.
    fn is_in_force(&mut self, asked: &LoopParameters) -> bool;

    /// The newest settings in flash, or `defaults`.
    fn load(&mut self, defaults: Stored) -> Loaded;

    /// Tests a part of the board, with the force off.
    fn test(&mut self, part: Part) -> Found;

    /// Writes settings to flash, which stalls the processor; returns whether they are there now.
    fn save(&mut self, stored: &Stored) -> bool;
}
