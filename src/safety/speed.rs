//! Computes the speed from the counts of each millisecond. The task `sample` checks the estimated velocity, which is
//! late by the estimator's delay. At a cutoff of 0.4 Hz this is half a second. If outputs are closer than a
//! millisecond, the counts of a whole millisecond are used. Over a shorter time, a single count would be too large a
//! part of the allowed motion.

#![deny(clippy::float_arithmetic)]

use core::hint::cold_path;

use super::SafetyPlan;
use crate::units::Position;

/// Position at the last check.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SpeedWatch {
    last: Position,
    /// Number of outputs until the next check. It is 0 if there was no check yet.
    left: u32,
}

impl SpeedWatch {
    /// Takes the position at an output. Returns whether the handle has moved farther in the last millisecond than the
    /// plan allows. `renamed` says whether the count was zeroed since the last output.
    #[inline]
    pub fn too_fast(&mut self, plan: &SafetyPlan, position: Position, renamed: bool) -> bool {
        let left = self.left.min(plan.per_ms); // a flipped bit must not put the check off
        if left > 1 && !renamed {
            cold_path(); // at 1 kHz it never comes here
            self.left = left - 1;
            return false;
        }
        let moved = position.wrapping_since(self.last).unsigned_abs();
        let fast = moved > plan.moved && left > 0 && !renamed;
        (self.last, self.left) = (position, plan.per_ms);
        fast
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Design,
        safety::plan::tests::{DESIGN, SETTINGS},
    };

    fn look(watch: &mut SpeedWatch, plan: &SafetyPlan, counts: i32, renamed: bool) -> bool {
        watch.too_fast(plan, Position::from_counts(counts), renamed)
    }

    #[test]
    fn it_looks_from_millisecond_to_millisecond_and_past_a_zero() {
        let plan = SETTINGS.build(&DESIGN).unwrap();
        assert_eq!(plan.moved, 1001);
        let mut watch = SpeedWatch::default();
        let mut at = |counts, renamed| look(&mut watch, &plan, counts, renamed);
        assert!(!at(500_000, false)); // the first
        assert!(!at(501_001, false) && at(502_003, false) && at(501_000, false));
        assert!(!at(0, true) && !at(-1000, false) && at(2, false));
        assert!(!at(i32::MAX, true) && !at(i32::MIN, false)); // one count, across the wrap
    }

    #[test]
    fn a_flipped_bit_puts_the_check_off_by_a_millisecond_at_most() {
        for period in [1, 10] {
            let plan = SETTINGS.build(&Design { period, ..DESIGN }).unwrap();
            for bit in 0..u32::BITS {
                let mut watch = SpeedWatch::default();
                look(&mut watch, &plan, 0, false);
                watch.left ^= 1 << bit;
                let step = 1_100 / plan.per_ms.cast_signed();
                let fast = (1..=2 * plan.per_ms.cast_signed())
                    .any(|n| look(&mut watch, &plan, n * step, false));
                assert!(fast, "period {period}, bit {bit}");
            }
        }
    }

    #[test]
    fn closer_outputs_have_the_same_limit_and_a_zero_starts_anew() {
        for period in [1, 2, 5] {
            let plan = SETTINGS.build(&Design { period, ..DESIGN }).unwrap();
            let outputs = 10 / period.cast_signed();
            assert_eq!((plan.moved, plan.per_ms), (1001, outputs.unsigned_abs()));
            let run = |counts: i32, zero: Option<i32>| {
                let mut watch = SpeedWatch::default();
                (0..=3 * outputs)
                    .map(|n| look(&mut watch, &plan, counts * n / outputs, zero == Some(n)))
                    .collect::<std::vec::Vec<_>>()
            };
            assert!(run(1001, None).iter().all(|fast| !fast));
            let fast = run(1002, None);
            let at = |n: &i32| fast[n.unsigned_abs() as usize];
            assert!((0..=3 * outputs).all(|n| at(&n) == (n > 0 && n % outputs == 0)));
            let zeroed = run(1002, Some(1));
            let found = (0i32..).zip(zeroed).filter(|(_, fast)| *fast).map(|(n, _)| n);
            assert_eq!(found.collect::<std::vec::Vec<_>>(), [1 + outputs, 1 + 2 * outputs]);
        }
    }
}
