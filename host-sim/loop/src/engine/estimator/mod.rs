//! Estimators of the fixed-point core in lanes.

use zwidth::velocity::{Estimator, EstimatorName};

use super::{
    lanes::Row,
    simd_ops::{SimdOps, lanes, lanes_mut},
};
use crate::simulation::accelerometer::Readings;

mod accelerometer;
pub(super) mod kalman;
pub(super) mod levant;
pub(super) mod low_pass;
pub(super) mod mean;
pub(super) mod observer;
pub(super) mod window;
mod word;

/// Forms of the estimators that can run in lanes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Difference, first-order and second-order low-passes.
    LowPass,
    /// Estimators that are low-passes in fixed point, but not in `f64`.
    LikeLowPass,
    /// Two low-passes in a row.
    Cascade,
    Kalman,
    /// Weighted sums of the last differences.
    Fir,
    /// Change of the count over a number of samples, divided by this number.
    Mean,
    /// First-order adaptive windowing, with the slope between the ends of the window.
    FoawEnd,
    /// First-order adaptive windowing, with the least-squares slope in the window.
    FoawBest,
    LevantExplicit,
    LevantImplicit,
    /// Observer that gets the force.
    Observer,
    /// Observer that gets the acceleration.
    Fusion,
}

impl Form {
    /// Form of an estimator. `None` if the estimator cannot run in lanes.
    pub fn of(estimator: EstimatorName) -> Option<Self> {
        match estimator {
            EstimatorName::Butterworth
            | EstimatorName::ButterworthPrewarped
            | EstimatorName::FirstOrder
            | EstimatorName::FirstOrderPrewarped
            | EstimatorName::Difference
            | EstimatorName::Biquad => Some(Self::LowPass),
            EstimatorName::Kalman2 | EstimatorName::Kalman3 => Some(Self::Kalman),
            EstimatorName::TrackingLoop
            | EstimatorName::TrackingLead
            | EstimatorName::Smoothing
            | EstimatorName::SecondOrder => Some(Self::LikeLowPass),
            EstimatorName::WindowDifference => Some(Self::Mean),
            EstimatorName::Biquad2 => Some(Self::Cascade),
            EstimatorName::Taylor2
            | EstimatorName::Taylor3
            | EstimatorName::LeastSquares1
            | EstimatorName::LeastSquares2 => Some(Self::Fir),
            EstimatorName::FoawEnd => Some(Self::FoawEnd),
            EstimatorName::FoawBest => Some(Self::FoawBest),
            EstimatorName::LevantExplicit => Some(Self::LevantExplicit),
            EstimatorName::LevantImplicit => Some(Self::LevantImplicit),
            EstimatorName::Observer => Some(Self::Observer),
            EstimatorName::Fusion => Some(Self::Fusion),
            _ => None,
        }
    }
}

/// The inputs that an estimator gets in addition to the counts. All hits of a scene have the same inputs.
#[derive(Clone, Copy)]
pub struct Beside<'a> {
    /// Number of samples between the grant of a force and the sample at which the estimator gets this force.
    pub late: usize,
    pub readings: Option<&'a Readings>,
}

/// An estimator in the lanes of one vector.
pub trait VectorForm<S: SimdOps>: Sized {
    type Gains: Copy;

    /// State before the first sample, and coefficients for unused lanes.
    fn at_rest(simd: S) -> (Self, Self::Gains);
    fn start(
        &mut self,
        simd: S,
        gains: &mut Self::Gains,
        lane: usize,
        estimator: &Estimator,
        beside: Beside<'_>,
    );
    /// Whether the estimator uses the handle's speed, as an accelerometer does.
    const LOOKS: bool = false;
    /// Takes the handle's speeds at the next samples, in m/s.
    #[inline(always)]
    fn look<const R: usize>(_: &mut [Self; R], _: S, _: &[Row<S, R>]) {}
    /// Updates the estimators. `moved` is the change of the count per sample. If an output is `due`, `velocity` becomes
    /// the velocity at the last sample. This velocity is in LSB, in the lower 32 bits. If no output is due, `velocity`
    /// is undefined.
    fn take<const R: usize>(
        forms: &mut [Self; R],
        simd: S,
        gains: &[Self::Gains; R],
        moved: &[Row<S, R>],
        due: bool,
        velocity: &mut [S::u64s; R],
    );
    /// Takes the forces that were granted with the last sample, in LSB.
    #[inline(always)]
    fn granted(&mut self, _: S, _: &Self::Gains, _: S::u64s) {}
    /// Whether the hit has left the range in which lane and estimator compute the same values.
    fn is_lost(&self, gains: &Self::Gains, lane: usize) -> bool;
}

/// An estimator with feedback, which must be updated with every sample.
pub trait Recursive<S: SimdOps>: Copy {
    type Gains: Copy;

    fn at_rest(simd: S) -> (Self, Self::Gains);
    fn words(&mut self) -> impl Iterator<Item = &mut S::u64s>;
    fn tune(gains: &mut Self::Gains, lane: usize, estimator: &Estimator);
    /// Takes the change of the count. Returns the velocity in LSB, in the lower 32 bits.
    fn step(&mut self, simd: S, gains: &Self::Gains, moved: S::f64s) -> S::u64s;
    fn is_lost(&self, gains: &Self::Gains, lane: usize) -> bool;
}

pub struct Each<F>(F);

impl<S: SimdOps, F: Recursive<S>> VectorForm<S> for Each<F> {
    type Gains = F::Gains;

    fn at_rest(simd: S) -> (Self, F::Gains) {
        let (rest, gains) = F::at_rest(simd);
        (Self(rest), gains)
    }

    fn start(
        &mut self,
        simd: S,
        gains: &mut F::Gains,
        lane: usize,
        estimator: &Estimator,
        _: Beside<'_>,
    ) {
        F::tune(gains, lane, estimator);
        let (mut rest, _) = F::at_rest(simd);
        for (word, rest) in self.0.words().zip(rest.words()) {
            lanes_mut::<_, u64>(word)[lane] = lanes(rest)[lane];
        }
    }

    #[inline(always)]
    fn take<const R: usize>(
        forms: &mut [Self; R],
        simd: S,
        gains: &[F::Gains; R],
        moved: &[Row<S, R>],
        _: bool,
        velocity: &mut [S::u64s; R],
    ) {
        let mut now = [forms[0].0; R];
        for r in 0..R {
            now[r] = forms[r].0;
        }
        let mut last = *velocity;
        for row in moved {
            for r in 0..R {
                last[r] = now[r].step(simd, &gains[r], row.0[r]);
            }
        }
        for r in 0..R {
            forms[r].0 = now[r];
        }
        *velocity = last;
    }

    fn is_lost(&self, gains: &F::Gains, lane: usize) -> bool {
        self.0.is_lost(gains, lane)
    }
}
