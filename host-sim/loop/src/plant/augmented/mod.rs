//! The exact step of a device with linear elements: as [`super::PlantStep`], with N states.

use super::{AnyState, LinearStep, Plant};
use crate::{
    numerics::exact::discretise,
    scene::element::{Chain, NOTHING},
};

/// The exact step of a [`Chain`] of N states over one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AugmentedStep<const N: usize> {
    phi: [[f64; N]; N],
    /// Effect of a force that acts over the whole sample.
    gamma: [f64; N],
    /// Effect of the force that acts until the split.
    before: [f64; N],
    /// Effect of the force that acts from the split on.
    after: [f64; N],
    /// What a hand's constant force adds in a sample.
    hand: [f64; N],
    /// Where the bodies rest, m.
    rest_m: [f64; 3],
}

/// Positions from rest and speeds of the bodies, and the amplifier's force if N is odd.
pub type ChainState<const N: usize> = [f64; N];

/// The state of bodies that all stand still at `position_m`, without a force.
pub(super) fn still<const N: usize>(rest_m: &[f64; 3], position_m: f64) -> ChainState<N> {
    let mut state = [0.0; N];
    for (body, rest) in rest_m.iter().take(N / 2).enumerate() {
        state[2 * body] = position_m - rest;
    }
    state
}

impl<const N: usize> AugmentedStep<N> {
    /// The step over `sample_s`, split at `fraction` (0 to below 1) of it. N must be the chain's
    /// number of states.
    ///
    /// # Panics
    /// On another N.
    pub fn new(chain: &Chain, sample_s: f64, fraction: f64) -> Self {
        let (a, b) = chain.system::<N>();
        let (phi, whole) = discretise(&a, &b, sample_s);
        let (_, early) = discretise(&a, &b, fraction * sample_s);
        let (late_phi, late) = discretise(&a, &b, (1.0 - fraction) * sample_s);
        let hand = chain.hand_moves(sample_s);
        let array = |row: usize| core::array::from_fn(|column| phi[(row, column)]);
        Self {
            phi: core::array::from_fn(array),
            gamma: whole.into(),
            before: core::array::from_fn(|row| {
                (0..N).map(|column| late_phi[(row, column)] * early[column]).sum()
            }),
            after: late.into(),
            hand: core::array::from_fn(|row| hand[row]),
            rest_m: chain.rest_m(),
        }
    }

    pub(crate) fn linear(&self) -> LinearStep<N> {
        let Self { phi, gamma, before, after, hand, rest_m } = *self;
        LinearStep { phi, gamma, before, after, hand, rest_m }
    }

    #[inline]
    fn free(&self, state: &ChainState<N>) -> ChainState<N> {
        let mut next = [0.0; N];
        for (next, row) in next.iter_mut().zip(&self.phi) {
            for (entry, value) in row.iter().zip(state) {
                *next += entry * value;
            }
        }
        next
    }
}

#[inline]
fn plus<const N: usize>(
    mut state: [f64; N],
    effect: &[f64; N],
    force_n: f64,
    hand: &[f64; N],
) -> [f64; N] {
    for ((value, effect), hand) in state.iter_mut().zip(effect).zip(hand) {
        *value += effect * force_n + hand;
    }
    state
}

impl<const N: usize> Plant for AugmentedStep<N> {
    type State = ChainState<N>;

    fn at_rest(&self, position_m: f64) -> Self::State {
        still(&self.rest_m, position_m)
    }

    #[inline]
    fn position_m(&self, state: &Self::State) -> f64 {
        state[0] + self.rest_m[0]
    }

    #[inline]
    fn speed_m_per_s(&self, state: &Self::State) -> f64 {
        state[1]
    }

    #[inline]
    fn force_n(&self, state: &Self::State, output_n: f64) -> f64 {
        if N % 2 == 1 { state[N - 1] } else { output_n }
    }

    #[inline]
    fn advance(&self, state: &Self::State, force_n: f64) -> Self::State {
        plus(self.free(state), &self.gamma, force_n, &self.hand)
    }

    #[inline]
    fn advance_split(&self, state: &Self::State, before_n: f64, after_n: f64) -> Self::State {
        let early = plus(self.free(state), &self.before, before_n, &[NOTHING; N]);
        plus(early, &self.after, after_n, &self.hand)
    }

    fn pack(state: &Self::State) -> AnyState {
        let mut any = AnyState::default();
        any.z[..N].copy_from_slice(state);
        any
    }

    fn unpack(any: &AnyState) -> Self::State {
        core::array::from_fn(|i| any.z[i])
    }
}

#[cfg(test)]
mod tests;
