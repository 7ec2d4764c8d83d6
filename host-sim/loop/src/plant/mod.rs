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
mod course;
mod exact;
mod integrated;
pub mod quantiser;
mod sensed;

pub use any::each_plant;
pub use any::{AnyPlant, OtherPlant};
pub use course::{Course, Places, RUN, Span};
pub use exact::{ExactStep, PlantStep};
pub use integrated::{HybridState, IntegratedStep, Regime};
pub use sensed::{Sensed, SensedState, Sensing};

use crate::scene::element::STATES_MAX;

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
