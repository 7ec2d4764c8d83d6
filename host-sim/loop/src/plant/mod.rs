//! The device, advanced exactly: `m x'' + b x' + k (x - x0) = F`. F is constant, or changes once in a sample.
//!
//! The state s is `(x - x0, x')`. After a time t under a constant force F, the state is `phi(t) s + gamma(t) F`. A step
//! covers the sample time T. If the force changes from F1 to F2 at `fraction` of the sample, the next state is
//!
//! ```text
//! phi(T) s + before F1 + after F2
//! before = phi((1 - fraction) T) gamma(fraction T)
//! after  = gamma((1 - fraction) T)
//! ```
//!
//! A hand's constant force changes the state by the same amount in every sample.
//!
//! The only errors are rounding errors. If forces or lengths are scaled by a power of two, the results are scaled
//! exactly.

mod any;
mod course;
mod driven;
mod exact;
mod integrated;
pub mod quantiser;
mod sensed;

pub use any::each_plant;
pub use any::{AnyPlant, OtherPlant};
pub use course::{Course, Places, RUN, Span};
pub use driven::Driven;
pub use exact::{ExactStep, PlantStep};
pub use integrated::{HybridState, IntegratedStep, Regime};
pub use sensed::{Sensed, SensedState, Sensing};

use crate::scene::element::STATES_MAX;

/// A sample at which the encoder is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    pub index: u64,
    /// Command at the sample's beginning, in N.
    pub before_n: f64,
    /// Command from the sample's split on, in N.
    pub after_n: f64,
}

/// A device that the actuator's force moves, advanced one sample at a time.
pub trait Plant: Clone {
    type State: Copy + core::fmt::Debug;

    /// State of a handle at rest at `position_m`, before a force acts.
    fn at_rest(&self, position_m: f64) -> Self::State;
    /// Position of motor and encoder in m.
    fn position_m(&self, state: &Self::State) -> f64;
    /// Speed of motor and encoder in m/s.
    fn speed_m_per_s(&self, state: &Self::State) -> f64;
    /// The force of the actuator for the command `output_n`, in N. Force and command differ only by an amplifier's lag.
    #[inline]
    fn force_n(&self, _state: &Self::State, output_n: f64) -> f64 {
        output_n
    }
    /// The position that the encoder reads for a sample, in m, before quantisation. The reading differs from the true
    /// position if the encoder reads late or has errors.
    #[inline]
    fn reading_m(&self, state: &Self::State, _moment: &Moment) -> f64 {
        self.position_m(state)
    }
    /// The position after `delay_s` (shorter than a sample), in m. The two commands act before and after the split. A
    /// plant with an exact step returns `None`, because its step is for whole samples only.
    fn later_m(&self, _state: &Self::State, _delay_s: f64, _forces_n: [f64; 2]) -> Option<f64> {
        None
    }
    /// The state one sample later, if `force_n` is commanded for the whole sample.
    fn advance(&self, state: &Self::State, force_n: f64) -> Self::State;
    /// The state one sample later, if `before_n` is commanded until the split and `after_n` from the split on.
    fn advance_split(&self, state: &Self::State, before_n: f64, after_n: f64) -> Self::State;
    /// Moves the plant over the samples of a run. The encoder reads at each sample.
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
    /// Number of integration steps that were tried since the state at rest. It is 0 without an integrator.
    fn steps(&self, _state: &Self::State) -> u64 {
        0
    }
    /// Stores a state in the type that fits all plants.
    fn pack(state: &Self::State) -> AnyState;
    fn unpack(any: &AnyState) -> Self::State;
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AnyState {
    /// States of the chain. Unused entries are 0.
    z: [f64; STATES_MAX],
    regime: Regime,
    step_s: f64,
    steps: u64,
    hit: u64,
}
