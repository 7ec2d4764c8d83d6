//! A change of settings without a kick: what it would add to the force at this instant is taken
//! off again, and that correction fades away. Position and velocity act at once, as ever.
//!
//! ```text
//! base  = saturate(old(motion) + c)            what the old settings would give now
//! c'    = fade(base - new(motion))             towards 0 by at most SLEW
//! force = new(motion) + c'                     between new and base, so never beyond full scale
//! ```
//!
//! So the force differs from `base` by at most [`SLEW`] at every output, however often and however
//! much is changed.

#![deny(clippy::float_arithmetic)]

use super::SLEW;
use crate::{
    Motion,
    units::{Demand, Force},
    wall::Wall,
};

/// What the last output was made with, and the correction that is still fading.
#[derive(Clone, Copy, Debug)]
pub(super) struct GainFade {
    wall: Wall,
    push: Force,
    correction: i64,
}

impl GainFade {
    /// Nothing to fade.
    pub fn new(wall: Wall, push: Force) -> Self {
        Self { wall, push, correction: 0 }
    }

    /// Whether a correction is at work.
    pub fn is_fading(&self) -> bool {
        self.correction != 0
    }

    /// The force to give now, where the settings in force ask for `wanted`. `held` replaces what
    /// the old settings would give: the force of the last output, for when the motion itself was
    /// renamed by a zero.
    #[inline]
    pub fn force(
        &mut self,
        wall: Wall,
        push: Force,
        motion: Motion,
        wanted: Force,
        held: Option<Force>,
    ) -> Force {
        let changed = wall != self.wall || push != self.push;
        if !changed && self.correction == 0 && held.is_none() {
            return wanted;
        }
        let base = held.unwrap_or_else(|| {
            let old = if changed { asked(&self.wall, self.push, motion) } else { wanted };
            corrected(old, self.correction)
        });
        let difference = i64::from(base.bits()) - i64::from(wanted.bits());
        self.correction = fade(difference);
        self.wall = wall;
        self.push = push;
        corrected(wanted, self.correction)
    }
}

/// What push and wall ask for, as far as the actuator can give it.
#[inline]
fn asked(wall: &Wall, push: Force, motion: Motion) -> Force {
    wall.demand(motion.position, motion.velocity).against(push).saturate().0
}

/// `force` plus a correction, as far as the actuator can give it.
fn corrected(force: Force, correction: i64) -> Force {
    Demand::from_bits(i64::from(force.bits()) + correction).saturate().0
}

/// `value` moved towards 0 by at most [`SLEW`].
fn fade(value: i64) -> i64 {
    let slew = i64::from(SLEW);
    value - value.clamp(-slew, slew)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Gain,
        units::{Position, Velocity},
    };
    use proptest::prelude::*;

    fn wall(surface: i32, stiffness: f64, damping: f64) -> Wall {
        Wall {
            surface: Position::from_counts(surface),
            stiffness: Gain::from_f64(stiffness).unwrap(),
            damping: Gain::from_f64(damping).unwrap(),
            push_only: true,
        }
    }

    fn motion(position: i32, velocity: i32) -> Motion {
        Motion {
            sample: 0,
            position: Position::from_counts(position),
            velocity: Velocity::saturating_from_bits(velocity),
        }
    }

    #[test]
    fn a_change_over_the_whole_range_takes_21_outputs_of_at_most_5_percent() {
        let (soft, hard) = (wall(0, 0.0, 0.0), wall(0, 1e9, 0.0));
        let at = motion(100, 0);
        let mut change = GainFade::new(soft, Force::ZERO);
        let mut last = 0;
        let mut outputs = 0;
        loop {
            let force = change.force(hard, Force::ZERO, at, asked(&hard, Force::ZERO, at), None);
            assert!((force.bits() - last).abs() <= SLEW);
            last = force.bits();
            outputs += 1;
            if !change.is_fading() {
                break;
            }
        }
        assert_eq!((outputs, last), (21, -(1 << 30)));
    }

    #[test]
    fn without_a_change_motion_acts_at_once() {
        let hard = wall(0, 1e7, 0.0);
        let mut change = GainFade::new(hard, Force::ZERO);
        for position in [0, 100, 0, 50] {
            let at = motion(position, 0);
            let wanted = asked(&hard, Force::ZERO, at);
            assert_eq!(change.force(hard, Force::ZERO, at, wanted, None), wanted);
        }
    }

    proptest! {
        /// Against a twin that keeps the old settings for one more output: whatever is changed and
        /// however often, the force differs from it by at most 5 % of full scale.
        #[test]
        fn no_change_steps_by_more_than_5_percent_beyond_what_motion_asks_for(
            steps in prop::collection::vec(
                (
                    -200i32..200, any::<i32>(), prop::option::weighted(0.3, (
                        -100i32..100, 0.1f64..1e9, 0.1f64..1e4, -(1i32 << 30)..=1 << 30
                    )),
                ),
                1..200,
            )
        ) {
            let mut now = (wall(0, 1000.0, 1.0), Force::ZERO);
            let mut change = GainFade::new(now.0, now.1);
            for (position, velocity, new) in steps {
                let at = motion(position, velocity / 64);
                let mut twin = change;
                let unchanged = {
                    // the old settings, and a correction that does not fade in this output
                    let held = twin.correction;
                    let old = asked(&now.0, now.1, at);
                    let _ = twin.force(now.0, now.1, at, old, None);
                    corrected(old, held)
                };
                if let Some((surface, stiffness, damping, push)) = new {
                    now = (wall(surface, stiffness, damping), Force::saturating_from_bits(push));
                }
                let wanted = asked(&now.0, now.1, at);
                let force = change.force(now.0, now.1, at, wanted, None);
                let step = i64::from(force.bits()) - i64::from(unchanged.bits());
                prop_assert!(step.abs() <= i64::from(SLEW), "{step}");
            }
            // left alone, it ends within 41 outputs: two full scales at 5 %
            let at = motion(50, 0);
            for _ in 0..41 {
                let wanted = asked(&now.0, now.1, at);
                let _ = change.force(now.0, now.1, at, wanted, None);
            }
            prop_assert!(!change.is_fading());
        }
    }
}
