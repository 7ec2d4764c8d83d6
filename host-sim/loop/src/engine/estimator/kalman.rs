//! [`Kalman`] in lanes: the core's own code, over vectors.

use zwidth::velocity::{self, Estimator, KalmanState};

use super::{
    Recursive,
    word::{FACTOR_BITS, LaneGain, Vector},
};
use crate::engine::simd_ops::{SimdOps, lanes, lanes_mut};

#[derive(Clone, Copy)]
pub struct Gains<S: SimdOps> {
    filter: velocity::Kalman<LaneGain<S>>,
    /// All bits are set for lanes whose gains are too large for the lane arithmetic.
    without: S::u64s,
}

#[derive(Clone, Copy)]
pub struct Kalman<S: SimdOps> {
    state: KalmanState<Vector<S>>,
    /// Bitwise OR of all estimates so far. The result is above twice the limit if an estimate was out of bounds.
    seen: [S::u64s; 2],
}

/// Limit of position and velocity. Below this limit, the prediction can be multiplied even after a jump of 2^14 counts.
const LIMIT: u64 = 1 << (FACTOR_BITS - 2);
/// Limit of the acceleration. The acceleration has 12 more fractional bits than position and velocity.
const ACCELERATION_LIMIT: u64 = 1 << 58;

impl<S: SimdOps> Recursive<S> for Kalman<S> {
    type Gains = Gains<S>;

    fn at_rest(simd: S) -> (Self, Gains<S>) {
        let of = |bits: u64| Vector { simd, bits: simd.splat_u64s(bits) };
        let rest = velocity::Kalman::REST;
        let state = KalmanState {
            distance: of(0),
            velocity: of(0),
            acceleration: of(0),
            residue: of(rest.residue.into()),
        };
        let gain = LaneGain::zero(simd);
        let filter = velocity::Kalman { alpha: gain, beta: gain, gamma: gain };
        let zero = simd.splat_u64s(0);
        (Self { state, seen: [zero; 2] }, Gains { filter, without: zero })
    }

    fn words(&mut self) -> impl Iterator<Item = &mut S::u64s> {
        let KalmanState { distance, velocity, acceleration, residue } = &mut self.state;
        let words = [distance, velocity, acceleration, residue].map(|word| &mut word.bits);
        words.into_iter().chain(&mut self.seen)
    }

    fn tune(gains: &mut Gains<S>, lane: usize, estimator: &Estimator) {
        let Estimator::Kalman(filter) = estimator else { return };
        let velocity::Kalman { alpha, beta, gamma } = &mut gains.filter;
        let mut has = true;
        for (place, gain) in [(alpha, filter.alpha), (beta, filter.beta), (gamma, filter.gamma)] {
            place.set(lane, gain);
            has &= LaneGain::<S>::has(gain);
        }
        lanes_mut(&mut gains.without)[lane] = if has { 0 } else { u64::MAX };
    }

    #[inline(always)]
    fn step(&mut self, simd: S, gains: &Gains<S>, moved: S::f64s) -> S::u64s {
        let moved = Vector { simd, bits: simd.to_low(moved) };
        let velocity = gains.filter.update(&mut self.state, moved);
        let KalmanState { distance, velocity: speed, acceleration, .. } = self.state;
        let [near, slow] =
            [distance, speed].map(|word| simd.add_u64s(word.bits, simd.splat_u64s(LIMIT)));
        let steady = simd.add_u64s(acceleration.bits, simd.splat_u64s(ACCELERATION_LIMIT));
        let [small, large] = self.seen;
        let small = simd.or_u64s(small, simd.or_u64s(near, slow));
        self.seen = [small, simd.or_u64s(large, steady)];
        velocity.bits
    }

    fn is_lost(&self, gains: &Gains<S>, lane: usize) -> bool {
        let get = |word: &S::u64s| lanes::<_, u64>(word)[lane];
        let [small, large] = self.seen.each_ref().map(get);
        small >= 2 * LIMIT || large >= 2 * ACCELERATION_LIMIT || get(&gains.without) != 0
    }
}
