//! Push without motion: the only sign of a dead encoder that free motion gives.
//!
//! Two questions, both of a force above 10 % of full scale in one direction: has the count moved at all in the last 50 ms,
//! and, in each span of 50 ms, as far as the heaviest believable handle would have? The second takes an encoder that follows
//! a part of the motion only, or drifts. That handle is a mass and a damper, at rest as the push begins, under the force
//! that acted less the 10 %, which friction may take: `v += (f - 10 %) T^2 / (m r) - v T b / m`, `x += v`, in counts and
//! outputs.
//!
//! A handle that a person holds still is such a push too: nobody holds one that pushes by itself. In contact neither says
//! anything, because there the wall holds the handle on purpose: an encoder that dies in contact is found only when the
//! handle should leave the wall.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::plan::{HEAVIEST_BITS, PUSH_COUNTS, PUSH_FORCE, SafetyPlan};
use crate::units::{Force, Position};

/// A million counts per output, so that a product fits.
const SPEED_MAX: u64 = (1 << 52) - 1;

/// Watches for a force outside contact that moves nothing, or too little.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StuckEncoder {
    /// The push is into the wall.
    inward: bool,
    /// Since the count last moved.
    still: Watched,
    /// Since the last look at how far.
    far: Watched,
    /// Speed of the heaviest handle, LSB of 2^-32 counts per output, and its way since that look.
    speed: u64,
    way: u64,
}

/// Where the count was since a watch began.
#[derive(Clone, Copy, Debug, Default)]
struct Watched {
    /// Outputs since then; 0: not watching.
    outputs: u32,
    lowest: Position,
    highest: Position,
}

impl Watched {
    fn at(position: Position) -> Self {
        Self { outputs: 1, lowest: position, highest: position }
    }

    /// An output more; how far the count has moved, counts.
    fn step(&mut self, position: Position) -> u32 {
        self.outputs = self.outputs.saturating_add(1);
        self.lowest = self.lowest.min(position);
        self.highest = self.highest.max(position);
        self.highest.wrapping_since(self.lowest).unsigned_abs()
    }
}

impl StuckEncoder {
    /// Takes the force that acted since the last output, and what came of it. True once the force was above 10 % in one
    /// direction, outside contact, for 50 ms, and the count stayed within less than 3, or within less than what the
    /// heaviest handle would have done in a span of 50 ms.
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
