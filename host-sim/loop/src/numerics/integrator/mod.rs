//! One-step integrators for plants that are not linear, and for comparison with the exact step.
//!
//! | method | order | source |
//! |--------|-------|--------|
//! | [`euler`] semi-implicit | 1 | Hairer, Lubich, Wanner, "Geometric Numerical Integration", 2nd ed., I.1 (symplectic Euler) |
//! | [`rk4`] classical | 4 | Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", 2nd ed., II.1 |
//! | [`dormand_prince`] 5(4), adaptive | 5 | Dormand, Prince, J. Comp. Appl. Math. 6, 1980; step control: Hairer, Norsett, Wanner, II.4 |
//!
//! The methods need smooth rates. At an instant without smooth rates (sticking, stops), the plant starts a new step
//! ([`crate::plant::IntegratedStep`]).

pub mod dormand_prince;
pub mod euler;
pub mod rk4;
mod stability;

pub use stability::{Bodies, StepDemand};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::range::{refused, within};

/// `z' = f(z)` with a smooth f. The state is the same as in [`crate::scene::element::Chain`]: position and speed of
/// each body. If the number of states is odd, the last state is a force.
pub trait Field<const N: usize> {
    fn rate(&self, z: &[f64; N]) -> [f64; N];
}

/// The `[integrator]` table of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "method", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Integrator {
    /// Speeds are computed first, then positions from the new speeds. All steps are of equal length.
    SemiImplicitEuler {
        /// Number of steps in a sample. Fewer steps than stability needs are refused.
        steps_per_sample: u32,
    },
    /// Classical Runge-Kutta of order 4. All steps are of equal length.
    Rk4 {
        /// Number of steps in a sample. Fewer steps than stability needs are refused.
        steps_per_sample: u32,
    },
    /// Adaptive steps: the error of a step is kept below `relative |z| + absolute`.
    DormandPrince {
        /// Largest error of a step, as a fraction of the state.
        relative_tolerance: f64,
        /// Largest error of a position in a step. The limit for speeds is this length per sample. The limit for the
        /// amplifier's force is the force that moves the mass by this length in a sample.
        absolute_tolerance_m: f64,
    },
}

/// Largest number of equal steps in a sample.
pub const STEPS_MAX: u32 = 10_000;
/// Largest number of steps in a sample that [`Integrator::DormandPrince`] may need for stability.
const ADAPTIVE_STEPS_MAX: f64 = 1000.0;
/// Largest `|eigenvalue| step` for which a method is stable. The limit is valid for every eigenvalue in the left half
/// plane, because the half-disk of this radius is inside the method's stability region.
const RK4_STABLE: f64 = 2.5;
const DORMAND_PRINCE_STABLE: f64 = 3.0;

impl Integrator {
    /// One step of length h, without error control.
    #[inline]
    pub fn step<const N: usize>(&self, field: &impl Field<N>, z: &[f64; N], h: f64) -> [f64; N] {
        match self {
            Self::SemiImplicitEuler { .. } => euler::step(field, z, h),
            Self::Rk4 { .. } => rk4::step(field, z, h),
            Self::DormandPrince { .. } => dormand_prince::step(field, z, h).0,
        }
    }

    pub fn order(&self) -> u32 {
        match self {
            Self::SemiImplicitEuler { .. } => 1,
            Self::Rk4 { .. } => 4,
            Self::DormandPrince { .. } => 5,
        }
    }

    /// Checks the values, and that the method is stable on a plant with this `demand`.
    ///
    /// # Errors
    /// One line with key, value and allowed range. If the method would be unstable, the message says so.
    pub fn check(&self, demand: &StepDemand, sample_s: f64) -> Result<(), String> {
        let fastest_per_s = demand.fastest_per_s();
        let (steps, least) = match *self {
            Self::SemiImplicitEuler { steps_per_sample } => {
                (steps_per_sample, demand.euler_steps(sample_s))
            }
            Self::Rk4 { steps_per_sample } => {
                (steps_per_sample, (fastest_per_s * sample_s / RK4_STABLE).ceil().max(1.0))
            }
            Self::DormandPrince { relative_tolerance, absolute_tolerance_m } => {
                within("integrator.relative_tolerance", relative_tolerance, 1e-13..=1e-2)?;
                within("integrator.absolute_tolerance_m", absolute_tolerance_m, 1e-18..=1e-3)?;
                let needed = (fastest_per_s * sample_s / DORMAND_PRINCE_STABLE).ceil();
                if needed > ADAPTIVE_STEPS_MAX {
                    return Err(format!(
                        "integrator.method is dormand-prince, which needs {needed} steps per sample here, allowed \
                         {ADAPTIVE_STEPS_MAX}: the fastest time constant is {:.1e} s; without non-linear elements \
                         and [integrator] the step is exact",
                        1.0 / fastest_per_s
                    ));
                }
                return Ok(());
            }
        };
        let most = f64::from(STEPS_MAX);
        within("integrator.steps_per_sample", f64::from(steps), 1.0..=most)?;
        if f64::from(steps) >= least {
            return Ok(());
        }
        let reason = format!("the fastest time constant is {:.1e} s", 1.0 / fastest_per_s);
        if least > most {
            return Err(format!(
                "integrator.steps_per_sample would have to be {least}, allowed 1 to {most}: {reason}; without \
                 non-linear elements and [integrator] the step is exact"
            ));
        }
        let range = refused("integrator.steps_per_sample", f64::from(steps), &(least..=most));
        Err(format!("{range}: {reason}"))
    }
}

#[cfg(test)]
mod tests;
