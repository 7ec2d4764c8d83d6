//! Estimators of the fixed-point core in lanes.

use zwidth::{VelocitySettings, velocity::Estimator};

use super::{fixed::FixedLoop, lanes::LaneController, simd_ops::SimdOps};

mod kalman;
mod low_pass;
mod word;

/// The estimators that have lanes, by their form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Difference, first-order and second-order low-passes.
    LowPass,
    /// Kalman filters.
    Kalman,
}

impl Form {
    /// `None` where there are no lanes.
    pub fn of(settings: &VelocitySettings) -> Option<Self> {
        match settings {
            VelocitySettings::Butterworth { .. }
            | VelocitySettings::ButterworthPrewarped { .. }
            | VelocitySettings::FirstOrder { .. }
            | VelocitySettings::FirstOrderPrewarped { .. }
            | VelocitySettings::Difference {} => Some(Self::LowPass),
            VelocitySettings::Kalman2 { .. } | VelocitySettings::Kalman3 { .. } => {
                Some(Self::Kalman)
            }
            _ => None,
        }
    }

    /// The core's loop with it in lanes.
    pub fn lanes<S: SimdOps, const R: usize>(self, simd: S) -> Box<dyn LaneController<S, R>> {
        match self {
            Self::LowPass => Box::new(FixedLoop::<S, low_pass::LowPass<S>, R>::new(simd)),
            Self::Kalman => Box::new(FixedLoop::<S, kalman::Kalman<S>, R>::new(simd)),
        }
    }
}

/// An estimator in the lanes of one vector.
pub trait VectorForm<S: SimdOps>: Copy {
    /// Coefficients.
    type Gains: Copy;

    /// Before the first sample, and coefficients of lanes that are not in use.
    fn at_rest(simd: S) -> (Self, Self::Gains);
    /// All that it remembers.
    fn words(&mut self) -> impl Iterator<Item = &mut S::u64s>;
    /// Puts the coefficients of an estimator into a lane.
    fn tune(gains: &mut Self::Gains, lane: usize, estimator: &Estimator);
    /// The velocity after a move by so many counts, LSB in the lower 32 bits.
    fn step(&mut self, simd: S, gains: &Self::Gains, moved: S::f64s) -> S::u64s;
    /// The hit came where these lanes do not do what the estimator does.
    fn is_lost(&self, gains: &Self::Gains, lane: usize) -> bool;
}
