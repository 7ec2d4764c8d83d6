//! Changes settings without a jump of the force. The push that acts moves slowly towards the new push. A correction at
//! first cancels what the new wall would change in the force, and then fades to 0. Position and velocity act at once,
//! as always.
//!
//! ```text
//! push' = towards the new push, by at most slew                      what is left of slew: rest
//! base  = within(old wall, saturate(push' - old wall(motion)) + c)   what the old wall would give now
//! c'    = fade(base - saturate(push' - wall(motion)))                towards 0 by at most rest
//! force = within(wall, saturate(push' - wall(motion)) + c')
//! ```
//!
//! **The correction is part of the wall, so it has the wall's sign.** `within` limits every force. Outside the wall
//! there is only the push. Inside a push-only wall the force never exceeds the push, so the wall does not pull. Every
//! force stays within full scale. If motion leaves no room for a correction, the correction is dropped and does not
//! come back.
//!
//! So at every output the force differs by at most `slew` from the force of the settings before the change. This is
//! true for any number and size of changes. The exception is a wall that the handle leaves: the force of this wall is
//! gone at once.

#![deny(clippy::float_arithmetic)]

use core::hint::cold_path;

use super::Doubled;
use crate::{
    Drive, Motion,
    units::{Demand, Force},
    wall::Wall,
};

/// State of a fade: wall and push of the last output, and the correction that is still fading.
#[derive(Clone, Copy, Debug)]
pub(super) struct GainFade {
    kept: Doubled<Kept>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Kept {
    wall: Wall,
    /// Push of the last output. It is on its way to the push that the experiment proposes.
    push: Force,
    /// Whether the push has not yet reached the push that the experiment proposes.
    pushing: bool,
    /// How much the force of the last output differed from the force of wall and push, in LSB of [`Force`]. It fades to
    /// 0.
    correction: i64,
}

impl GainFade {
    pub fn new(wall: Wall, push: Force) -> Self {
        Self { kept: Doubled::new(Kept { wall, push, pushing: false, correction: 0 }) }
    }

    pub fn is_fading(&self) -> bool {
        self.kept.pushing || self.kept.correction != 0
    }

    #[inline]
    pub fn push(&self) -> Force {
        self.kept.push
    }

    /// Whether this state is unchanged since the last output.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.kept.is_whole()
    }

    /// Computes the force for this output. `drive` is the output of the new settings, and `slew` the largest step. If
    /// the command `zero` has given the position a new number, `held` is the force of the last output, and replaces the
    /// force of the old settings.
    #[inline]
    pub fn force(
        &mut self,
        (wall, push): (&Wall, Force),
        motion: Motion,
        drive: &Drive,
        held: Option<Force>,
        slew: i32,
    ) -> Force {
        let kept = &self.kept;
        let same = *wall == kept.wall;
        if same && push == kept.push && kept.correction == 0 && held.is_none() {
            return drive.force;
        }
        if !kept.is_whole() {
            cold_path();
            return drive.force; // the damaged state is not overwritten, so `is_whole` still finds it
        }
        let before = kept.push.bits();
        let step = push.bits().saturating_sub(before).max(-slew).min(slew); // clamp could panic
        let pushed = Force::saturating_from_bits(before + step);
        let rest = i64::from(slew - step.abs());
        // The force of push and wall, limited to what the actuator can give.
        let asked = |wall: Demand| i64::from(wall.against(pushed).saturate().0.bits());
        let wanted = asked(drive.wall);
        let base = match held {
            Some(force) => i64::from(force.bits()) + i64::from(step),
            None if same => within(drive.contact, wall, pushed, wanted + kept.correction),
            None => {
                let old = &kept.wall;
                let given = asked(old.demand(motion.position, motion.velocity)) + kept.correction;
                within(old.penetration(motion.position) > 0, old, pushed, given)
            }
        };
        let difference = base - wanted;
        let force = wanted + difference - difference.max(-rest).min(rest);
        let force = within(drive.contact, wall, pushed, force);
        let correction = force - wanted;
        self.kept.set(Kept { wall: *wall, push: pushed, pushing: pushed != push, correction });
        Demand::from_bits(force).saturate().0
    }
}

/// Returns the force nearest to `bits` that has the right sign for this wall against `push`.
#[inline]
fn within(contact: bool, wall: &Wall, push: Force, bits: i64) -> i64 {
    let push = i64::from(push.bits());
    let full = i64::from(Force::FULL_SCALE.bits());
    match (contact, wall.push_only) {
        (false, _) => push,
        (true, true) => bits.max(-full).min(push),
        (true, false) => bits.max(-full).min(full),
    }
}

