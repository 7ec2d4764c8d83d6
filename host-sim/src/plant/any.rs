//! Any plant behind one type: for callers that take what a scene asks for and do not mind a look at
//! its kind in every step. Runs of whole hits do mind, and are made for each kind ([`each_plant`]).

use super::{AugmentedStep, IntegratedStep, Moment, Plant, PlantStep, Regime, Sensed, Sensing};
use crate::{
    numerics::integrator::Integrator,
    scene::{
        Scene,
        element::{Chain, Nonlinear, STATES_MAX},
    },
};

/// The state of any plant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AnyState {
    /// States of the chain; unused places are 0.
    pub(super) z: [f64; STATES_MAX],
    pub(super) regime: Regime,
    pub(super) step_s: f64,
    pub(super) hit: u64,
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
    /// Integrated: a device alone.
    IntegratedTwo(IntegratedStep<2>),
    /// Integrated, with an amplifier.
    IntegratedThree(IntegratedStep<3>),
    /// Integrated: two bodies.
    IntegratedFour(IntegratedStep<4>),
    /// Integrated: two bodies and an amplifier.
    IntegratedFive(IntegratedStep<5>),
    /// Integrated: three bodies.
    IntegratedSix(IntegratedStep<6>),
    /// Integrated: three bodies and an amplifier.
    IntegratedSeven(IntegratedStep<7>),
    /// A device alone, with something wrong with its readings.
    SensedPlain(Sensed<PlantStep>),
    /// Any other, with something wrong with its readings.
    Sensed(Sensed<Box<AnyPlant>>),
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
            $crate::plant::AnyPlant::IntegratedTwo($plant) => $body,
            $crate::plant::AnyPlant::IntegratedThree($plant) => $body,
            $crate::plant::AnyPlant::IntegratedFour($plant) => $body,
            $crate::plant::AnyPlant::IntegratedFive($plant) => $body,
            $crate::plant::AnyPlant::IntegratedSix($plant) => $body,
            $crate::plant::AnyPlant::IntegratedSeven($plant) => $body,
            $crate::plant::AnyPlant::SensedPlain($plant) => $body,
            $crate::plant::AnyPlant::Sensed($plant) => $body,
        }
    };
}
pub(crate) use each_plant;

impl AnyPlant {
    /// The plant of a scene, sampled every `sample_s`, with a command taking effect at `fraction` (0 to
    /// below 1) of it, and what its encoder reads.
    pub fn of(scene: &Scene, sample_s: f64, fraction: f64) -> Self {
        let chain = scene.chain();
        let split_s = fraction * sample_s;
        let sensing = Sensing::of(scene);
        let plant = Self::unsensed(scene, sample_s, fraction);
        match plant {
            plant if sensing.is_perfect() => plant,
            Self::Plain(plant) => Self::SensedPlain(Sensed::new(plant, sensing, &chain, split_s)),
            plant => Self::Sensed(Sensed::new(Box::new(plant), sensing, &chain, split_s)),
        }
    }

    /// The plant of a scene without what may be wrong with its readings.
    pub fn unsensed(scene: &Scene, sample_s: f64, fraction: f64) -> Self {
        let chain = scene.chain();
        match scene.integrator {
            None => Self::exact(&chain, sample_s, fraction),
            Some(integrator) => {
                let nonlinear = scene.nonlinear();
                Self::integrated(&chain, &nonlinear, integrator, sample_s, fraction)
            }
        }
    }

    /// A plant that is integrated step by step, linear or not.
    pub fn integrated(
        chain: &Chain,
        nonlinear: &Nonlinear,
        integrator: Integrator,
        sample_s: f64,
        fraction: f64,
    ) -> Self {
        macro_rules! of {
            () => {
                IntegratedStep::new(chain, nonlinear, integrator, sample_s, fraction)
            };
        }
        match chain.states() {
            2 => Self::IntegratedTwo(of!()),
            3 => Self::IntegratedThree(of!()),
            4 => Self::IntegratedFour(of!()),
            5 => Self::IntegratedFive(of!()),
            6 => Self::IntegratedSix(of!()),
            _ => Self::IntegratedSeven(of!()),
        }
    }

    /// The exact step over `sample_s`, split at `fraction` (0 to below 1) of it.
    pub fn exact(chain: &Chain, sample_s: f64, fraction: f64) -> Self {
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
    step: impl FnOnce(&P, &P::State) -> P::State,
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

    fn reading_m(&self, state: &AnyState, moment: &Moment) -> f64 {
        each_plant!(self, plant => of(plant, state, |plant, state| plant.reading_m(state, moment)))
    }

    fn later_m(&self, state: &AnyState, delay_s: f64, before_n: f64, after_n: f64) -> Option<f64> {
        fn of<P: Plant>(
            plant: &P,
            state: &AnyState,
            delay_s: f64,
            forces: [f64; 2],
        ) -> Option<f64> {
            plant.later_m(&P::unpack(state), delay_s, forces[0], forces[1])
        }
        each_plant!(self, plant => of(plant, state, delay_s, [before_n, after_n]))
    }

    fn advance(&self, state: &AnyState, force_n: f64) -> AnyState {
        each_plant!(self, plant => through(plant, state, |plant, state| plant.advance(state, force_n)))
    }

    fn advance_split(&self, state: &AnyState, before_n: f64, after_n: f64) -> AnyState {
        each_plant!(self, plant => through(plant, state, |plant, state| {
            plant.advance_split(state, before_n, after_n)
        }))
    }

    fn advance_counting(
        &self,
        state: &AnyState,
        before_n: f64,
        after_n: Option<f64>,
        steps: &mut u64,
    ) -> AnyState {
        each_plant!(self, plant => through(plant, state, |plant, state| {
            plant.advance_counting(state, before_n, after_n, steps)
        }))
    }

    fn pack(state: &AnyState) -> AnyState {
        *state
    }

    fn unpack(any: &AnyState) -> AnyState {
        *any
    }
}

impl Plant for Box<AnyPlant> {
    type State = AnyState;

    fn at_rest(&self, position_m: f64) -> AnyState {
        (**self).at_rest(position_m)
    }

    fn position_m(&self, state: &AnyState) -> f64 {
        (**self).position_m(state)
    }

    fn speed_m_per_s(&self, state: &AnyState) -> f64 {
        (**self).speed_m_per_s(state)
    }

    fn force_n(&self, state: &AnyState, output_n: f64) -> f64 {
        (**self).force_n(state, output_n)
    }

    fn reading_m(&self, state: &AnyState, moment: &Moment) -> f64 {
        (**self).reading_m(state, moment)
    }

    fn later_m(&self, state: &AnyState, delay_s: f64, before_n: f64, after_n: f64) -> Option<f64> {
        (**self).later_m(state, delay_s, before_n, after_n)
    }

    fn advance(&self, state: &AnyState, force_n: f64) -> AnyState {
        (**self).advance(state, force_n)
    }

    fn advance_split(&self, state: &AnyState, before_n: f64, after_n: f64) -> AnyState {
        (**self).advance_split(state, before_n, after_n)
    }

    fn pack(state: &AnyState) -> AnyState {
        *state
    }

    fn unpack(any: &AnyState) -> AnyState {
        *any
    }
}
