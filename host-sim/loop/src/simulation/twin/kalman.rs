//! The steady-state Kalman filter. The equations are in the core's `velocity/kalman.rs`.

use zwidth::velocity::KalmanDesign;

/// Estimated position minus count, estimated velocity and estimated acceleration. The units are counts and samples.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct KalmanState {
    distance: f64,
    velocity: f64,
    acceleration: f64,
}

impl KalmanState {
    /// The velocity after a change of the count by `input`.
    #[inline(never)] // so that the other estimators' state stays in registers
    pub(super) fn update(&mut self, gains: &KalmanDesign, input: f64) -> f64 {
        let predicted = self.distance + self.velocity + self.acceleration / 2.0 - input;
        self.distance = predicted * (1.0 - gains.alpha);
        self.velocity += self.acceleration - gains.beta * predicted;
        self.acceleration -= gains.gamma * predicted;
        // subnormal numbers would slow the loop down
        if predicted.abs() + self.velocity.abs() + self.acceleration.abs() < super::FLUSH_BELOW {
            *self = Self::default();
        }
        self.velocity
    }
}
