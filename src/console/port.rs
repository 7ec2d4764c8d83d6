//! The console's interface to the board.

use crate::{
    LoopParameters,
    experiment::Order,
    safety::GuardedSampler,
    self_test::{Found, Part},
    store::{Loaded, Stored},
    units::Position,
};

/// What the console needs from the board. It reads bytes, and sends lines, telemetry frames and orders. It reads and
/// writes the settings in flash. Only flash makes the console wait.
pub trait Port {
    /// The commit that the program was built from, see [`Reply::Version`](super::Reply::Version).
    const COMMIT: &'static str;

    /// The next byte that was typed, if there is one.
    fn read(&mut self) -> Option<u8>;

    /// Writes one line with its end. Returns whether a channel took all of it. If the board has two channels and the
    /// line is in one of them, the other one must later get [`Unread`](super::Unread).
    fn write_line(&mut self, line: &str) -> bool;

    /// Sends or drops a frame of telemetry. Returns whether it was sent.
    fn write_frame(&mut self, frame: &[u8]) -> bool;

    /// Fills `places` with the positions of the last samples up to `newest`, oldest first. Returns the sampler as it is
    /// after `newest` or a later sample. The sample `newest` must be complete. Returns `None` if these positions are no
    /// longer stored.
    fn samples(&mut self, newest: u64, places: &mut [Position]) -> Option<GuardedSampler>;

    /// Passes an order to the task `render`. Returns whether there was room. There is always room, because only one
    /// order is under way.
    fn order(&mut self, order: Order) -> bool;

    /// Whether the loop runs with these parameters, which the last answered order asked for.
    fn is_in_force(&mut self, asked: &LoopParameters) -> bool;

    /// The newest settings in flash, or `defaults`.
    fn load(&mut self, defaults: Stored) -> Loaded;

    /// Tests a part of the board, with the force off.
    fn test(&mut self, part: Part) -> Found;

    /// Writes settings to flash, which stalls the processor. Returns whether flash has these settings now.
    fn save(&mut self, stored: &Stored) -> bool;
}
