//! A time-domain passivity controller. It limits the wall's force so that the wall cannot give more energy than a
//! reserve.
//!
//! At each output it computes the most energy that the wall's force can give until the next force replaces it. The
//! account of the contact ([`PortEnergy`]) and the reserve must cover this energy. The controller allows at most half
//! of the sum of account and reserve:
//!
//! ```text
//! d      counts since the last output
//! r1     max(0, change_1 - d latency / period)      most counts outwards while the old force acts
//! r2     max(1, change_2 - d)                       most counts outwards while the new force acts
//! left   energy + reserve - old r1, but at least reserve / 2^20
//! wall   within +-left / (2 r2)             for a wall that pulls: d with the other sign
//! ```
//!
//! `change_1` and `change_2` are the counts by which motion can differ from the motion before the last output. The
//! settings give the largest acceleration a. With a period P and a latency l, `change_1` is `a (P l + l^2) / 2`, and
//! `change_2` is `a P (P + l)`. Both include two more counts for the quantisation.
//!
//! **The guarantee.** While the handle accelerates by at most a, the wall gives in each contact at most the reserve.
//! Each output at which the account was spent adds at most 2^-21 of the reserve. This holds whatever touches the
//! handle, and for any error of the estimator. The energy that the old force may give is set aside before the new force
//! is granted. The new force gives at most half of the rest.
//!
//! If the handle accelerates more, the wall may give more energy: its force times the excess of motion. The account
//! forgives this energy. A spent account still allows a least force, so that the account recovers: a handle that is
//! pushed in finds a wall again. The reserve is `2 change_2` counts at full scale, and with a latency `change_1 + 1`
//! counts more. So the whole force is allowed at standstill when a contact has taken as much energy as it has given.
//!
//! The variable damper of Hannaford and Ryu is not used. That damper divides the deficit by the velocity, which is one
//! count or none at a period of 1 ms. It removes the deficit only if the motion continues as before. At each reversal
//! the bound of that damper would equal the bound of this controller.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::num::NonZeroU32;

use crate::{
    Design,
    port::PortEnergy,
    range::{SettingsError, within},
    units::{Force, Position},
};

/// Settings of the controller, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassivitySettings {
    /// Largest acceleration of the handle by motor, hand and wall together, in m/s^2.
    pub acceleration_m_per_s2: f64,
    /// Time from a sample to the force of its output, in samples. It is at least 0 and at most the period.
    pub latency: u32,
}

/// The largest allowed value of `change_2`, in counts.
const CHANGE_MAX: f64 = 1_048_576.0;

impl PassivitySettings {
    /// Checks the settings, and converts them to counts.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    #[expect(clippy::float_arithmetic, reason = "design time: settings to integers")]
    pub fn build(&self, design: &Design) -> Result<Passivity, SettingsError> {
        design.check()?;
        let (period, latency) = (f64::from(design.period), f64::from(self.latency));
        within("latency", latency, 0.0..=period)?;
        // Converts m/s^2 to counts per sample^2.
        let per_a = 1.0 / (design.rate_hz * design.rate_hz * design.resolution_m);
        let most = CHANGE_MAX / (per_a * period * (period + latency));
        within("acceleration_m_per_s2", self.acceleration_m_per_s2, LEAST_M_PER_S2..=most)?;
        let bits = libm::ldexp(self.acceleration_m_per_s2 * per_a, ACCELERATION_BITS);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most 2^20 counts"
        )]
        let acceleration = libm::ceil(bits) as u64;
        Ok(Passivity {
            acceleration,
            latency: self.latency,
            period: NonZeroU32::MIN,
            changes: [0; 2],
        }
        .at(design.period))
    }
}

/// Number of binary places of an acceleration in counts per sample^2.
const ACCELERATION_BITS: i32 = 32;
/// The least acceleration, in m/s^2.
const LEAST_M_PER_S2: f64 = 1e-6;

/// The controller in counts. Made by [`PassivitySettings::build`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passivity {
    /// Largest acceleration, in counts per sample^2. It is rounded up, and has 32 binary places.
    acceleration: u64,
    latency: u32,
    period: NonZeroU32,
    /// `change_1` and `change_2` of the module's equations: the most counts by which the motion may differ from the
    /// motion before the last output. The first is for the time before the new force acts, the second for the time
    /// while it acts.
    changes: [i32; 2],
}

