//! What a person sets, in SI units, and its way into integers.
//!
//! Three forms, three types: [`Settings`] (floats, for people), [`LoopParameters`] (integers, immutable),
//! state (what samples change). [`Settings::build`] is the only place that refuses; a refused
//! change leaves the old [`LoopParameters`] running.

use core::{fmt, num::NonZeroU32, ops::RangeInclusive};

use crate::{
    Gain, LoopParameters, Output, VelocitySettings,
    actuator::Actuator,
    experiment::{HitPlan, RmsLimit},
    units::{Force, Position, Velocity},
    wall::Wall,
};

/// Accepted ranges, SI units. The simulator checks its scenes against the same ones.
pub mod limits {
    use core::ops::RangeInclusive;

    /// Sample rate, Hz.
    pub const RATE_HZ: RangeInclusive<f64> = 1e3..=5e4;
    /// Encoder resolution, m per count.
    pub const RESOLUTION_M: RangeInclusive<f64> = 1e-8..=1e-3;
    /// Force at full command, N.
    pub const FULL_SCALE_N: RangeInclusive<f64> = 1e-3..=1e5;
    /// Samples per output.
    pub const PERIOD: RangeInclusive<u32> = 1..=1000;
    /// Wall stiffness K, N/m.
    pub const STIFFNESS_N_PER_M: RangeInclusive<f64> = 0.0..=1e7;
    /// Wall damping B, N s/m.
    pub const DAMPING_N_S_PER_M: RangeInclusive<f64> = 0.0..=1e4;
    /// Samples to settle before a hit is judged, and samples that are judged.
    pub const PHASE_SAMPLES: RangeInclusive<u32> = 1..=1 << 24;
    /// RMS limit of a hit, in counts.
    pub const RMS_COUNTS: RangeInclusive<f64> = 1e-3..=65_535.0;
}

/// What is built and does not change while running.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Design {
    /// Encoder samples per second, Hz.
    pub rate_hz: f64,
    /// Encoder resolution, m per count.
    pub resolution_m: f64,
    /// Force at full command, N.
    pub full_scale_n: f64,
    /// Samples per output: 10 for 10 kHz in, 1 kHz out.
    pub period: u32,
    /// How the hardware takes its command.
    pub output: Output,
}

/// What is tuned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The velocity estimator.
    pub velocity: VelocitySettings,
    /// The wall.
    pub wall: WallSettings,
}

/// The wall in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallSettings {
    /// Surface, m; the encoder's count 0 is at 0 m. Rounded to the nearest count.
    pub position_m: f64,
    /// Stiffness K, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping B, N s/m, at work inside the wall only.
    pub damping_n_s_per_m: f64,
    /// The wall never pulls.
    pub push_only: bool,
}

/// The wall-hit experiment in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitSettings {
    /// Constant push, N.
    pub push_n: f64,
    /// Time before the hit is judged, s.
    pub settle_s: f64,
    /// Time over which it is judged, s.
    pub window_s: f64,
    /// `stable` is an RMS below this, m.
    pub rms_limit_m: f64,
}

/// A parameter that is out of range.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingsError {
    /// Its name, as in [`Settings`], [`Design`] or [`HitSettings`].
    pub parameter: &'static str,
    /// What was asked for.
    pub value: f64,
    /// What is allowed.
    pub range: RangeInclusive<f64>,
}

impl fmt::Display for SettingsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (low, high) = (shorten(*self.range.start()), shorten(*self.range.end()));
        write!(f, "{} is {}, allowed {low} to {high}", self.parameter, self.value)
    }
}

/// `value` to nine digits, so that a product like 3.5e-5 * 1000 prints as 0.035.
pub fn shorten(value: f64) -> f64 {
    const DIGITS: f64 = 9.0;
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let exponent = DIGITS - 1.0 - libm::floor(libm::log10(libm::fabs(value)));
    if exponent >= 0.0 {
        let scale = libm::exp10(exponent);
        libm::round(value * scale) / scale
    } else {
        let scale = libm::exp10(-exponent);
        libm::round(value / scale) * scale
    }
}

impl core::error::Error for SettingsError {}

/// `value` if it lies in `range`; NaN lies in none.
///
/// # Errors
/// Names the parameter and the range.
pub fn within(
    parameter: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
) -> Result<f64, SettingsError> {
    if range.contains(&value) { Ok(value) } else { Err(SettingsError { parameter, value, range }) }
}

impl Design {
    /// Checks every field.
    ///
    /// # Errors
    /// Names the parameter that is out of range, and the range.
    pub fn check(&self) -> Result<(), SettingsError> {
        within("rate_hz", self.rate_hz, limits::RATE_HZ)?;
        within("resolution_m", self.resolution_m, limits::RESOLUTION_M)?;
        within("full_scale_n", self.full_scale_n, limits::FULL_SCALE_N)?;
        within("period", f64::from(self.period), widen(&limits::PERIOD))?;
        Actuator::new(self.output)?;
        Ok(())
    }

    /// `metres` in counts, rounded to the nearest, within the range of [`Position`].
    ///
    /// # Errors
    /// The position is beyond 2^30 counts.
    pub(crate) fn position(
        &self,
        parameter: &'static str,
        metres: f64,
    ) -> Result<Position, SettingsError> {
        let reach = f64::from(Position::LIMIT) * self.resolution_m;
        within(parameter, metres, -reach..=reach)?;
        #[expect(clippy::cast_possible_truncation, reason = "at most 2^30 by the check above")]
        Ok(Position::from_counts(libm::round(metres / self.resolution_m) as i32))
    }

