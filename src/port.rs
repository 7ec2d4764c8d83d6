//! The energy that wall and hand exchange at the handle, computed from the wall's force and the motion of the counts.
//! This is a passivity observer (Hannaford and Ryu, "Time-domain passivity control of haptic interfaces", IEEE Trans.
//! Robotics and Automation 18(1), 2002).
//!
//! ```text
//! energy += wall (position - at)        wall: its force out of the wall, from the output on with which it acts
//! ```
//!
//! The force is constant between two changes, so the sum is exact for every motion of the counts. The account begins
//! anew with each contact, at the first output behind the surface. A positive energy was taken from the hand. If it is
//! negative, the wall has given more energy than it has taken, which no real spring or damper can do.
//!
//! The unit is an LSB of [`Force`](crate::units::Force) times a count. With full scale in N and the resolution in m, it
//! is `full scale / 2^30 * resolution` J.
//!
//! The account leaves out three things:
//! * motion within a count (at each output at most a change of force times a count);
//! * the change of the force by amplifier and motor;
//! * the motion during a latency that is not stated.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::units::Position;

/// The energy account of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortEnergy {
    wall: i64,
    contact: bool,
    /// Position up to which the motion is in the account.
    at: Position,
    /// Energy of this contact, in LSB of force times counts.
    energy: i64,
    /// The largest net energy that the wall had given at any time of any contact, in LSB of force times counts.
    given: i64,
}

impl PortEnergy {
    /// Begins with the handle at `position`, when no wall acts on it.
    pub const fn new(position: Position) -> Self {
        Self { wall: 0, contact: false, at: position, energy: 0, given: 0 }
    }

    /// Continues an account after an output that reported this `energy`.
    pub const fn resumed(wall: i64, contact: bool, position: Position, energy: i64) -> Self {
        Self { wall, contact, at: position, energy, given: 0 }
    }

    /// Notes that the wall's force changes to `wall` at this position. `wall` is in LSB of force, positive out of the
    /// wall, and at most two full scales. `contact` says whether its output was in contact.
    #[inline]
    pub fn acts(&mut self, wall: i64, contact: bool, position: Position) {
        self.moved(position);
        if contact && !self.contact {
            self.energy = 0;
        }
        (self.wall, self.contact) = (wall, contact);
    }

    /// Adds the motion up to this position to the account.
    #[inline]
    pub fn moved(&mut self, position: Position) {
        let counts = i64::from(position.wrapping_since(self.at));
        self.at = position;
        self.energy = self.energy.saturating_add(self.wall.saturating_mul(counts));
        self.given = self.given.max(self.energy.saturating_neg());
    }

    /// Gives the present place of the handle the new position `position`, after a command `zero`. The account does not
    /// count this as motion.
    #[inline]
    pub const fn rename(&mut self, position: Position) {
        self.at = position;
    }

    /// The wall's force that acts at present, in LSB of force.
    #[inline]
    pub const fn wall(&self) -> i64 {
        self.wall
    }

    /// Whether the output of this force was in contact.
    #[inline]
    pub const fn contact(&self) -> bool {
        self.contact
    }

    /// The values of [`energy`](Self::energy) and [`given`](Self::given), for reports.
    #[inline]
    pub const fn exchanged(&self) -> Exchanged {
        Exchanged { energy: self.energy, given: self.given }
    }

    /// Energy that the wall has taken in this contact, or in the last one. It is negative if the wall has given energy.
    #[inline]
    pub const fn energy(&self) -> i64 {
        self.energy
    }

    /// The largest net energy that the wall had given at any time of any contact since [`forget`](Self::forget).
    #[inline]
    pub const fn given(&self) -> i64 {
        self.given
    }

    /// Resets [`given`](Self::given). Out of contact it also resets [`energy`](Self::energy).
    #[inline]
    pub fn forget(&mut self) {
        self.given = 0;
        if !self.contact {
            self.energy = 0;
        }
    }
}

/// Energies of an account, in LSB of force times counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Exchanged {
    /// Energy that the wall has taken, see [`PortEnergy::energy`]. It is negative if the wall has given energy.
    pub energy: i64,
    /// The largest energy that the wall has given, see [`PortEnergy::given`]. It is never negative.
    pub given: i64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn at(counts: i32) -> Position {
        Position::from_counts(counts)
    }

    #[test]
    fn a_spring_gives_back_what_it_took_and_a_late_one_more() {
        let mut port = PortEnergy::new(at(0));
        // The handle moves in by steps of ten counts, and out again. In each step the force is the force at the
        // beginning of the step.
        for place in (0..100).step_by(10).chain((0..=100).rev().step_by(10)) {
            port.acts(i64::from(place) * 1000, true, at(place));
        }
        // Each step n exchanges (10 n 1000) * 10. On the way in n goes from 0 to 9, on the way out from 10 to 1.
        assert_eq!(port.energy(), 1000 * 100 * (45 - 55));
        assert_eq!(port.given(), 1000 * 1000);
    }

    #[test]
    fn each_contact_has_its_own_account() {
        let mut port = PortEnergy::new(at(0));
        port.acts(1000, true, at(0));
        port.acts(0, true, at(-7)); // as a push-only wall gives nothing on the way out
        port.acts(1000, true, at(-7));
        port.acts(0, false, at(-7));
        assert_eq!((port.energy(), port.given()), (-7000, 7000));
        port.moved(at(500));
        assert_eq!(port.energy(), -7000, "no wall acts");
        port.acts(10, true, at(500));
        port.acts(0, false, at(503));
        assert_eq!((port.energy(), port.given()), (30, 7000));
        port.forget();
        assert_eq!(port.given(), 0);
        port.acts(1000, true, at(503));
        port.acts(0, false, at(500));
        assert_eq!((port.energy(), port.given()), (-3000, 3000));
        port.forget();
        port.moved(at(499));
        assert_eq!(
            (port.energy(), port.given()),
            (0, 0),
            "the account of a contact before is closed"
        );
        port.moved(at(503));
        port.acts(10, true, at(3));
        port.rename(at(0));
        port.acts(0, false, at(1));
        assert_eq!(port.energy(), 10);
    }

    #[test]
    fn the_ends_of_its_numbers_are_no_panic() {
        let mut port = PortEnergy::new(at(i32::MIN));
        for wall in [1 << 31, -(1 << 31), 0, 1 << 31] {
            for place in [i32::MAX, 0, i32::MIN, i32::MAX, 1] {
                port.acts(wall, true, at(place));
            }
        }
        assert!(port.given() >= 0);
    }

    proptest! {
        /// The reference is a sum of floats, force by force and sample by sample.
        #[test]
        fn it_is_the_sum_of_force_times_motion(
            steps in proptest::collection::vec((-(1i64 << 31)..=1 << 31, -3000i32..3000), 1..200)
        ) {
            let mut port = PortEnergy::new(at(0));
            let (mut place, mut sums, mut sum) = (0, Vec::new(), 0.0);
            let mut exchanged = 1.0;
            for (wall, counts) in steps {
                port.acts(wall, true, at(place));
                place += counts;
                sum += wall as f64 * f64::from(counts);
                exchanged += (wall as f64 * f64::from(counts)).abs();
                sums.push(sum);
                port.moved(at(place));
                prop_assert!((port.energy() as f64 - sum).abs() <= 1e-12 * exchanged);
            }
            let least = sums.iter().copied().fold(0.0, f64::min);
            prop_assert!((port.given() as f64 + least).abs() <= 1e-12 * exchanged);
        }
    }
}
