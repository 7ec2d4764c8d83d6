//! Levant's differentiator. The equations are in the core's `velocity/levant.rs`.

use zwidth::velocity::LevantDesign;

/// The parameters of the differentiator. The units are counts and samples.
#[derive(Clone, Copy, Debug)]
pub struct Levant {
    pub implicit: bool,
    pub sizes: LevantDesign,
}

/// The predicted position at the next sample minus the count, and the differentiator's state u1.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LevantState {
    ahead: f64,
    velocity: f64,
}

impl Levant {
    /// The velocity after a change of the count by `input`.
    #[inline(never)] // so that the other estimators' state stays in registers
    pub(super) fn update(&self, state: &mut LevantState, input: f64) -> f64 {
        let LevantDesign { alpha, lambda } = self.sizes;
        let b = state.ahead - input;
        let sign = if b == 0.0 { 0.0 } else { b.signum() };
        if !self.implicit {
            let u = state.velocity - lambda * b.abs().sqrt() * sign;
            state.velocity -= alpha * sign;
            state.ahead = b + u;
            return u;
        }
        let mut e = 0.0;
        if b.abs() <= alpha {
            state.velocity -= b;
        } else {
            let root = (lambda * lambda / 4.0 + b.abs() - alpha).sqrt() - lambda / 2.0;
            e = root * root * sign;
            state.velocity -= alpha * sign;
        }
        state.ahead = e + state.velocity;
        state.velocity
    }
}
