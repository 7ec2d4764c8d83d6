//! The controller's twin in `f64`. The twin has the equations of the core, but does not quantise coefficients,
//! velocities, gains or forces. A difference between twin and core is the effect of fixed point.

mod equation;
mod estimator;
mod foaw;
mod kalman;
mod levant;
mod loops;
mod stamps;

pub use equation::{Equation, LowPass};
pub(crate) use estimator::Section;
pub use estimator::TwinEstimator;
pub use foaw::Foaw;
pub use levant::Levant;
use zwidth::{
    Design, Output, Settings, SettingsError,
    velocity::{Senses, WINDOW_MAX},
};

use crate::simulation::controller::{Controller, ControllerOutput};

/// Largest filter state that is set to zero. Subnormal numbers would make the loop seven times slower.
pub(crate) const FLUSH_BELOW: f64 = 1e-30;

/// Largest number of differences in an estimator's state.
const LENGTH: usize = WINDOW_MAX as usize;

/// Whether the twin rounds its velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rounding {
    /// The twin only rounds as `f64` does.
    Exact,
    /// The output of the filter is rounded to the LSB of fixed point, 2^-16 counts per sample. The state of the filter
    /// is not rounded. A fixed-point filter with this output format changes the velocity at least as much.
    VelocityLsb,
}

#[derive(Clone, Copy, Debug)]
pub struct Twin {
    estimator: TwinEstimator,
    rounding: Rounding,
    velocity: f64,
    count: i32,
    surface: i32,
    /// Force per depth, as a fraction of full scale per count.
    stiffness: f64,
    /// Force per speed, as a fraction of full scale per count per sample.
    damping: f64,
    push_only: bool,
    push: f64,
    codes_per_full_scale: Option<f64>,
    period: u32,
    until_due: u32,
}

/// If this number is added to a value and then subtracted, the value is rounded to a multiple of 2^-16 (ties to even).
pub(crate) const ROUND_TO_LSB: f64 = 1.5 * (1u64 << 36) as f64;

impl Twin {
    /// The twin of a core that has these settings and is at rest at `count`. `push` is a fraction of full scale.
    pub fn new(
        settings: &Settings,
        design: &Design,
        rounding: Rounding,
        push: f64,
        count: i32,
    ) -> Result<Self, SettingsError> {
        let control = settings.build(design)?; // checks the ranges, and gives the position of the surface in counts
        let wall = &settings.wall;
        let per_count = design.resolution_m / design.full_scale_n;
        Ok(Self {
            estimator: TwinEstimator::new(&settings.velocity, design)?,
            rounding,
            velocity: 0.0,
            count,
            surface: control.wall.surface().counts(),
            stiffness: wall.stiffness_n_per_m * per_count,
            damping: wall.damping_n_s_per_m * per_count * design.rate_hz,
            push_only: wall.push_only,
            push,
            codes_per_full_scale: match design.output {
                Output::Continuous => None,
                Output::Dac { .. } | Output::Pwm { .. } => {
                    Some(f64::from(control.actuator.codes_per_full_scale()))
                }
            },
            period: design.period,
            until_due: 0,
        })
    }
}

impl Twin {
    /// The estimator as a [`Section`], the form of the common estimators. `None` for all other estimators.
    pub(crate) fn low_pass(&self) -> Option<Section> {
        self.estimator.low_pass()
    }

    /// Stiffness and damping. They are fractions of full scale per count, and per count per sample.
    pub(crate) fn wall_gains(&self) -> [f64; 2] {
        [self.stiffness, self.damping]
    }
}

impl Controller for Twin {
    #[inline(always)] // a call would move the state of the loop from registers to memory
    fn sample(&mut self, count: i32, senses: &Senses) -> bool {
        let difference = count.wrapping_sub(self.count);
        self.count = count;
        let output = self.estimator.update(difference, senses);
        self.velocity = match self.rounding {
            Rounding::Exact => output,
            Rounding::VelocityLsb => (output + ROUND_TO_LSB) - ROUND_TO_LSB,
        };
        let due = self.until_due == 0;
        self.until_due = if due { self.period - 1 } else { self.until_due - 1 };
        due
    }

    #[inline(always)] // a call would move the state of the loop from registers to memory
    fn render(&mut self) -> ControllerOutput {
        let penetration = i64::from(self.count) - i64::from(self.surface);
        let mut wall = 0.0;
        if penetration > 0 {
            #[expect(clippy::cast_precision_loss, reason = "below 2^33")]
            let depth = penetration as f64;
            wall = self.stiffness * depth + self.damping * self.velocity;
            if self.push_only {
                wall = wall.max(0.0);
            }
        }
        let wanted = self.push - wall;
        let force = wanted.clamp(-1.0, 1.0);
        let output = self.put_out(force);
        let (saturated, push) = (force != wanted, self.push);
        ControllerOutput { force, output, saturated, withheld: 0.0, push }
    }

    #[inline]
    fn velocity(&self) -> f64 {
        self.velocity
    }

    fn surface(&self) -> i32 {
        self.surface
    }

    fn push(&self) -> f64 {
        self.push
    }

    fn set_push(&mut self, push: f64) {
        self.push = push;
    }

    #[inline]
    fn put_out(&self, force: f64) -> f64 {
        match self.codes_per_full_scale {
            None => force,
            Some(codes) => (force.abs() * codes + 0.5).floor().copysign(force) / codes,
        }
    }
}
