//! Any plant behind one type: for callers that take what a scene asks for and do not mind a look at
//! its kind in every step. Runs of whole hits do mind, and are made for each kind ([`each_plant`]).

use super::{AugmentedStep, Plant, PlantStep};
use crate::element::{Chain, STATES_MAX};

/// The state of any plant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AnyState {
    /// States of the chain; unused places are 0.
    pub(super) z: [f64; STATES_MAX],
}

/// The plant of a scene.
#[derive(Clone, Debug)]
pub enum AnyPlant {
    /// A device alone.
    Plain(PlantStep),
    /// With an amplifier.
    Three(AugmentedStep<3>),
    /// Two bodies.
    Four(AugmentedStep<4>),
    /// Two bodies and an amplifier.
    Five(AugmentedStep<5>),
    /// Three bodies.
    Six(AugmentedStep<6>),
    /// Three bodies and an amplifier.
    Seven(AugmentedStep<7>),
}

/// Runs an expression with the plant that an [`AnyPlant`] holds, compiled for each kind.
macro_rules! each_plant {
    ($any:expr, $plant:ident => $body:expr) => {
        match $any {
            $crate::plant::AnyPlant::Plain($plant) => $body,
            $crate::plant::AnyPlant::Three($plant) => $body,
            $crate::plant::AnyPlant::Four($plant) => $body,
            $crate::plant::AnyPlant::Five($plant) => $body,
            $crate::plant::AnyPlant::Six($plant) => $body,
            $crate::plant::AnyPlant::Seven($plant) => $body,
        }
    };
}
pub(crate) use each_plant;

impl AnyPlant {
    /// The step over `sample_s`, split at `fraction` (0 to below 1) of it.
    pub fn new(chain: &Chain, sample_s: f64, fraction: f64) -> Self {
        match chain.states() {
            2 => Self::Plain(PlantStep::new(&chain.device, sample_s, fraction)),
            3 => Self::Three(AugmentedStep::new(chain, sample_s, fraction)),
            4 => Self::Four(AugmentedStep::new(chain, sample_s, fraction)),
            5 => Self::Five(AugmentedStep::new(chain, sample_s, fraction)),
            6 => Self::Six(AugmentedStep::new(chain, sample_s, fraction)),
            _ => Self::Seven(AugmentedStep::new(chain, sample_s, fraction)),
        }
    }
}

/// The state after a function of a plant and its own state.
fn through<P: Plant>(
    plant: &P,
    state: &AnyState,
    step: impl Fn(&P, &P::State) -> P::State,
) -> AnyState {
    P::pack(&step(plant, &P::unpack(state)))
}

/// What a function of a plant and its own state gives.
fn of<P: Plant>(plant: &P, state: &AnyState, value: impl Fn(&P, &P::State) -> f64) -> f64 {
    value(plant, &P::unpack(state))
}

fn at_rest<P: Plant>(plant: &P, position_m: f64) -> AnyState {
    P::pack(&plant.at_rest(position_m))
}

impl Plant for AnyPlant {
    type State = AnyState;

    fn at_rest(&self, position_m: f64) -> AnyState {
        each_plant!(self, plant => at_rest(plant, position_m))
    }

    fn position_m(&self, state: &AnyState) -> f64 {
        each_plant!(self, plant => of(plant, state, Plant::position_m))
    }

    fn speed_m_per_s(&self, state: &AnyState) -> f64 {
        each_plant!(self, plant => of(plant, state, Plant::speed_m_per_s))
    }

    fn force_n(&self, state: &AnyState, output_n: f64) -> f64 {
        each_plant!(self, plant => of(plant, state, |plant, state| plant.force_n(state, output_n)))
    }

    fn advance(&self, state: &AnyState, force_n: f64) -> AnyState {
        each_plant!(self, plant => through(plant, state, |plant, state| plant.advance(state, force_n)))
    }

    fn advance_split(&self, state: &AnyState, before_n: f64, after_n: f64) -> AnyState {
        each_plant!(self, plant => through(plant, state, |plant, state| {
            plant.advance_split(state, before_n, after_n)
        }))
    }

    fn pack(state: &AnyState) -> AnyState {
        *state
    }

    fn unpack(any: &AnyState) -> AnyState {
        *any
    }
}
