//! Position to [`Velocity`]: the second stage, run for every sample.
//!
//! An [`Estimator`] holds what a person chose (integer coefficients); a [`State`] holds what the
//! samples left behind, so that an estimator can be retuned between two samples without a kick. One
//! of another kind starts from the velocity that the old one left and warms itself up.

mod biquad;
mod butterworth;
#[cfg(feature = "time-stamps")]
mod edge_timer;
#[cfg(any(feature = "taylor", feature = "least-squares"))]
mod fir;
#[cfg(feature = "foaw")]
mod foaw;
#[cfg(any(feature = "taylor", feature = "least-squares", feature = "foaw"))]
mod history;
#[cfg(feature = "kalman")]
mod kalman;
#[cfg(feature = "levant")]
mod levant;
mod name;
#[cfg(any(feature = "observer", feature = "fusion"))]
mod observer;
#[cfg(any(feature = "observer", feature = "fusion"))]
mod observer_design;
#[cfg(any(feature = "taylor", feature = "least-squares"))]
mod polynomial;
mod senses;
mod settings;
#[cfg(feature = "time-stamps")]
mod time_stamps;
#[cfg(feature = "tracking-loop")]
mod tracking;

pub use biquad::{Biquad, BiquadState, Shaping};
pub use butterworth::{
    ButterworthDesign, CUTOFF_MAX, CUTOFF_MIN, FirstOrder, PREWARPED_MAX, true_cutoff_hz,
};
#[cfg(feature = "time-stamps")]
pub use edge_timer::Captures;
#[cfg(feature = "time-stamps")]
pub use edge_timer::EdgeTimer;
#[cfg(any(feature = "taylor", feature = "least-squares"))]
pub use fir::Fir;
#[cfg(feature = "foaw")]
pub use foaw::Foaw;
#[cfg(any(feature = "taylor", feature = "least-squares", feature = "foaw"))]
pub use history::WINDOW_MAX;
#[cfg(feature = "kalman")]
pub use kalman::Kalman;
#[cfg(feature = "kalman")]
pub use kalman::KalmanDesign;
#[cfg(feature = "levant")]
pub use levant::Levant;
#[cfg(feature = "levant")]
pub use levant::LevantDesign;
pub use name::{EstimatorName, Parameter};
#[cfg(any(feature = "observer", feature = "fusion"))]
pub use observer::Observer;
#[cfg(any(feature = "observer", feature = "fusion"))]
pub use observer_design::MASS_KG;
#[cfg(any(feature = "observer", feature = "fusion"))]
pub use observer_design::OBSERVER_MAX;
#[cfg(any(feature = "observer", feature = "fusion"))]
pub use observer_design::OBSERVER_MIN;
#[cfg(any(feature = "observer", feature = "fusion"))]
pub use observer_design::ObserverDesign;
#[cfg(any(feature = "taylor", feature = "least-squares"))]
pub use polynomial::FirDesign;
pub use senses::{Edge, Sense, Senses};
pub use settings::VelocitySettings;
#[cfg(feature = "time-stamps")]
pub use time_stamps::SPAN_MAX;
#[cfg(feature = "time-stamps")]
pub use time_stamps::TimeStamps;
#[cfg(feature = "tracking-loop")]
pub use tracking::BANDWIDTH_MAX;
#[cfg(feature = "tracking-loop")]
pub use tracking::BANDWIDTH_MIN;
#[cfg(feature = "tracking-loop")]
pub use tracking::TrackingLoop;

#[cfg(any(
    feature = "taylor",
    feature = "least-squares",
    feature = "foaw",
    feature = "levant",
    feature = "kalman",
    feature = "observer",
    feature = "fusion",
    feature = "time-stamps"
))]
use core::hint::cold_path;

use crate::units::{Position, Velocity};

#[cfg_attr(
    any(feature = "taylor", feature = "least-squares"),
    expect(clippy::large_enum_variant, reason = "there is no allocator to box it with")
)]
/// A velocity estimator in integer form; made by [`VelocitySettings::build`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Estimator {
    /// Finite difference and low-pass.
    LowPass(Biquad),
    /// Finite difference.
    Difference,
    /// Weighted sum of the last differences.
    #[cfg(any(feature = "taylor", feature = "least-squares"))]
    Fir(Fir),
    /// Observer that knows the force.
    #[cfg(feature = "observer")]
    Observer(Observer),
    /// Observer that knows the acceleration.
    #[cfg(feature = "fusion")]
    Fusion(Observer),
    /// Counts between two edges over the time between them.
    #[cfg(feature = "time-stamps")]
    TimeStamps(TimeStamps),
    /// First-order adaptive windowing.
    #[cfg(feature = "foaw")]
    Foaw(Foaw),
    /// Levant's robust exact differentiator.
    #[cfg(feature = "levant")]
    Levant(Levant),
    /// Steady-state Kalman filter.
    #[cfg(feature = "kalman")]
    Kalman(Kalman),
}

