//! Tracking loop and observer in `f64`, in textbook form. For the tracking loop the core has a low-pass with the same
//! response, for the observer an integer form.
//!
//! The state contains the position error `x - x^` in place of x^. So the twin keeps all digits at any count.

use zwidth::velocity::{ObserverDesign, TrackingLoop};

/// Largest state that is set to zero, because subnormal numbers would make the loop slow.
const FLUSH_BELOW: f64 = 1e-30;

/// The state: position error `x - x^`, velocity v^ and disturbance d^, in counts and samples. The tracking loop has no
/// d^.
#[derive(Clone, Copy, Debug, Default)]
pub struct Loop {
    error: f64,
    velocity: f64,
    disturbance: f64,
}

impl Loop {
    pub fn track(&mut self, gains: &TrackingLoop, difference: f64) -> f64 {
        let e = self.error + difference - self.velocity;
        self.error = flushed(e - gains.kp * e);
        let before = self.velocity;
        self.velocity = flushed(before + gains.ki * e);
        self.velocity + gains.lead * (self.velocity - before)
    }

    /// Updates the state with a sample. `known` is the known part of the acceleration, in counts per sample^2.
    pub fn observe(&mut self, design: &ObserverDesign, difference: f64, known: f64) -> f64 {
        let [l1, l2, l3] = design.gains;
        let acceleration = known + self.disturbance;
        let e = self.error + difference - self.velocity - 0.5 * acceleration;
        self.error = flushed(e - l1 * e);
        self.velocity = flushed(self.velocity + acceleration + l2 * e);
        self.disturbance = flushed(self.disturbance + l3 * e);
        self.velocity
    }
}

fn flushed(value: f64) -> f64 {
    if value.abs() < FLUSH_BELOW { 0.0 } else { value }
}
