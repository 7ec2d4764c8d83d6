//! Position to [`Velocity`]: the second stage, run for every sample.
//!
//! An [`Estimator`] holds what a person chose (integer coefficients); a [`State`] holds what the
//! samples left behind, so that an estimator can be exchanged between two samples without a kick.

mod biquad;
mod butterworth;

pub use biquad::{Biquad, BiquadState};
pub use butterworth::{CUTOFF_MAX, CUTOFF_MIN, Design, PREWARPED_MAX, true_cutoff_hz};

use crate::{
    settings::SettingsError,
    units::{Position, Velocity},
};

/// Which estimator, and its parameters in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VelocitySettings {
    /// Finite difference followed by a second-order Butterworth low-pass; the paper's estimator.
    Butterworth {
        /// Cutoff in Hz, as it stands in the paper's equation (2).
        cutoff_hz: f64,
        /// Pre-warp, so that the -3 dB frequency of the digital filter is the cutoff itself.
        prewarp: bool,
    },
}

impl VelocitySettings {
    /// The estimator's integer form at `rate_hz` samples per second.
    ///
    /// # Errors
    /// Names the parameter that is out of range, and the range.
    pub fn build(&self, rate_hz: f64) -> Result<Estimator, SettingsError> {
        match *self {
            Self::Butterworth { cutoff_hz, prewarp } => {
                let design = Design::new(cutoff_hz, rate_hz, prewarp)?;
                Ok(Estimator::Butterworth(design.quantise()))
            }
        }
    }
}

/// A velocity estimator in integer form; made by [`VelocitySettings::build`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Estimator {
    /// Finite difference and low-pass.
    Butterworth(Biquad),
}

impl Estimator {
    /// The velocity at this sample, in counts per sample.
    #[inline]
    pub fn update(&self, state: &mut State, position: Position) -> Velocity {
        let difference = position.wrapping_since(state.previous);
        state.previous = position;
        match self {
            Self::Butterworth(filter) => {
                filter.update(&mut state.filter, Velocity::saturating_from_counts(difference))
            }
        }
    }
}

/// What the samples so far left behind.
#[derive(Clone, Copy, Debug)]
pub struct State {
    previous: Position,
    filter: BiquadState,
}

impl State {
    /// At rest at `position`: it counts as the sample before the first one.
    pub fn at_rest(position: Position) -> Self {
        Self { previous: position, filter: BiquadState::default() }
    }

    /// The position of the last sample is called `position` from now on; the velocity stays.
    pub(crate) fn rebase(&mut self, position: Position) {
        self.previous = position;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_sample_and_a_wrap_of_the_position_make_no_spike() {
        let settings = VelocitySettings::Butterworth { cutoff_hz: 4000.0, prewarp: false };
        let estimator = settings.build(10_000.0).unwrap();
        let start = Position::from_counts(i32::MAX);
        let mut state = State::at_rest(start);
        assert_eq!(estimator.update(&mut state, start), Velocity::ZERO);
        let across = estimator.update(&mut state, Position::from_counts(i32::MIN));
        assert!(across > Velocity::ZERO && across.bits() < 1 << Velocity::FRACTION_BITS);
    }
}