impl Estimator {
    /// The velocity at this sample, in counts per sample.
    ///
    /// Estimators other than the usual ones are called, not inlined: their state then does not push
    /// that of the usual ones out of the registers.
    #[inline(always)] // called, it would put senses that nobody looks at into memory
    pub fn update(&self, state: &mut State, position: Position, senses: &Senses) -> Velocity {
        let _ = senses; // some builds have no estimator that looks at them
        if self.kind() != state.kind {
            self.take_over(state);
        }
        let difference = position.wrapping_since(state.previous);
        state.previous = position;
        let velocity = match self {
            Self::LowPass(filter) => {
                filter.update(&mut state.filter, Velocity::saturating_from_counts(difference))
            }
            Self::Difference => Velocity::saturating_from_counts(difference),
            #[cfg(any(feature = "taylor", feature = "least-squares"))]
            Self::Fir(fir) => {
                cold_path();
                fir.update(&mut state.history, difference)
            }
            #[cfg(feature = "foaw")]
            Self::Foaw(foaw) => {
                cold_path();
                foaw.update(&mut state.history, difference)
            }
            #[cfg(feature = "levant")]
            Self::Levant(levant) => {
                cold_path();
                levant.update(&mut state.levant, difference)
            }
            #[cfg(feature = "kalman")]
            Self::Kalman(kalman) => {
                cold_path();
                kalman.update(&mut state.kalman, difference)
            }
            #[cfg(any(feature = "observer", feature = "fusion", feature = "time-stamps"))]
            _ => {
                cold_path();
                self.sensed(&mut state.sensed, difference, senses)
            }
        };
        state.velocity = velocity;
        velocity
    }

    /// The velocity by those that look at more than the position.
    #[cfg(any(feature = "observer", feature = "fusion", feature = "time-stamps"))]
    #[inline(never)]
    fn sensed(&self, state: &mut Sensed, difference: i32, senses: &Senses) -> Velocity {
        match self {
            #[cfg(feature = "observer")]
            Self::Observer(observer) => {
                observer.after_force(&mut state.observer, difference, senses.force)
            }
            #[cfg(feature = "fusion")]
            Self::Fusion(observer) => {
                observer.after_acceleration(&mut state.observer, difference, senses.acceleration)
            }
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps(stamps) => {
                stamps.update(&mut state.time_stamps, difference, senses.edge)
            }
            _ => Velocity::ZERO,
        }
    }

    /// Which kind it is. The numbers follow the order of the variants, so that this is one load.
    #[inline]
    const fn kind(&self) -> u8 {
        match self {
            Self::LowPass(_) => 0,
            Self::Difference => 1,
            #[cfg(any(feature = "taylor", feature = "least-squares"))]
            Self::Fir(_) => 2,
            #[cfg(feature = "observer")]
            Self::Observer(_) => 3,
            #[cfg(feature = "fusion")]
            Self::Fusion(_) => 4,
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps(_) => 5,
            #[cfg(feature = "foaw")]
            Self::Foaw(_) => 6,
            #[cfg(feature = "levant")]
            Self::Levant(_) => 7,
            #[cfg(feature = "kalman")]
            Self::Kalman(_) => 8,
        }
    }

    /// Takes over from an estimator of another kind: warms up as if the handle had always moved at
    /// the velocity of the last sample.
    #[cold]
    #[inline(never)]
    fn take_over(&self, state: &mut State) {
        state.kind = self.kind();
        match self {
            Self::LowPass(_) => state.filter = BiquadState::at(state.velocity),
            Self::Difference => {}
            #[cfg(any(feature = "taylor", feature = "least-squares"))]
            Self::Fir(_) => state.history = history::History::at(state.velocity),
            #[cfg(feature = "foaw")]
            Self::Foaw(_) => state.history = history::History::at(state.velocity),
            #[cfg(feature = "levant")]
            Self::Levant(_) => state.levant = levant::LevantState::at(state.velocity),
            #[cfg(feature = "kalman")]
            Self::Kalman(_) => state.kalman = kalman::KalmanState::at(state.velocity),
            #[cfg(feature = "observer")]
            Self::Observer(_) => {
                state.sensed.observer = observer::ObserverState::at(state.velocity);
            }
            #[cfg(feature = "fusion")]
            Self::Fusion(_) => state.sensed.observer = observer::ObserverState::at(state.velocity),
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps(stamps) => {
                state.sensed.time_stamps =
                    time_stamps::TimeStampsState::at_velocity(state.velocity, stamps);
            }
        }
    }
}

/// No estimator's [`kind`](Estimator::kind).
const NO_KIND: u8 = u8::MAX;

