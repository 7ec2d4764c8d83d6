//! The device, advanced exactly: `m x'' + b x' + k (x - x0) = F` with a force that is constant, or
//! steps once, within a sample.
//!
//! The state is `(x - x0, x')`; a step is `s' = phi s + before F1 + after F2`, where F1 acts until
//! `fraction` of the sample has passed and F2 from there on: `after = gamma((1 - fraction) T)`,
//! `before = phi((1 - fraction) T) gamma(fraction T)`. Nothing is approximated but by rounding.
//! Forces or lengths scaled by a power of two give a run that is bit-identical up to that scale.

use crate::{exact::oscillator_step, scene::Device};

/// The exact step of a device over one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantStep {
    phi: [[f64; 2]; 2],
    /// Effect of the force that acts until the split; `None` if the sample is not split.
    before: Option<[f64; 2]>,
    /// Effect of the force that acts from the split on.
    after: [f64; 2],
    rest_position_m: f64,
}

/// Position and speed of the handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantState {
    /// Distance from the rest position, m.
    offset_m: f64,
    /// Speed, m/s.
    speed_m_per_s: f64,
}

impl PlantStep {
    /// The step over `sample_s`, split at `fraction` (0 to below 1) of it.
    pub fn new(device: &Device, sample_s: f64, fraction: f64) -> Self {
        let stiffness = device.stiffness_n_per_m / device.mass_kg;
        let damping = device.damping_n_s_per_m / device.mass_kg;
        let mobility = 1.0 / device.mass_kg;
        let per_force = |gamma: [f64; 2]| gamma.map(|g| g * mobility);
        let (phi, whole) = oscillator_step(stiffness, damping, sample_s);
        let (before, after) = if fraction > 0.0 {
            let (late_phi, late) = oscillator_step(stiffness, damping, (1.0 - fraction) * sample_s);
            let (_, early) = oscillator_step(stiffness, damping, fraction * sample_s);
            (Some(per_force(times(&late_phi, &early))), per_force(late))
        } else {
            (None, per_force(whole))
        };
        Self {
            phi,
            before,
            after,
            rest_position_m: device.rest_position_m,
        }
    }

    /// The state of a handle at rest at `position_m`.
    pub fn at_rest(&self, position_m: f64) -> PlantState {
        PlantState {
            offset_m: position_m - self.rest_position_m,
            speed_m_per_s: 0.0,
        }
    }

    /// Position, m.
    #[inline]
    pub fn position_m(&self, state: &PlantState) -> f64 {
        state.offset_m + self.rest_position_m
    }

    /// The state one sample later, with `before_n` acting until the split and `after_n` from it on.
    #[inline]
    pub fn advance(&self, state: &PlantState, before_n: f64, after_n: f64) -> PlantState {
        let PlantState {
            offset_m: x,
            speed_m_per_s: v,
        } = *state;
        let [[xx, xv], [vx, vv]] = self.phi;
        let mut offset_m = xx * x + xv * v + self.after[0] * after_n;
        let mut speed_m_per_s = vx * x + vv * v + self.after[1] * after_n;
        if let Some(before) = self.before {
            offset_m += before[0] * before_n;
            speed_m_per_s += before[1] * before_n;
        }
        PlantState {
            offset_m,
            speed_m_per_s,
        }
    }
}

impl PlantState {
    /// Speed, m/s.
    pub fn speed_m_per_s(&self) -> f64 {
        self.speed_m_per_s
    }

    /// Distance from the rest position, m.
    pub fn offset_m(&self) -> f64 {
        self.offset_m
    }
}

fn times(matrix: &[[f64; 2]; 2], vector: &[f64; 2]) -> [f64; 2] {
    matrix.map(|row| row[0] * vector[0] + row[1] * vector[1])
}
