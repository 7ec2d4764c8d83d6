//! A plant whose force is not proportional to the command.

use super::{AnyState, Moment, Plant};
use crate::scene::element::AmplifierError;

/// A plant with an amplifier error before it.
#[derive(Clone, Debug)]
pub struct Driven<P> {
    plant: P,
    error: AmplifierError,
    full_scale_n: f64,
}

impl<P: Plant> Driven<P> {
    pub fn new(plant: P, error: AmplifierError, full_scale_n: f64) -> Self {
        Self { plant, error, full_scale_n }
    }

    #[inline]
    fn given_n(&self, command_n: f64) -> f64 {
        self.error.force_n(command_n, self.full_scale_n)
    }
}

impl<P: Plant> Plant for Driven<P> {
    type State = P::State;

    fn at_rest(&self, position_m: f64) -> Self::State {
        self.plant.at_rest(position_m)
    }

    fn position_m(&self, state: &Self::State) -> f64 {
        self.plant.position_m(state)
    }

    fn speed_m_per_s(&self, state: &Self::State) -> f64 {
        self.plant.speed_m_per_s(state)
    }

    fn force_n(&self, state: &Self::State, output_n: f64) -> f64 {
        self.plant.force_n(state, self.given_n(output_n))
    }

    fn reading_m(&self, state: &Self::State, moment: &Moment) -> f64 {
        let (before_n, after_n) = (self.given_n(moment.before_n), self.given_n(moment.after_n));
        self.plant.reading_m(state, &Moment { before_n, after_n, ..*moment })
    }

    fn later_m(&self, state: &Self::State, delay_s: f64, forces_n: [f64; 2]) -> Option<f64> {
        self.plant.later_m(state, delay_s, forces_n.map(|force_n| self.given_n(force_n)))
    }

    fn advance(&self, state: &Self::State, force_n: f64) -> Self::State {
        self.plant.advance(state, self.given_n(force_n))
    }

    fn advance_split(&self, state: &Self::State, before_n: f64, after_n: f64) -> Self::State {
        self.plant.advance_split(state, self.given_n(before_n), self.given_n(after_n))
    }

    fn steps(&self, state: &Self::State) -> u64 {
        self.plant.steps(state)
    }

    fn pack(state: &Self::State) -> AnyState {
        P::pack(state)
    }

    fn unpack(any: &AnyState) -> Self::State {
        P::unpack(any)
    }
}