impl Passivity {
    /// Returns this controller for an output every `period` samples. `period` must be at least the latency.
    #[must_use]
    pub fn at(self, period: u32) -> Self {
        let period = NonZeroU32::new(period).unwrap_or(NonZeroU32::MIN);
        let (p, l) = (u64::from(period.get()), u64::from(self.latency));
        let counts = |samples2: u64| {
            let moved = u128::from(self.acceleration) * u128::from(samples2);
            let quantised = if samples2 > 0 { 3 } else { 0 }; // two, and one for what is cut off
            let counts = (moved >> ACCELERATION_BITS) + quantised;
            i32::try_from(counts).unwrap_or(i32::MAX).min(MOTION_MAX)
        };
        Self { period, changes: [counts((l * (p + l)).div_ceil(2)), counts(p * (p + l))], ..self }
    }

    /// The most counts by which the motion may change while the new force acts.
    pub fn change(&self) -> i32 {
        self.changes[1]
    }

    /// The most energy that a contact may give before its account is [spent](SPENT), in LSB of force times counts.
    pub fn reserve(&self) -> i64 {
        let [before, after] = self.changes.map(i64::from);
        let meanwhile = if self.latency > 0 { before + 1 } else { 0 };
        (2 * after + meanwhile) * i64::from(Force::FULL_SCALE.bits())
    }
}

/// State of the passivity controller from output to output. Its main part is the energy account of the port.
#[derive(Clone, Copy, Debug)]
pub struct PassiveWall {
    port: PortEnergy,
    /// Position at the last output.
    last: Position,
    /// Energy that the contact has given beyond the reserve, in LSB of force times counts.
    forgiven: i64,
    /// The wall's force that does not act yet, and whether its output was in contact. The force acts when `wait`, a
    /// number of samples, reaches 0.
    pending: (i64, bool),
    wait: u32,
}

impl PassiveWall {
    /// Begins with the handle at `position`, when no wall acts on it.
    pub const fn new(position: Position) -> Self {
        let port = PortEnergy::new(position);
        Self { port, last: position, forgiven: 0, pending: (0, false), wait: 0 }
    }

    /// Account of the energy at the port.
    pub const fn port(&self) -> &PortEnergy {
        &self.port
    }

    /// Takes each sample's position, before [`render`](Self::render). Without a latency these calls may be left out.
    #[inline]
    pub fn sample(&mut self, position: Position) {
        if self.wait > 0 {
            self.wait -= 1;
            if self.wait == 0 {
                self.port.acts(self.pending.0, self.pending.1, position);
            }
        }
    }

    /// Calls [`limit`](Self::limit), and grants its force at once.
    #[inline]
    pub fn render(
        &mut self,
        plan: &Passivity,
        wants: i64,
        contact: bool,
        position: Position,
    ) -> i64 {
        let given = self.limit(plan, wants, contact, position);
        self.gives(plan.latency, given, contact, position);
        given
    }

    /// Returns the allowed force if the wall demands the force `wants`. Both are in LSB, positive out of the wall, and
    /// at most two full scales.
    #[inline]
    pub fn limit(
        &mut self,
        plan: &Passivity,
        wants: i64,
        contact: bool,
        position: Position,
    ) -> i64 {
        let mut port = self.port;
        port.moved(position);
        let d = i64::from(position.wrapping_since(self.last));
        let fresh = contact && !port.contact();
        let reserve = plan.reserve();
        // A blow may take more energy than the account has. The excess is forgiven. Otherwise there would be no wall
        // for the rest of the contact.
        self.forgiven = match port.energy() {
            _ if fresh => 0,
            energy => self.forgiven.max(reserve.saturating_add(energy).saturating_neg()),
        };
        let energy = if fresh { 0 } else { port.energy().saturating_add(self.forgiven) };
        let left = energy.saturating_add(reserve).saturating_sub(self.committed(plan, d));
        let left = left.max(reserve >> SPENT);
        // Motion in the direction of the force. For a wall that pushes, this is out of the wall.
        let along = if wants < 0 { d } else { -d };
        let worst = (along + i64::from(plan.changes[1])).clamp(1, MOTION_MAX.into());
        within_budget(wants, left, worst)
    }

    /// Notes the wall's force of an output. It acts `latency` samples later. Call this at each output.
    #[inline]
    pub fn gives(&mut self, latency: u32, wall: i64, contact: bool, position: Position) {
        self.last = position;
        self.port.moved(position);
        if latency == 0 {
            self.port.acts(wall, contact, position);
        } else {
            (self.pending, self.wait) = ((wall, contact), latency);
        }
    }

