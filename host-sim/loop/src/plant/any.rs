//! The plant of any scene in one type. A plant with an exact step has a variant for its number of states.
//! [`each_plant`] compiles the loop of a hit for each variant. A step of a plant without an exact step takes so long
//! that a call through a vtable does not matter.

use std::{fmt::Debug, sync::Arc};

use super::{
    AnyState, Course, Driven, ExactStep, IntegratedStep, Moment, Places, Plant, PlantStep, Sensed,
    Sensing, Span,
};
use crate::{
    numerics::integrator::Integrator,
    scene::{
        Scene,
        element::{Chain, Nonlinear, STATES_MAX, of_states},
    },
};

#[derive(Clone, Debug)]
pub enum AnyPlant {
    /// A device alone, without an amplifier.
    Plain(PlantStep),
    /// A device with an amplifier.
    Three(ExactStep<3>),
    /// Two bodies without an amplifier.
    Four(ExactStep<4>),
    /// Two bodies and an amplifier.
    Five(ExactStep<5>),
    /// Three bodies without an amplifier.
    Six(ExactStep<6>),
    /// Three bodies and an amplifier.
    Seven(ExactStep<7>),
    /// A plant that is integrated, or a plant whose encoder readings have errors.
    Other(Arc<dyn OtherPlant>),
}

/// Runs an expression with the plant in an [`AnyPlant`]. The expression is compiled for each plant with an exact
/// step, and once for all other plants.
#[macro_export]
macro_rules! each_plant {
    ($any:expr, $plant:ident => $body:expr) => {
        match $any {
            $crate::plant::AnyPlant::Plain($plant) => $body,
            $crate::plant::AnyPlant::Three($plant) => $body,
            $crate::plant::AnyPlant::Four($plant) => $body,
            $crate::plant::AnyPlant::Five($plant) => $body,
            $crate::plant::AnyPlant::Six($plant) => $body,
            $crate::plant::AnyPlant::Seven($plant) => $body,
            $plant @ $crate::plant::AnyPlant::Other(_) => $body,
        }
    };
}
pub use each_plant;

/// The functions of [`Plant`] with a state type that fits all plants, so that they can be called through a vtable.
pub trait OtherPlant: Debug + Send + Sync {
    fn any_at_rest(&self, position_m: f64) -> AnyState;
    fn any_position_m(&self, state: &AnyState) -> f64;
    fn any_speed_m_per_s(&self, state: &AnyState) -> f64;
    fn any_force_n(&self, state: &AnyState, output_n: f64) -> f64;
    fn any_reading_m(&self, state: &AnyState, moment: &Moment) -> f64;
    fn any_later_m(&self, state: &AnyState, delay_s: f64, forces_n: [f64; 2]) -> Option<f64>;
    fn any_advance(&self, state: &AnyState, force_n: f64) -> AnyState;
    fn any_advance_split(&self, state: &AnyState, before_n: f64, after_n: f64) -> AnyState;
    fn any_run(
        &self,
        state: &AnyState,
        span: &Span,
        places: &mut Places<'_>,
        course: &mut Course,
    ) -> AnyState;
    fn any_steps(&self, state: &AnyState) -> u64;
}

impl<P: Plant + Debug + Send + Sync> OtherPlant for P {
    fn any_at_rest(&self, position_m: f64) -> AnyState {
        P::pack(&self.at_rest(position_m))
    }

    fn any_position_m(&self, state: &AnyState) -> f64 {
        self.position_m(&P::unpack(state))
    }

    fn any_speed_m_per_s(&self, state: &AnyState) -> f64 {
        self.speed_m_per_s(&P::unpack(state))
    }

    fn any_force_n(&self, state: &AnyState, output_n: f64) -> f64 {
        self.force_n(&P::unpack(state), output_n)
    }

    fn any_reading_m(&self, state: &AnyState, moment: &Moment) -> f64 {
        self.reading_m(&P::unpack(state), moment)
    }

    fn any_later_m(&self, state: &AnyState, delay_s: f64, forces_n: [f64; 2]) -> Option<f64> {
        self.later_m(&P::unpack(state), delay_s, forces_n)
    }

    fn any_advance(&self, state: &AnyState, force_n: f64) -> AnyState {
        P::pack(&self.advance(&P::unpack(state), force_n))
    }

    fn any_advance_split(&self, state: &AnyState, before_n: f64, after_n: f64) -> AnyState {
        P::pack(&self.advance_split(&P::unpack(state), before_n, after_n))
    }

    fn any_run(
        &self,
        state: &AnyState,
        span: &Span,
        places: &mut Places<'_>,
        course: &mut Course,
    ) -> AnyState {
        P::pack(&self.run(P::unpack(state), span, places, course))
    }

    fn any_steps(&self, state: &AnyState) -> u64 {
        self.steps(&P::unpack(state))
    }
}

impl AnyPlant {
    /// Change of each state in one sample, caused by the hand's constant force. It is 0 for [`Self::Other`].
    pub(crate) fn hand(&self) -> [f64; 7] {
        match self {
            Self::Plain(step) => step.padded::<7>().hand,
            Self::Three(step) => step.padded::<7>().hand,
            Self::Four(step) => step.padded::<7>().hand,
            Self::Five(step) => step.padded::<7>().hand,
            Self::Six(step) => step.padded::<7>().hand,
            Self::Seven(step) => step.padded::<7>().hand,
            Self::Other(_) => [0.0; 7],
        }
    }