#[cfg(test)]
impl GainFade {
    /// Flips a bit of one of the two walls.
    pub(super) fn spoil(&mut self) {
        let surface = crate::units::Position::from_counts(1 << 17);
        let wall = Wall { surface, ..self.kept.wall };
        self.kept.spoil(Kept { wall, ..*self.kept });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Gain,
        safety::SLEW,
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

    fn give(fade: &mut GainFade, (wall, push): (Wall, Force), at: Motion) -> Force {
        fade.force((&wall, push), at, &drive(&wall, push, at), None, SLEW)
    }

    fn drive(wall: &Wall, push: Force, at: Motion) -> Drive {
        let demand = wall.demand(at.position, at.velocity);
        let (force, saturated) = demand.against(push).saturate();
        Drive { wall: demand, force, contact: wall.penetration(at.position) > 0, saturated }
    }

    #[test]
    fn a_change_over_the_whole_range_takes_21_outputs_of_at_most_5_percent() {
        let (soft, hard) = (wall(0, 0.0, 0.0), wall(0, 1e9, 0.0));
        let at = motion(100, 0);
        let mut change = GainFade::new(soft, Force::ZERO);
        let mut last = 0;
        let mut outputs = 0;
        loop {
            let force = give(&mut change, (hard, Force::ZERO), at);
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
            let wanted = drive(&hard, Force::ZERO, at).force;
            assert_eq!(give(&mut change, (hard, Force::ZERO), at), wanted);
        }
    }

    /// The command `zero` gives the position a new number. The force then continues from its last value, and changes
    /// only with the push.
    #[test]
    fn a_force_that_is_held_moves_with_the_push_only() {
        let hard = wall(0, 1e7, 0.0);
        let at = motion(100, 0);
        for push in [1 << 29, -(1 << 29)] {
            let push = Force::saturating_from_bits(push);
            let mut change = GainFade::new(hard, Force::ZERO);
            let held = Force::saturating_from_bits(-(1 << 28));
            let drive = drive(&hard, push, at);
            let given = change.force((&hard, push), at, &drive, Some(held), SLEW);
            assert_eq!(given.bits(), held.bits() + SLEW * push.bits().signum());
        }
    }

    /// At its surface the old wall gives no force, whatever its correction is.
    #[test]
    fn a_wall_that_is_just_left_fades_no_more() {
        let (hard, soft, other) = (wall(0, 1e9, 0.0), wall(0, 0.0, 0.0), wall(-50, 1e7, 0.0));
        let mut change = GainFade::new(hard, Force::ZERO);
        assert!(give(&mut change, (soft, Force::ZERO), motion(100, 0)).bits() < -SLEW);
        let force = give(&mut change, (other, Force::ZERO), motion(0, 0));
        assert_eq!(force.bits(), -SLEW);
    }

    /// A fade with a flipped bit changes no output. It stays damaged, so that the check after the output finds it.
    /// Until then the force continues.
    #[test]
    fn a_broken_one_is_neither_used_nor_mended() {
        let (soft, hard) = (wall(0, 0.0, 0.0), wall(0, 1e9, 0.0));
        let at = motion(100, 0);
        let mut change = GainFade::new(soft, Force::ZERO);
        give(&mut change, (hard, Force::ZERO), at);
        assert!(change.is_fading() && change.is_whole());
        change.spoil();
        let asked = drive(&hard, Force::ZERO, at).force;
        assert_eq!(give(&mut change, (hard, Force::ZERO), at), asked);
        assert!(!change.is_whole());
    }

    proptest! {
        /// The settings change in any way, at any time. Each force is compared with the force that the old settings
        /// would give at this output. They differ by at most 5 % of full scale, unless the handle is in the old wall
        /// and not in the new one. The wall's force always has the right sign.
        #[test]
        fn no_change_steps_by_more_than_5_percent_and_none_turns_the_wall_round(
            push_only in any::<bool>(),
            steps in prop::collection::vec(
                (
                    -200i32..200, any::<i32>(), prop::option::weighted(0.3, (
                        -100i32..100, 0.1f64..1e9, 0.1f64..1e4, -(1i32 << 30)..=1 << 30
                    )),
                ),
                1..200,
            )
        ) {
            let wall = |surface, k, b| Wall { push_only, ..wall(surface, k, b) };
            let mut now = (wall(0, 1000.0, 1.0), Force::ZERO);
            let mut change = GainFade::new(now.0, now.1);
            for (position, velocity, new) in steps {
                let at = motion(position, velocity / 64);
                let Kept { push, correction, .. } = *change.kept;
                // What the old settings would give, with the correction of the last output.
                let old = drive(&now.0, push, at);
                let was_in = old.contact;
                let unchanged = i64::from(old.force.bits()) + correction;
                let unchanged = within(was_in, &now.0, push, unchanged);
                if let Some((surface, stiffness, damping, push)) = new {
                    now = (wall(surface, stiffness, damping), Force::saturating_from_bits(push));
                }
                let force = i64::from(give(&mut change, now, at).bits());
                let is_in = now.0.penetration(at.position) > 0;
                let step = force - unchanged;
                // If the wall is removed, its force is gone at once. `may_change` never allows this in contact.
                prop_assert!(step.abs() <= i64::from(SLEW) || was_in && !is_in, "{step}");
                let push = i64::from(change.kept.push.bits());
                if !is_in {
                    prop_assert_eq!(force, push);
                } else if push_only {
                    prop_assert!(force <= push);
                }
            }
            // Without further changes the fade ends within 81 outputs. First the push changes by up to two full scales,
            // then the wall, both by 5 % per output.
            let at = motion(150, 0);
            for _ in 0..81 {
                let _ = give(&mut change, now, at);
            }
            prop_assert!(!change.is_fading());
            prop_assert_eq!(change.kept.push, now.1);
        }
    }
}