    /// Gives the present place of the handle the new position `position`, after a command `zero`.
    #[inline]
    pub fn rename(&mut self, position: Position) {
        self.last = position;
        self.port.rename(position);
    }

    /// Resets [`PortEnergy::given`].
    #[inline]
    pub fn forget(&mut self) {
        self.port.forget();
    }

    /// The most energy that the present force can give before the next force acts, in LSB of force times counts.
    fn committed(&self, plan: &Passivity, d: i64) -> i64 {
        let Passivity { changes: [change, _], latency, period, .. } = *plan;
        let wall = self.port.wall();
        if latency == 0 || wall == 0 {
            return 0;
        }
        let along = if wall < 0 { d } else { -d };
        let going_on = along * i64::from(latency) / i64::from(period.get()) + 1;
        let worst = (going_on + i64::from(change)).clamp(0, MOTION_MAX.into());
        wall.abs().saturating_mul(worst)
    }
}

/// An account below 2^-`SPENT` of the reserve counts as spent. It is then treated as 2^-`SPENT` of the reserve, and an
/// output gives at most half of this. Without this rule, a wall with an exactly spent account would give no force for
/// the rest of the contact.
pub const SPENT: u32 = 20;

/// The largest motion that is used, in counts. With it, products with two full scales stay below 2^62.
const MOTION_MAX: i32 = 1 << 29;