    /// The plant of a scene, with the errors of its encoder. The plant is sampled every `sample_s`. A command takes
    /// effect at `fraction` (0 to below 1) of the sample.
    pub fn of(scene: &Scene, sample_s: f64, fraction: f64) -> Self {
        let sensing = Sensing::of(scene);
        let plant = Self::ideal(scene, sample_s, fraction);
        if sensing.is_perfect() {
            return plant.driven(scene);
        }
        let (chain, split_s) = (scene.chain(), fraction * sample_s);
        let plant = match plant {
            Self::Plain(plant) => Self::other(Sensed::new(plant, sensing, &chain, split_s)),
            plant => Self::other(Sensed::new(plant, sensing, &chain, split_s)),
        };
        plant.driven(scene)
    }

    /// The plant of a scene without the errors of its encoder.
    pub fn unsensed(scene: &Scene, sample_s: f64, fraction: f64) -> Self {
        Self::ideal(scene, sample_s, fraction).driven(scene)
    }

    /// Puts the error of the scene's amplifier before the plant, if the amplifier has an error.
    fn driven(self, scene: &Scene) -> Self {
        match scene.amplifier_error {
            None => self,
            Some(error) => Self::other(Driven::new(self, error, scene.full_scale_n())),
        }
    }

    /// The plant of a scene without the errors of its encoder and its amplifier.
    fn ideal(scene: &Scene, sample_s: f64, fraction: f64) -> Self {
        let chain = scene.chain();
        match scene.integrator {
            None => Self::exact(&chain, sample_s, fraction),
            Some(integrator) => {
                let nonlinear = scene.nonlinear();
                Self::integrated(&chain, &nonlinear, integrator, sample_s, fraction)
            }
        }
    }

    fn other(plant: impl OtherPlant + 'static) -> Self {
        Self::Other(Arc::new(plant))
    }

    pub fn integrated(
        chain: &Chain,
        nonlinear: &Nonlinear,
        integrator: Integrator,
        sample_s: f64,
        fraction: f64,
    ) -> Self {
        of_states!(chain.states(), N => Self::other(IntegratedStep::<N>::new(
            chain, nonlinear, integrator, sample_s, fraction,
        )))
    }

    /// The exact step over `sample_s`. A command takes effect at `fraction` (0 to below 1) of the sample.
    pub fn exact(chain: &Chain, sample_s: f64, fraction: f64) -> Self {
        match chain.states() {
            2 => {
                let [x, v, ..] = chain.hand_moves(sample_s);
                let step = PlantStep::new(&chain.device, sample_s, fraction);
                Self::Plain(ExactStep { hand: [x, v], ..step })
            }
            3 => Self::Three(ExactStep::of_chain(chain, sample_s, fraction)),
            4 => Self::Four(ExactStep::of_chain(chain, sample_s, fraction)),
            5 => Self::Five(ExactStep::of_chain(chain, sample_s, fraction)),
            6 => Self::Six(ExactStep::of_chain(chain, sample_s, fraction)),
            _ => Self::Seven(ExactStep::of_chain(chain, sample_s, fraction)),
        }
    }
}

impl AnyPlant {
    fn table(&self) -> &dyn OtherPlant {
        match self {
            Self::Plain(plant) => plant,
            Self::Three(plant) => plant,
            Self::Four(plant) => plant,
            Self::Five(plant) => plant,
            Self::Six(plant) => plant,
            Self::Seven(plant) => plant,
            Self::Other(plant) => &**plant,
        }
    }
}

impl Plant for AnyPlant {
    type State = AnyState;

    fn at_rest(&self, position_m: f64) -> AnyState {
        self.table().any_at_rest(position_m)
    }

    fn position_m(&self, state: &AnyState) -> f64 {
        self.table().any_position_m(state)
    }

    fn speed_m_per_s(&self, state: &AnyState) -> f64 {
        self.table().any_speed_m_per_s(state)
    }

    fn force_n(&self, state: &AnyState, output_n: f64) -> f64 {
        self.table().any_force_n(state, output_n)
    }

    fn reading_m(&self, state: &AnyState, moment: &Moment) -> f64 {
        self.table().any_reading_m(state, moment)
    }

    fn later_m(&self, state: &AnyState, delay_s: f64, forces_n: [f64; 2]) -> Option<f64> {
        self.table().any_later_m(state, delay_s, forces_n)
    }

    fn advance(&self, state: &AnyState, force_n: f64) -> AnyState {
        self.table().any_advance(state, force_n)
    }

    fn advance_split(&self, state: &AnyState, before_n: f64, after_n: f64) -> AnyState {
        self.table().any_advance_split(state, before_n, after_n)
    }

    fn run(
        &self,
        state: AnyState,
        span: &Span,
        places: &mut Places<'_>,
        course: &mut Course,
    ) -> AnyState {
        self.table().any_run(&state, span, places, course)
    }

    fn steps(&self, state: &AnyState) -> u64 {
        self.table().any_steps(state)
    }

    fn pack(state: &AnyState) -> AnyState {
        *state
    }

    fn unpack(any: &AnyState) -> AnyState {
        *any
    }
}
