//! The virtual wall, a spring and a damper behind a surface. It is the third stage, and runs for every output.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::{
    Gain,
    units::{Demand, Position, Velocity},
};

/// A spring-damper wall in integer units. Made by [`Settings::build`](crate::Settings::build).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wall {
    pub(crate) surface: Position,
    pub(crate) stiffness: Gain,
    pub(crate) damping: Gain,
    pub(crate) push_only: bool,
}

impl Wall {
    /// Position of the surface, in counts.
    #[inline]
    pub fn surface(&self) -> Position {
        self.surface
    }

    /// The stiffness K, in LSB of force per count of penetration.
    pub fn stiffness(&self) -> Gain {
        self.stiffness
    }

    /// Whether the wall has any force.
    #[inline]
    pub fn acts(&self) -> bool {
        self.stiffness != Gain::default() || self.damping != Gain::default()
    }

    /// The damping B, in LSB of force per LSB of velocity.
    pub fn damping(&self) -> Gain {
        self.damping
    }

    /// Returns how many counts `position` is behind the surface. The handle is in contact if the result is positive.
    #[inline]
    pub fn penetration(&self, position: Position) -> i32 {
        position.saturating_since(self.surface)
    }

    /// Returns `K * penetration + B * velocity` in contact, otherwise zero. With `push_only` the sum is never negative,
    /// so the wall never pulls. While gains fade, `within` of `src/safety/gain_fade.rs` keeps this sign. Each term
    /// saturates at +-2^31 full scales ([`Gain::PRODUCT_LIMIT`]).
    #[inline]
    pub fn demand(&self, position: Position, velocity: Velocity) -> Demand {
        let penetration = self.penetration(position);
        if penetration <= 0 {
            return Demand::ZERO;
        }
        let spring = self.stiffness.apply(penetration);
        let damper = self.damping.apply(velocity.bits());
        let limit = Gain::PRODUCT_LIMIT.unsigned_abs();
        let clipped = spring.unsigned_abs() >= limit || damper.unsigned_abs() >= limit;
        let total = spring + damper; // each within +-2^61
        let one_sided = if self.push_only { total.max(0) } else { total };
        Demand::from_bits(one_sided).clipped_if(clipped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn wall(push_only: bool) -> Wall {
        Wall {
            surface: Position::from_counts(100),
            stiffness: Gain::from_f64(1000.0).unwrap(),
            damping: Gain::from_f64(10.0).unwrap(),
            push_only,
        }
    }

    fn at(counts: i32) -> Position {
        Position::from_counts(counts)
    }

    #[test]
    fn the_surface_itself_is_not_in_contact() {
        assert_eq!(wall(false).demand(at(100), Velocity::saturating_from_bits(50)), Demand::ZERO);
        assert_eq!(wall(false).demand(at(101), Velocity::ZERO).bits(), 1000);
    }

    #[test]
    fn spring_and_damper_add_and_only_a_bilateral_wall_pulls() {
        let out = Velocity::saturating_from_bits(-500);
        assert_eq!(wall(false).demand(at(102), out).bits(), 2000 - 5000);
        assert_eq!(wall(true).demand(at(102), out), Demand::ZERO);
    }

    #[test]
    fn far_positions_and_high_speeds_saturate() {
        let strong = Wall { stiffness: Gain::from_f64(2f64.powi(53)).unwrap(), ..wall(false) };
        assert_eq!(strong.demand(at(i32::MAX), Velocity::ZERO).bits(), Gain::PRODUCT_LIMIT);
        let low = Wall { surface: at(-(1 << 30)), ..strong };
        assert_eq!(low.penetration(at(i32::MAX)), i32::MAX);
        let fast = Velocity::saturating_from_bits(i32::MIN);
        let viscous = Wall { damping: Gain::from_f64(2f64.powi(50)).unwrap(), ..wall(false) };
        assert_eq!(viscous.demand(at(101), fast).bits(), 1000 - Gain::PRODUCT_LIMIT);
        // One term is clipped, and the other cancels nearly all of it. So the true sum is not known.
        let slow = Velocity::saturating_from_bits(-32_767 << 16);
        let back = Gain::from_f64(1_073_774_593.0).unwrap(); // (2^61 - 2^16) / (32 767 x 2^16)
        let one = Wall { damping: back, ..strong };
        assert_eq!(one.demand(at(i32::MAX), slow).bits(), 1 << 16);
        assert!(one.demand(at(i32::MAX), slow).saturate().1);
        assert_eq!((one.stiffness(), one.damping()), (strong.stiffness, back));
        // Both terms are beyond the range, in opposite directions. So the true sum is not known, and the demand is
        // marked as clipped.
        let both = Wall { damping: viscous.damping, ..strong };
        assert!(both.demand(at(i32::MAX), fast).saturate().1);
    }

    proptest! {
        #[test]
        fn a_push_only_wall_never_pulls_and_grows_with_depth(
            a in any::<i32>(), b in any::<i32>(), velocity in any::<i32>()
        ) {
            let wall = wall(true);
            let velocity = Velocity::saturating_from_bits(velocity);
            let (shallow, deep) = (a.min(b), a.max(b));
            let (f1, f2) = (wall.demand(at(shallow), velocity), wall.demand(at(deep), velocity));
            prop_assert!(f1.bits() >= 0 && f2.bits() >= f1.bits());
        }
    }
}
