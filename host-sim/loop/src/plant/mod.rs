//! The device, advanced exactly: `m x'' + b x' + k (x - x0) = F` with a force that is constant, or
//! steps once, within a sample.
//!
//! The state is `(x - x0, x')`. Under a constant force a step is `s' = phi s + gamma F`. Where the
//! force steps from F1 to F2 at `fraction` of the sample it is `s' = phi s + before F1 + after F2`,
//! `after = gamma((1 - fraction) T)`, `before = phi((1 - fraction) T) gamma(fraction T)`. A hand's constant force adds
//! the same to the state in every sample. Nothing is
//! approximated but by rounding. Forces or lengths scaled by a power of two give a run that is
//! bit-identical up to that scale.

mod any;
mod augmented;
mod course;
mod integrated;
pub mod quantiser;
mod sensed;

pub use any::each_plant;
pub use any::{AnyPlant, OtherPlant};
pub use augmented::{AugmentedStep, ChainState};
pub use course::{Course, Places, RUN, Span};
pub use integrated::{HybridState, IntegratedStep, Regime};
pub use sensed::{Sensed, SensedState, Sensing};

use crate::{
    numerics::exact::oscillator_step,
    scene::{
        Device,
        element::{NOTHING, STATES_MAX},
    },
};

/// A sample that the encoder is read for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Number of the sample.
    pub index: u64,
    /// Command that acts at its beginning, N.
    pub before_n: f64,
    /// Command that acts from its split on, N.
    pub after_n: f64,
}

/// What moves under the actuator's force, one sample at a time.
pub trait Plant: Clone {
    /// What a step changes.
    type State: Copy + core::fmt::Debug;

    /// The state of a handle at rest at `position_m`, before any force.
    fn at_rest(&self, position_m: f64) -> Self::State;
    /// Position where motor and encoder are, m.
    fn position_m(&self, state: &Self::State) -> f64;
    /// Speed where motor and encoder are, m/s.
    fn speed_m_per_s(&self, state: &Self::State) -> f64;
    /// Force of the actuator on the handle while `output_n` is commanded, N: the same, unless the
    /// amplifier takes time.
    #[inline]
    fn force_n(&self, _state: &Self::State, output_n: f64) -> f64 {
        output_n
    }
    /// What the encoder sees for a sample, m, before it is made a count: the position, unless it reads late or
    /// wrongly.
    #[inline]
    fn reading_m(&self, state: &Self::State, _moment: &Moment) -> f64 {
        self.position_m(state)
    }
    /// Position `delay_s` (below a sample) later, m, under the commands until the split and from it on, if this
    /// plant can say so by itself; an exact step is for whole samples only.
    fn later_m(&self, _state: &Self::State, _delay_s: f64, _forces_n: [f64; 2]) -> Option<f64> {
        None
    }
    /// The state one sample later, with `force_n` commanded all the while.
    fn advance(&self, state: &Self::State, force_n: f64) -> Self::State;
    /// The state one sample later, with `before_n` commanded until the split and `after_n` from it on.
    fn advance_split(&self, state: &Self::State, before_n: f64, after_n: f64) -> Self::State;
    /// Moves over a run of samples, read by the encoder.
    #[inline(always)]
    fn run(
        &self,
        state: Self::State,
        span: &Span,
        places: &mut Places<'_>,
        course: &mut Course,
    ) -> Self::State {
        course.run(self, state, span, places)
    }
    /// Steps of its integrator that were tried since it was at rest; 0 if it has none.
    fn steps(&self, _state: &Self::State) -> u64 {
        0
    }
    /// A state as one that fits every plant.
    fn pack(state: &Self::State) -> AnyState;
    fn unpack(any: &AnyState) -> Self::State;
}

/// The state of any plant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AnyState {
    /// States of the chain; unused places are 0.
    z: [f64; STATES_MAX],
    regime: Regime,
    step_s: f64,
    steps: u64,
    hit: u64,
}

/// The exact step of a device over one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantStep {
    phi: [[f64; 2]; 2],
    /// Effect of a force that acts over the whole sample.
    gamma: [f64; 2],
    /// Effect of the force that acts until the split.
    before: [f64; 2],
    /// Effect of the force that acts from the split on.
    after: [f64; 2],
    /// What a hand's constant force adds in a sample.
    hand: [f64; 2],
    rest_position_m: f64,
}