    /// `newtons` as a fraction of full scale, within +-1.
    fn force(&self, parameter: &'static str, newtons: f64) -> Result<Force, SettingsError> {
        within(parameter, newtons, -self.full_scale_n..=self.full_scale_n)?;
        let full = f64::from(Force::FULL_SCALE.bits());
        #[expect(clippy::cast_possible_truncation, reason = "at most 2^30 by the check above")]
        Ok(Force::saturating_from_bits(libm::round(newtons / self.full_scale_n * full) as i32))
    }

    /// `seconds` in samples, rounded to the nearest.
    fn samples(&self, parameter: &'static str, seconds: f64) -> Result<u32, SettingsError> {
        let allowed = widen(&limits::PHASE_SAMPLES);
        let range = allowed.start() / self.rate_hz..=allowed.end() / self.rate_hz;
        within(parameter, seconds, range)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to 2^24 by the check above"
        )]
        Ok(libm::round(seconds * self.rate_hz) as u32)
    }
}

pub(crate) fn widen(range: &RangeInclusive<u32>) -> RangeInclusive<f64> {
    f64::from(*range.start())..=f64::from(*range.end())
}

impl Settings {
    /// Validates, and folds every unit into integer gains and coefficients.
    ///
    /// The same `f64` operations and `libm` functions on host and target, so both get the same bits.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    pub fn build(&self, design: &Design) -> Result<LoopParameters, SettingsError> {
        design.check()?;
        let wall = &self.wall;
        within("stiffness_n_per_m", wall.stiffness_n_per_m, limits::STIFFNESS_N_PER_M)?;
        within("damping_n_s_per_m", wall.damping_n_s_per_m, limits::DAMPING_N_S_PER_M)?;
        let force_lsb_per_n = f64::from(Force::FULL_SCALE.bits()) / design.full_scale_n;
        // One count of penetration, and one LSB of velocity, in SI units.
        let velocity_lsb =
            design.resolution_m * design.rate_hz / f64::from(1u32 << Velocity::FRACTION_BITS);
        Ok(LoopParameters {
            estimator: self.velocity.build(design)?,
            wall: Wall {
                surface: design.position("position_m", wall.position_m)?,
                stiffness: gain(
                    "stiffness_n_per_m",
                    wall.stiffness_n_per_m,
                    design.resolution_m * force_lsb_per_n,
                )?,
                damping: gain(
                    "damping_n_s_per_m",
                    wall.damping_n_s_per_m,
                    velocity_lsb * force_lsb_per_n,
                )?,
                push_only: wall.push_only,
            },
            actuator: Actuator::new(design.output)?,
            period: NonZeroU32::new(design.period).unwrap_or(NonZeroU32::MIN), // checked above
        })
    }
}

/// `value * lsb` as a gain.
///
/// # Errors
/// The product does not fit; the range is what does.
fn gain(parameter: &'static str, value: f64, lsb: f64) -> Result<Gain, SettingsError> {
    let smallest = libm::scalbn(1.0, -32) / lsb;
    let largest = libm::scalbn(1.0, 53) / lsb;
    Gain::from_f64(value * lsb).ok_or(SettingsError { parameter, value, range: smallest..=largest })
}

impl HitSettings {
    /// Validates, and converts to samples, counts and fractions of full scale.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    pub fn build(&self, design: &Design) -> Result<HitPlan, SettingsError> {
        design.check()?;
        let limit_counts = self.rms_limit_m / design.resolution_m;
        let rms = &limits::RMS_COUNTS;
        let range = rms.start() * design.resolution_m..=rms.end() * design.resolution_m;
        within("rms_limit_m", self.rms_limit_m, range)?;
        Ok(HitPlan {
            push: design.force("push_n", self.push_n)?,
            settle: design.samples("settle_s", self.settle_s)?,
            window: design.samples("window_s", self.window_s)?,
            limit: RmsLimit::from_counts(limit_counts),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DESIGN: Design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Continuous,
    };

    fn surface(position_m: f64) -> i32 {
        let wall = WallSettings {
            position_m,
            stiffness_n_per_m: 1000.0,
            damping_n_s_per_m: 1.0,
            push_only: true,
        };
        let velocity = VelocitySettings::Butterworth { cutoff_hz: 500.0 };
        Settings { velocity, wall }.build(&DESIGN).unwrap().wall.surface().counts()
    }

    #[test]
    fn the_surface_is_the_nearest_count() {
        for (position_m, counts) in
            [(0.0, 0), (2.4e-6, 2), (2.6e-6, 3), (-0.4e-6, 0), (-0.6e-6, -1), (0.07, 70_000)]
        {
            assert_eq!(surface(position_m), counts, "{position_m}");
        }
    }

    #[test]
    fn a_hit_in_samples_counts_and_fractions() {
        let hit = HitSettings { push_n: 2.953, settle_s: 4.0, window_s: 2.0, rms_limit_m: 1.5e-5 };
        let plan = hit.build(&DESIGN).unwrap();
        assert_eq!((plan.settle, plan.window), (40_000, 20_000));
        assert_eq!(plan.push.bits(), 1 << 29);
        assert_eq!(plan.limit, RmsLimit::from_bits(15 << 16));
        let late = HitSettings { settle_s: f64::NAN, ..hit };
        assert_eq!(late.build(&DESIGN).unwrap_err().parameter, "settle_s");
        let strong = HitSettings { push_n: -6.0, ..hit };
        assert_eq!(strong.build(&DESIGN).unwrap_err().parameter, "push_n");
    }

    #[test]
    fn limits_print_without_the_digits_of_their_arithmetic() {
        assert_eq!(shorten(3.5e-5 * 1000.0), 0.035);
        assert_eq!(shorten(-1_234.567_891_234), -1_234.567_89);
        assert_eq!(shorten(0.0), 0.0);
        assert_eq!(shorten(1e300 * 1.000_000_000_01), 1e300);
        assert!(shorten(f64::NAN).is_nan());
    }
}
