//! Estimators that say where the handle is, too: the wall's spring then works on their position instead of the count.
//!
//! ```text
//! spring = K (count - surface + offset),   offset = estimated, or extrapolated, position - count
//! ```
//!
//! The estimator is the same and so is its velocity; the count alone says whether there is contact. A name of its own
//! for each, because another loop has another boundary and another row in the envelope.
//!
//! | of | offset at a sample |
//! |----|--------------------|
//! | Kalman filters | the corrected position less the count |
//! | observers | the same |
//! | first-order low-pass | what the difference extrapolates ([`Ahead`](super::Ahead)) |
//! | adaptive windowing, best fit ([`FoawPosition`](super::FoawPosition)) | the least-squares line of the window in use, at its newest sample |
//!
//! Windowing by the ends' line has none: that line passes through the count. Neither have sums of differences and
//! the other low-passes: they keep no position, and what their velocity extrapolates is a wall with more damping.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Form, Senses, VelocitySettings, called, kept::Bytes};
use crate::units::{Offset, Velocity};

/// What an estimator that estimates the position says of it.
pub(super) trait Places: Form {
    /// Estimated position less the count, after a sample.
    fn offset(&self, state: &Self::State) -> Offset;
}

/// An estimator on whose position the wall's spring works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed<F>(pub F);

impl<F: Places> Form for Placed<F> {
    type State = F::State;

    const REST: F::State = F::REST;

    fn at(&self, velocity: Velocity) -> F::State {
        self.0.at(velocity)
    }

    fn step(&self, state: &mut F::State, difference: i32, senses: &Senses) -> Velocity {
        called(&self.0, state, difference, senses)
    }

    fn put(&self, state: &F::State, bytes: &mut Bytes<'_>) {
        self.0.put(state, bytes);
    }

    fn take(&self, rest: &mut &[u8]) -> Option<F::State> {
        self.0.take(rest)
    }

    fn offset(&self, state: &F::State) -> Offset {
        Places::offset(&self.0, state)
    }
}

impl VelocitySettings {
    /// The same estimator with the spring on the count, if this one's works on its position.
    pub const fn unplaced(&self) -> Option<Self> {
        match *self {
            #[cfg(feature = "estimators")]
            Self::Kalman2Position { acceleration_rms_m_per_s2 } => {
                Some(Self::Kalman2 { acceleration_rms_m_per_s2 })
            }
            #[cfg(feature = "estimators")]
            Self::Kalman3Position { jerk_rms_m_per_s3 } => {
                Some(Self::Kalman3 { jerk_rms_m_per_s3 })
            }
            #[cfg(feature = "estimators")]
            Self::FoawBestPosition { window_samples, noise_counts } => {
                Some(Self::FoawBest { window_samples, noise_counts })
            }
            #[cfg(feature = "estimators")]
            Self::ObserverPosition { bandwidth_hz, mass_kg } => {
                Some(Self::Observer { bandwidth_hz, mass_kg })
            }
            #[cfg(feature = "estimators")]
            Self::FirstOrderPosition { cutoff_hz, .. } => Some(Self::FirstOrder { cutoff_hz }),
            #[cfg(feature = "estimators")]
            Self::FusionPosition { crossover_hz } => Some(Self::Fusion { crossover_hz }),
            _ => None,
        }
    }
}