/// The matrices of an exact step of N states, for those that step many handles at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LinearStep<const N: usize> {
    pub phi: [[f64; N]; N],
    /// Effect of a force that acts over the whole sample, until the split, and from it on.
    pub gamma: [f64; N],
    pub before: [f64; N],
    pub after: [f64; N],
    /// What a hand's constant force adds in a sample.
    pub hand: [f64; N],
    /// Where the bodies rest, m; the handle is the first of them.
    pub rest_m: [f64; 3],
}

impl<const N: usize> LinearStep<N> {
    pub fn at_rest(&self, position_m: f64) -> [f64; N] {
        augmented::still(&self.rest_m, position_m)
    }

    /// The same with more states, which stay 0 and add exactly nothing to the others.
    pub fn padded<const M: usize>(&self) -> LinearStep<M> {
        fn longer<T: Copy, const N: usize, const M: usize>(short: [T; N], rest: T) -> [T; M] {
            core::array::from_fn(|place| short.get(place).copied().unwrap_or(rest))
        }
        let Self { phi, gamma, before, after, hand, rest_m } = *self;
        LinearStep {
            phi: longer(phi.map(|row| longer(row, 0.0)), [0.0; M]),
            gamma: longer(gamma, 0.0),
            before: longer(before, 0.0),
            after: longer(after, 0.0),
            hand: longer(hand, 0.0),
            rest_m,
        }
    }
}

/// Position and speed of the handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantState {
    /// Distance from the rest position, m.
    offset_m: f64,
    speed_m_per_s: f64,
}

impl PlantStep {
    /// The step over `sample_s`, split at `fraction` (0 to below 1) of it.
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
            before: per_force(times(&late_phi, &early)),
            after: per_force(late),
            hand: [NOTHING; 2],
            rest_position_m: device.rest_position_m,
        }
    }

    /// The same with what a hand adds in a sample ([`Chain::hand_moves`](crate::scene::element::Chain::hand_moves)).
    pub fn with_hand(self, [x, v, ..]: [f64; STATES_MAX]) -> Self {
        Self { hand: [x, v], ..self }
    }

    pub(crate) fn linear(&self) -> LinearStep<2> {
        let Self { phi, gamma, before, after, hand, rest_position_m } = *self;
        LinearStep { phi, gamma, before, after, hand, rest_m: [rest_position_m; 3] }
    }

    #[inline]
    fn free(&self, state: &PlantState) -> PlantState {
        let PlantState { offset_m: x, speed_m_per_s: v } = *state;
        let [[xx, xv], [vx, vv]] = self.phi;
        PlantState { offset_m: xx * x + xv * v, speed_m_per_s: vx * x + vv * v }
    }
}

impl Plant for PlantStep {
    type State = PlantState;

    fn at_rest(&self, position_m: f64) -> PlantState {
        PlantState { offset_m: position_m - self.rest_position_m, speed_m_per_s: 0.0 }
    }

    #[inline]
    fn position_m(&self, state: &PlantState) -> f64 {
        state.offset_m + self.rest_position_m
    }

    #[inline]
    fn advance(&self, state: &PlantState, force_n: f64) -> PlantState {
        self.free(state).plus(&self.gamma, force_n, &self.hand)
    }

    #[inline]
    fn advance_split(&self, state: &PlantState, before_n: f64, after_n: f64) -> PlantState {
        let early = self.free(state).plus(&self.before, before_n, &[NOTHING; 2]);
        early.plus(&self.after, after_n, &self.hand)
    }

    #[inline]
    fn speed_m_per_s(&self, state: &PlantState) -> f64 {
        state.speed_m_per_s
    }

    fn pack(state: &PlantState) -> AnyState {
        let mut any = AnyState::default();
        (any.z[0], any.z[1]) = (state.offset_m, state.speed_m_per_s);
        any
    }

    fn unpack(any: &AnyState) -> PlantState {
        PlantState { offset_m: any.z[0], speed_m_per_s: any.z[1] }
    }
}

impl PlantState {
    #[inline]
    fn plus(self, effect: &[f64; 2], force_n: f64, hand: &[f64; 2]) -> Self {
        Self {
            offset_m: self.offset_m + (effect[0] * force_n + hand[0]),
            speed_m_per_s: self.speed_m_per_s + (effect[1] * force_n + hand[1]),
        }
    }

    pub fn speed_m_per_s(&self) -> f64 {
        self.speed_m_per_s
    }

    /// Distance from the rest position, m.
    pub fn offset_m(&self) -> f64 {
        self.offset_m
    }
}

fn times(matrix: &[[f64; 2]; 2], vector: &[f64; 2]) -> [f64; 2] {
    matrix.map(|row| row[0] * vector[0] + row[1] * vector[1])
}
