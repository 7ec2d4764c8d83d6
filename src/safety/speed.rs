//! Speed from the counts themselves, output by output: the estimate that the sampling task watches lags
//! behind by its delay, half a second at a cutoff of 0.4 Hz.

#![deny(clippy::float_arithmetic)]

use crate::units::Position;

/// Where the handle was at the last output.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SpeedWatch {
    last: Option<Position>,
}

impl SpeedWatch {
    /// Takes the position at an output; true if it is more than `limit` counts away from that at the output
    /// before. `renamed`: the count was zeroed in between.
    #[inline]
    pub fn too_fast(&mut self, position: Position, renamed: bool, limit: u32) -> bool {
        let moved = self.last.map_or(0, |last| position.wrapping_since(last).unsigned_abs());
        self.last = Some(position);
        moved > limit && !renamed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_looks_from_output_to_output_and_past_a_zero() {
        let mut watch = SpeedWatch::default();
        let mut at = |counts, renamed| watch.too_fast(Position::from_counts(counts), renamed, 1000);
        assert!(!at(500_000, false)); // the first
        assert!(!at(501_000, false) && at(502_001, false) && at(501_000, false));
        assert!(!at(0, true) && !at(-1000, false) && at(1, false));
        assert!(!at(i32::MAX, true) && !at(i32::MIN, false)); // one count, across the wrap
    }
}
