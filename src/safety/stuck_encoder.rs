//! Finds a push without motion. In free motion this is the only sign of a dead encoder.
//!
//! There are two checks while a force above 10 % of full scale acts in one direction. The first checks that the count
//! has moved at all in the last 50 ms. The second checks that in each span of 50 ms the count has moved at least as far
//! as the heaviest believable handle would. The second check finds an encoder that drifts, or follows only a part of
//! the motion. The heaviest handle is a mass and a damper, at rest when the push begins. The acting force, less 10 %
//! for friction, moves it: `v += (f - 10 %) T^2 / (m r) - v T b / m`, `x += v`, in counts and outputs.
//!
//! A handle that a person holds still is also a push without motion. In contact there is no check, because there the
//! wall holds the handle on purpose. So if an encoder dies in contact, only the next sign test finds it.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::plan::{HEAVIEST_BITS, PUSH_COUNTS, PUSH_FORCE, SafetyPlan};
use crate::units::{Force, Position};

/// The largest computed speed, a million counts per output. With it a product with `slows` does not overflow.
const SPEED_MAX: u64 = (1 << 52) - 1;

/// Finds a force outside contact that moves the handle too little.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StuckEncoder {
    /// Whether the push is into the wall.
    inward: bool,
    /// Range of the count since the last motion.
    still: Watched,
    /// Range of the count since the last comparison with the heaviest handle.
    far: Watched,
    /// Computed speed of the heaviest handle, in units of 2^-32 counts per output. `way` is its travel since the last
    /// comparison.
    speed: u64,
    way: u64,
}

/// Range of the count since a watch began.
#[derive(Clone, Copy, Debug, Default)]
struct Watched {
    /// Number of outputs since the watch began. It is 0 without a watch.
    outputs: u32,
    lowest: Position,
    highest: Position,
}

impl Watched {
    fn at(position: Position) -> Self {
        Self { outputs: 1, lowest: position, highest: position }
    }

    /// Takes the position of one more output. Returns the range of the count since the watch began, in counts.
    fn step(&mut self, position: Position) -> u32 {
        self.outputs = self.outputs.saturating_add(1);
        self.lowest = self.lowest.min(position);
        self.highest = self.highest.max(position);
        self.highest.wrapping_since(self.lowest).unsigned_abs()
    }
}

impl StuckEncoder {
    /// Takes the force that acted since the last output, and the position after it. Returns whether the count moved too
    /// little: by less than 3 counts in 50 ms, or by less than the heaviest handle in a span of 50 ms. The force must
    /// have been above 10 % in one direction, outside contact, for this time.
    #[inline]
    pub fn failed(
        &mut self,
        plan: &SafetyPlan,
        force: Option<Force>,
        contact: bool,
        position: Position,
    ) -> bool {
        let force = force.map_or(0, Force::bits);
        let inward = force > 0;
        let push = force.unsigned_abs().saturating_sub(PUSH_FORCE.unsigned_abs());
        let pushes = !contact && push > 0;
        if !pushes || self.still.outputs == 0 || inward != self.inward {
            let still = Watched { outputs: u32::from(pushes), ..Watched::at(position) };
            *self = Self { inward, still, far: still, speed: 0, way: 0 };
            return false;
        }
        let gained = (u64::from(push >> 14) * plan.yields) >> (Force::FRACTION_BITS - 14);
        let lost = ((self.speed >> 20) * u64::from(plan.slows)) >> 12;
        self.speed = self.speed.saturating_sub(lost).saturating_add(gained).min(SPEED_MAX);
        self.way = self.way.saturating_add(self.speed);
        let moved = self.far.step(position);
        let short = u64::from(moved) < self.way >> HEAVIEST_BITS;
        let over = self.far.outputs > plan.push_renders;
        if over {
            (self.far, self.way) = (Watched::at(position), 0);
        }
        if self.still.step(position) >= PUSH_COUNTS {
            self.still = Watched::at(position);
        }
        self.still.outputs > plan.push_renders || over && short
    }
}

#[cfg(test)]
#[path = "tests/stuck_encoder.rs"]
mod tests;
