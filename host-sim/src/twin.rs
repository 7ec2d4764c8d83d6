//! The controller's twin in `f64`: the same maths without quantised coefficients, velocities,
//! gains or forces. What differs between it and the core is what fixed point costs.

use zwidth::{Design, Output, Settings, SettingsError, VelocitySettings, velocity};

use crate::controller::{Controller, Rendered};

/// Whether the twin rounds its velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rounding {
    /// Exact to `f64`.
    Exact,
    /// The velocity that leaves the filter is rounded to the fixed-point LSB, 2^-16 counts per
    /// sample; the filter's own state is not. The least that any fixed-point form of that format
    /// changes.
    VelocityLsb,
}

/// The controller in `f64`.
#[derive(Clone, Copy, Debug)]
pub struct Twin {
    filter: velocity::Design,
    rounding: Rounding,
    inputs: [f64; 2],
    outputs: [f64; 2],
    velocity: f64,
    count: i32,
    surface: i32,
    /// Fraction of full scale per count.
    stiffness: f64,
    /// Fraction of full scale per count per sample.
    damping: f64,
    push_only: bool,
    push: f64,
    codes_per_full_scale: Option<f64>,
    period: u32,
    until_due: u32,
}

/// Adding and subtracting this rounds to a multiple of 2^-16 (to even in ties).
const ROUND_TO_LSB: f64 = 1.5 * (1u64 << 36) as f64;
/// Below this a filter state is zero: subnormal numbers would slow the loop down seven times.
const FLUSH_BELOW: f64 = 1e-30;

impl Twin {
    /// The twin of the core with those settings, at rest at `count`; `push` is a fraction of full
    /// scale.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn new(
        settings: &Settings,
        design: &Design,
        rounding: Rounding,
        push: f64,
        count: i32,
    ) -> Result<Self, SettingsError> {
        let control = settings.build(design)?; // the ranges, and the surface in counts
        let VelocitySettings::Butterworth { cutoff_hz, prewarp } = settings.velocity;
        let wall = &settings.wall;
        let per_count = design.resolution_m / design.full_scale_n;
        Ok(Self {
            filter: velocity::Design::new(cutoff_hz, design.rate_hz, prewarp)?,
            rounding,
            inputs: [0.0; 2],
            outputs: [0.0; 2],
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

impl Controller for Twin {
    #[inline]
    fn sample(&mut self, count: i32) -> bool {
        let input = f64::from(count.wrapping_sub(self.count));
        self.count = count;
        let velocity::Design { b0, a1, a2, .. } = self.filter;
        let [x1, x2] = self.inputs;
        let [y1, y2] = self.outputs;
        let raw = b0 * (input + 2.0 * x1 + x2) - a1 * y1 - a2 * y2;
        let output = if raw.abs() < FLUSH_BELOW { 0.0 } else { raw };
        self.inputs = [input, x1];
        self.outputs = [output, y1];
        self.velocity = match self.rounding {
            Rounding::Exact => output,
            Rounding::VelocityLsb => (output + ROUND_TO_LSB) - ROUND_TO_LSB,
        };
        let due = self.until_due == 0;
        self.until_due = if due { self.period - 1 } else { self.until_due - 1 };
        due
    }

    #[inline(always)] // called, it would keep the state of the loop in memory
    fn render(&mut self) -> Rendered {
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
        let output = match self.codes_per_full_scale {
            None => force,
            Some(codes) => (force * codes + 0.5).floor() / codes,
        };
        Rendered { force, output, saturated: force != wanted }
    }

    #[inline]
    fn velocity(&self) -> f64 {
        self.velocity
    }

    fn surface(&self) -> i32 {
        self.surface
    }
}
