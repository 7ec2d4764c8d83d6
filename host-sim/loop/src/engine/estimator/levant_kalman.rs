//! [`LevantKalman`](velocity::LevantKalman) in lanes: the differentiator's, and the core's own text of the filter.

use zwidth::velocity::{self, Estimator, Integrator, IntegratorState};

use super::{
    Recursive,
    levant::{Levant, Sizes},
    word::{FACTOR_BITS, LaneGain, Vector},
};
use crate::engine::simd_ops::{SimdOps, lanes, lanes_mut};

/// Of both, a lane each.
#[derive(Clone, Copy)]
pub struct Gains<S: SimdOps> {
    levant: Sizes<S>,
    filter: Integrator<LaneGain<S>>,
    /// All ones where the lanes do not have the gains.
    without: S::u64s,
}

/// States of both, a lane each.
#[derive(Clone, Copy)]
pub struct LevantKalman<S: SimdOps> {
    levant: Levant<S, false>,
    filter: IntegratorState<Vector<S>>,
    /// All estimates so far, one over the other: beyond 2 [`LIMIT`] if one was out of bounds.
    seen: S::u64s,
}

/// Position and velocity: 2^14 counts, per sample. What the filter's differ by from a jump of as much, and from a velocity
/// of the differentiator below as much, may be multiplied.
const LIMIT: u64 = 1 << (FACTOR_BITS - 2);

impl<S: SimdOps> Recursive<S> for LevantKalman<S> {
    type Gains = Gains<S>;

    fn at_rest(simd: S) -> (Self, Gains<S>) {
        let of = |bits: u64| Vector { simd, bits: simd.splat_u64s(bits) };
        let (levant, sizes) = Levant::at_rest(simd);
        let residue = of(Integrator::REST.residue.into());
        let filter = IntegratorState { distance: of(0), velocity: of(0), residue };
        let gains = Integrator { gains: [[LaneGain::zero(simd); 2]; 2] };
        let zero = simd.splat_u64s(0);
        (Self { levant, filter, seen: zero }, Gains { levant: sizes, filter: gains, without: zero })
    }

    fn words(&mut self) -> impl Iterator<Item = &mut S::u64s> {
        let IntegratorState { distance, velocity, residue } = &mut self.filter;
        let words = [distance, velocity, residue].map(|word| &mut word.bits);
        self.levant.words().chain(words).chain([&mut self.seen])
    }

    fn tune(gains: &mut Gains<S>, lane: usize, estimator: &Estimator) {
        let Estimator::LevantKalman(velocity::LevantKalman { levant, filter }) = estimator else {
            return;
        };
        gains.levant.set(lane, levant);
        let mut has = true;
        let places = gains.filter.gains.as_flattened_mut();
        for (place, gain) in places.iter_mut().zip(filter.gains.as_flattened()) {
            place.set(lane, *gain);
            has &= LaneGain::<S>::has(*gain);
        }
        lanes_mut(&mut gains.without)[lane] = if has { 0 } else { u64::MAX };
    }

    #[inline(always)]
    fn step(&mut self, simd: S, gains: &Gains<S>, moved: S::f64s) -> S::u64s {
        let measured = Vector { simd, bits: self.levant.step(simd, &gains.levant, moved) };
        let moved = Vector { simd, bits: simd.to_low(moved) };
        let velocity = gains.filter.update(&mut self.filter, moved, measured);
        let IntegratorState { distance, velocity: speed, .. } = self.filter;
        let [near, slow] =
            [distance, speed].map(|word| simd.add_u64s(word.bits, simd.splat_u64s(LIMIT)));
        self.seen = simd.or_u64s(self.seen, simd.or_u64s(near, slow));
        velocity.bits
    }

    fn is_lost(&self, gains: &Gains<S>, lane: usize) -> bool {
        let get = |word: &S::u64s| lanes::<_, u64>(word)[lane];
        let beyond = get(&self.seen) >= 2 * LIMIT || get(&gains.without) != 0;
        beyond || self.levant.is_lost(&gains.levant, lane)
    }
}