/// Returns the force nearest to `wants` with which a motion of `worst` counts gives at most half of the energy `left`.
#[inline]
fn within_budget(wants: i64, left: i64, worst: i64) -> i64 {
    let most = 2 * worst;
    if wants.abs().saturating_mul(most) <= left {
        return wants;
    }
    let limit = left / most;
    wants.max(-limit).min(limit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Output;
    use proptest::prelude::*;

    const FULL: i64 = 1 << 30;

    fn design(period: u32) -> Design {
        let output = Output::Continuous;
        Design { rate_hz: 10_000.0, resolution_m: 1e-6, full_scale_n: 5.906, period, output }
    }

    fn plan(acceleration_m_per_s2: f64, latency: u32, period: u32) -> Passivity {
        PassivitySettings { acceleration_m_per_s2, latency }.build(&design(period)).unwrap()
    }

    fn at(counts: i32) -> Position {
        Position::from_counts(counts)
    }

    #[test]
    fn settings_become_counts() {
        // With counts of 1 um and samples at 10 kHz, 28 m/s^2 are 0.28 counts per sample^2.
        assert_eq!(plan(28.0, 10, 10).changes, [28 + 3, 56 + 3]);
        assert_eq!(plan(28.0, 0, 10).changes, [0, 28 + 3]);
        assert_eq!(plan(28.0, 0, 10).reserve(), 62 << 30);
        assert_eq!(plan(1e-6, 0, 1).changes, [0, 3]);
        assert_eq!(plan(28.0, 0, 10).at(5), plan(28.0, 0, 5));
        let refused = |acceleration_m_per_s2, latency| {
            let settings = PassivitySettings { acceleration_m_per_s2, latency };
            settings.build(&design(10)).unwrap_err().parameter
        };
        assert_eq!(refused(28.0, 11), "latency");
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
            assert_eq!(refused(wrong, 0), "acceleration_m_per_s2");
        }
    }

    #[test]
    fn a_contact_that_stands_still_has_the_whole_force() {
        let (plan, mut wall) = (plan(28.0, 0, 10), PassiveWall::new(at(0)));
        for _ in 0..10 {
            assert_eq!(wall.render(&plan, FULL, true, at(0)), FULL);
        }
        assert_eq!(wall.port().energy(), 0);
    }

    #[test]
    fn a_wall_that_only_gives_ends_and_one_that_is_pushed_in_comes_back() {
        let (plan, mut wall) = (plan(28.0, 0, 10), PassiveWall::new(at(0)));
        let reserve = plan.reserve();
        let mut place = 0;
        for _ in 0..200 {
            place -= 20;
            wall.render(&plan, FULL, true, at(place));
        }
        assert!(wall.port().given() > reserve / 2, "{}", wall.port().given());
        assert!(wall.port().given() <= reserve + 200 * (reserve >> (SPENT + 1)));
        assert!(wall.port().wall() < FULL / 1000);
        for _ in 0..100 {
            place += 40;
            wall.render(&plan, FULL, true, at(place));
        }
        assert_eq!(wall.port().wall(), FULL);
    }

    /// A handle that is pushed in finds a wall again, whatever has spent the account. A cause may be a blow with more
    /// than the stated acceleration.
    #[test]
    fn a_spent_account_recovers_with_the_way_in() {
        let (plan, mut wall) = (plan(28.0, 0, 10), PassiveWall::new(at(0)));
        wall.render(&plan, FULL, true, at(0));
        wall.render(&plan, FULL, true, at(-5000));
        assert!(wall.port().energy() < -plan.reserve());
        let deficit = wall.port().energy();
        let mut place = -5000;
        let ways = (1..=40).take_while(|_| {
            place += 30;
            wall.render(&plan, FULL, true, at(place)) < FULL
        });
        let outputs = ways.count();
        assert!(outputs < 40 && wall.port().energy() > deficit, "{outputs}");
    }

    #[test]
    fn with_a_latency_too_it_has_the_whole_force_where_it_stands_still() {
        let (plan, mut wall) = (plan(28.0, 10, 10), PassiveWall::new(at(0)));
        for n in 0..100 {
            wall.sample(at(0));
            if n % 10 == 0 {
                assert_eq!(wall.render(&plan, FULL, true, at(0)), FULL);
            }
        }
    }

    #[test]
    fn only_the_end_of_contact_begins_a_new_account() {
        let (plan, mut wall) = (plan(28.0, 0, 10), PassiveWall::new(at(0)));
        for n in 1..200 {
            wall.render(&plan, FULL, true, at(-20 * n));
            wall.render(&plan, 0, true, at(-20 * n)); // a wall that gives nothing for once
        }
        assert!(wall.port().given() <= plan.reserve() + 400 * (plan.reserve() >> (SPENT + 1)));
        wall.render(&plan, 0, false, at(-10_000));
        assert_eq!(wall.render(&plan, FULL, true, at(-10_000)), FULL);
        assert_eq!(wall.port().energy(), 0);
    }

    #[test]
    fn the_ends_of_its_numbers_are_no_panic() {
        for latency in [0, 7] {
            let (plan, mut wall) = (plan(28.0, latency, 10), PassiveWall::new(at(i32::MIN)));
            for wants in [2 * FULL, -2 * FULL, 0, i64::MAX / 4, 1] {
                for place in [i32::MAX, 0, i32::MIN, i32::MIN + 1, 1 << 30] {
                    wall.sample(at(place));
                    wall.render(&plan, wants, true, at(place));
                }
            }
        }
    }

    proptest! {
        /// Tries any forces of the wall, and any motion within the stated acceleration.
        #[test]
        fn no_contact_gives_more_than_the_reserve(
            acceleration in 1.0..200.0f64,
            (period, latency) in (1..=10u32).prop_flat_map(|period| (Just(period), 0..=period)),
            wants in proptest::collection::vec(-2 * FULL..=2 * FULL, 1..20),
            pushes in proptest::collection::vec(-1.0..=1.0f64, 1..300),
            hard in any::<bool>(),
            contact in 1..40u32
        ) {
            let plan = plan(acceleration, latency, period);
            let mut wall = PassiveWall::new(at(0));
            let (mut place, mut speed) = (0.0, 0.0);
            let per_sample = acceleration * 1e6 / 1e8;
            let (mut until_due, mut outputs) = (0, 0u32);
            for push in pushes.iter().cycle().take(3000) {
                #[expect(clippy::cast_possible_truncation, reason = "below 2^31")]
                let position = at(f64::floor(place) as i32);
                wall.sample(position);
                if until_due == 0 {
                    outputs += 1;
                    // The worst wall pushes while the handle comes out, and pulls while it goes in.
                    let wants = match wants[outputs as usize % wants.len()] {
                        _ if hard && speed < 0.0 => 2 * FULL,
                        _ if hard => -2 * FULL,
                        most => most,
                    };
                    let contact = !outputs.is_multiple_of(contact);
                    wall.render(&plan, if contact { wants } else { 0 }, contact, position);
                    until_due = period;
                }
                until_due -= 1;
                let a = if hard { push.signum() } else { *push } * per_sample;
                place += speed + a / 2.0;
                speed += a;
                let most = plan.reserve() + i64::from(outputs) * (plan.reserve() >> (SPENT + 1));
                prop_assert!(wall.port().given() <= most, "{} of {most}", wall.port().given());
            }
        }
    }
}
