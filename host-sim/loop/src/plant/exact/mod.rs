//! The exact step of a device. The device may be alone (two states), or have linear elements (up to seven states).

use super::{AnyState, Plant};
use crate::{
    numerics::exact::{discretise, oscillator_step},
    scene::{
        Device,
        element::{Chain, NOTHING},
    },
};

/// The exact step of N states over one sample. For each body the states are its position relative to rest, and its
/// speed. The device is the first body. If N is odd, the last state is the amplifier's force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExactStep<const N: usize> {
    pub(crate) phi: [[f64; N]; N],
    /// Effect of a force. In `gamma` the force acts over the whole sample, in `before` until the split, in `after` from
    /// the split on.
    pub(crate) gamma: [f64; N],
    pub(crate) before: [f64; N],
    pub(crate) after: [f64; N],
    /// Change of the state in one sample, caused by the hand's constant force.
    pub(crate) hand: [f64; N],
    pub(crate) rest_m: [f64; 3],
}

/// The exact step of a device alone.
pub type PlantStep = ExactStep<2>;

/// State of bodies at rest at `position_m`, without a force.
pub(super) fn still<const N: usize>(rest_m: &[f64; 3], position_m: f64) -> [f64; N] {
    let mut state = [0.0; N];
    for (body, rest) in rest_m.iter().take(N / 2).enumerate() {
        state[2 * body] = position_m - rest;
    }
    state
}

impl ExactStep<2> {
    /// The step over `sample_s`. A command takes effect at `fraction` (0 to below 1) of the sample.
    pub fn new(device: &Device, sample_s: f64, fraction: f64) -> Self {
        let stiffness = device.stiffness_n_per_m / device.mass_kg;
        let damping = device.damping_n_s_per_m / device.mass_kg;
        let mobility = 1.0 / device.mass_kg;
        let per_force = |gamma: [f64; 2]| gamma.map(|g| g * mobility);
        let (phi, whole) = oscillator_step(stiffness, damping, sample_s);
        let (_, early) = oscillator_step(stiffness, damping, fraction * sample_s);
        let (late_phi, late) = oscillator_step(stiffness, damping, (1.0 - fraction) * sample_s);
        Self {
            phi,
            gamma: per_force(whole),
            before: per_force(late_phi.map(|row| row[0] * early[0] + row[1] * early[1])),
            after: per_force(late),
            hand: [NOTHING; 2],
            rest_m: [device.rest_position_m; 3],
        }
    }
}

impl<const N: usize> ExactStep<N> {
    /// The step over `sample_s`. A command takes effect at `fraction` (0 to below 1) of the sample.
    ///
    /// # Panics
    /// N is not the chain's number of states.
    pub fn of_chain(chain: &Chain, sample_s: f64, fraction: f64) -> Self {
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

    /// The same step with more states. The added states stay 0 and change no bit of the other states.
    pub(crate) fn padded<const M: usize>(&self) -> ExactStep<M> {
        fn longer<T: Copy, const N: usize, const M: usize>(short: [T; N], rest: T) -> [T; M] {
            core::array::from_fn(|place| short.get(place).copied().unwrap_or(rest))
        }
        let Self { phi, gamma, before, after, hand, rest_m } = *self;
        ExactStep {
            phi: longer(phi.map(|row| longer(row, 0.0)), [0.0; M]),
            gamma: longer(gamma, 0.0),
            before: longer(before, 0.0),
            after: longer(after, 0.0),
            hand: longer(hand, 0.0),
            rest_m,
        }
    }

    #[inline]
    fn free(&self, state: &[f64; N]) -> [f64; N] {
        let mut next = [0.0; N];
        for (next, row) in next.iter_mut().zip(&self.phi) {
            for (term, (entry, value)) in row.iter().zip(state).enumerate() {
                let product = entry * value;
                let first = N == 2 && term == 0; // a sum with more states begins with 0, a sum with two states does not
                *next = if first { product } else { *next + product };
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

impl<const N: usize> Plant for ExactStep<N> {
    type State = [f64; N];

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
