//! Push without motion: the only sign of a dead encoder that free motion gives.
//!
//! In contact it says nothing, because there the wall holds the handle still on purpose: an encoder
//! that dies in contact is found only when the handle should leave the wall.

#![deny(clippy::float_arithmetic)]

use super::plan::{PUSH_COUNTS, PUSH_FORCE};
use crate::units::{Force, Position};

/// Watches for a force outside contact that moves nothing.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StuckEncoder {
    /// Outputs since the watch began; 0: not watching.
    outputs: u32,
    /// The push is into the wall.
    inward: bool,
    lowest: Position,
    highest: Position,
}

impl StuckEncoder {
    /// Takes the force that acted since the last output, and what came of it. True once the force
    /// was above 10 % in one direction, outside contact, for `limit` outputs, and the count stayed
    /// within less than 3.
    #[inline]
    pub fn failed(
        &mut self,
        force: Option<Force>,
        contact: bool,
        position: Position,
        limit: u32,
    ) -> bool {
        let force = force.map_or(0, Force::bits);
        let inward = force > 0;
        if contact || force.unsigned_abs() <= PUSH_FORCE.unsigned_abs() {
            self.outputs = 0;
            return false;
        }
        let (lowest, highest) = (self.lowest.min(position), self.highest.max(position));
        let still = highest.wrapping_since(lowest).unsigned_abs() < PUSH_COUNTS;
        if self.outputs == 0 || inward != self.inward || !still {
            *self = Self { outputs: 1, inward, lowest: position, highest: position };
            return false;
        }
        self.outputs = self.outputs.saturating_add(1);
        self.lowest = lowest;
        self.highest = highest;
        self.outputs > limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 50 ms at 1 kHz.
    const LIMIT: u32 = 50;

    /// That much above the limit.
    fn above(bits: i32) -> Force {
        Force::saturating_from_bits(PUSH_FORCE + bits)
    }

    fn out() -> Force {
        Force::saturating_from_bits(-PUSH_FORCE - 1)
    }

    /// The output at which it fails, if it does within 200.
    fn fails_at(mut step: impl FnMut(u32) -> (Force, bool, i32)) -> Option<u32> {
        let mut watch = StuckEncoder::default();
        (0..200).find(|&n| {
            let (force, contact, count) = step(n);
            watch.failed(Some(force), contact, Position::from_counts(count), LIMIT)
        })
    }

    #[test]
    fn a_dead_count_is_found_after_50_ms() {
        assert_eq!(fails_at(|_| (above(1), false, 7)), Some(50));
        assert_eq!(fails_at(|_| (out(), false, 7)), Some(50));
    }

    #[test]
    fn a_flicker_of_two_counts_is_no_motion_and_three_are() {
        let flicker = |counts: u32| {
            move |n: u32| (above(1), false, i32::from(n % 2 == 1) * counts.cast_signed())
        };
        assert_eq!(fails_at(flicker(2)), Some(50));
        assert_eq!(fails_at(flicker(3)), None);
    }

    #[test]
    fn small_forces_contact_and_changes_of_direction_start_it_anew() {
        let at_limit = above(0);
        assert_eq!(fails_at(|_| (at_limit, false, 0)), None);
        assert_eq!(fails_at(|_| (above(1), true, 0)), None);
        assert_eq!(fails_at(|n| (above(1), n == 49, 0)), Some(100));
        assert_eq!(fails_at(|n| (if n < 30 { out() } else { above(1) }, false, 0)), Some(80));
        let mut watch = StuckEncoder::default();
        assert!((0..200).all(|_| !watch.failed(None, false, Position::default(), LIMIT)));
    }
}