/// What the samples so far left behind. A field for each kind of estimator, not one for all: so the
/// compiler can keep the few words of the usual one in registers.
#[derive(Clone, Copy, Debug)]
pub struct State {
    /// Kind of the estimator that has run.
    kind: u8,
    previous: Position,
    /// Of the last sample.
    velocity: Velocity,
    filter: BiquadState,
    #[cfg(any(feature = "taylor", feature = "least-squares", feature = "foaw"))]
    history: history::History,
    #[cfg(feature = "levant")]
    levant: levant::LevantState,
    #[cfg(feature = "kalman")]
    kalman: kalman::KalmanState,
    #[cfg(any(feature = "observer", feature = "fusion", feature = "time-stamps"))]
    sensed: Sensed,
}

/// State of the estimators that look at more than the position.
#[cfg(any(feature = "observer", feature = "fusion", feature = "time-stamps"))]
#[derive(Clone, Copy, Debug)]
struct Sensed {
    #[cfg(any(feature = "observer", feature = "fusion"))]
    observer: observer::ObserverState,
    #[cfg(feature = "time-stamps")]
    time_stamps: time_stamps::TimeStampsState,
}

impl State {
    /// Whatever comes next takes over from the velocity.
    pub fn restart(&mut self) {
        self.kind = NO_KIND;
    }

    /// At rest at `position`: it counts as the sample before the first one.
    pub fn at_rest(position: Position) -> Self {
        Self {
            kind: Estimator::Difference.kind(),
            previous: position,
            velocity: Velocity::ZERO,
            filter: BiquadState::default(),
            #[cfg(any(feature = "taylor", feature = "least-squares", feature = "foaw"))]
            history: history::History::REST,
            #[cfg(feature = "levant")]
            levant: levant::LevantState::default(),
            #[cfg(feature = "kalman")]
            kalman: kalman::KalmanState::REST,
            #[cfg(any(feature = "observer", feature = "fusion", feature = "time-stamps"))]
            sensed: Sensed {
                #[cfg(any(feature = "observer", feature = "fusion"))]
                observer: observer::ObserverState::default(),
                #[cfg(feature = "time-stamps")]
                time_stamps: time_stamps::TimeStampsState::REST,
            },
        }
    }

    /// The position of the last sample is called `position` from now on; the velocity stays.
    pub(crate) fn rebase(&mut self, position: Position) {
        self.previous = position;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Output, settings};

    const DESIGN: settings::Design = settings::Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Continuous,
    };

    /// What an estimator may miss of a constant speed of whole counts, LSB.
    fn chattering(name: EstimatorName) -> i32 {
        let settings = name.defaults();
        match settings {
            // twice its largest acceleration, and at C = 20 m/s^2 that is 0.2 counts per sample^2
            #[cfg(feature = "levant")]
            VelocitySettings::Levant { implicit: false, .. } => 2 * (65_536 / 5),
            _ => 0,
        }
    }

    /// Every estimator measures a constant speed, and one that takes over goes on at it.
    #[test]
    #[cfg_attr(miri, ignore = "225 pairs, 2200 samples each")]
    fn an_estimator_that_takes_over_goes_on_at_the_velocity_of_the_old_one() {
        for before in EstimatorName::ALL {
            for after in EstimatorName::ALL {
                let [old, new] =
                    [before, after].map(|name| name.defaults().build(&DESIGN).unwrap());
                let mut state = State::at_rest(Position::default());
                let mut count = 0;
                let mut step = |estimator: &Estimator, state: &mut State| {
                    count += 7;
                    estimator.update(state, Position::from_counts(count), &Senses::default())
                };
                let was = (0..2000).map(|_| step(&old, &mut state)).last().unwrap();
                for n in 0..200 {
                    let is = step(&new, &mut state);
                    let off = (is.bits() - was.bits()).abs();
                    let allowed = 2 + chattering(*before) + chattering(*after);
                    assert!(off <= allowed, "{before:?} to {after:?}: {off} LSB after {n} samples");
                }
            }
        }
    }

    /// docs/estimators.md states them.
    #[cfg(all(feature = "foaw", feature = "levant", feature = "kalman"))]
    #[test]
    fn states_and_coefficients_are_as_small_as_documented() {
        assert_eq!([size_of::<history::History>(), size_of::<Foaw>()], [130, 8]);
        assert_eq!([size_of::<levant::LevantState>(), size_of::<Levant>()], [16, 40]);
        assert_eq!([size_of::<kalman::KalmanState>(), size_of::<Kalman>()], [32, 24]);
    }

    #[test]
    fn the_first_sample_and_a_wrap_of_the_position_make_no_spike() {
        let settings = VelocitySettings::Butterworth { cutoff_hz: 4000.0, prewarp: false };
        let estimator = settings.build(&DESIGN).unwrap();
        let start = Position::from_counts(i32::MAX);
        let mut state = State::at_rest(start);
        assert_eq!(estimator.update(&mut state, start, &Senses::default()), Velocity::ZERO);
        let across =
            estimator.update(&mut state, Position::from_counts(i32::MIN), &Senses::default());
        assert!(across > Velocity::ZERO && across.bits() < 1 << Velocity::FRACTION_BITS);
    }
}
