//! Limits of the supervisor: in SI units for people, in counts, samples and outputs for the loop.

use core::ops::RangeInclusive;

use crate::{
    Design,
    range::{SettingsError, within},
    units::{Force, Position, Velocity},
};

/// Largest step of the force per output that is not asked for by position or velocity: 5 % of full
/// scale, in LSB of [`Force`]. At 1 kHz a change over the whole range takes 20 ms.
pub const SLEW: i32 = (1 << Force::FRACTION_BITS) / 20;

/// A force above this without motion is suspicious: 10 % of full scale, in LSB of [`Force`]. Twice
/// what the sign test moves the handle with, so friction does not explain it.
pub(super) const PUSH_FORCE: i32 = (1 << Force::FRACTION_BITS) / 10;
/// How long it may last, s.
pub(super) const PUSH_S: f64 = 0.05;
/// Less than this is no motion, counts: a count that flickers at an edge moves by 1, with noise by 2.
pub(super) const PUSH_COUNTS: u32 = 3;
/// Longest duration of the sign test, s.
pub(super) const SIGN_TEST_S: f64 = 0.1;
/// Outputs that are missing one after another when `render` counts as stuck.
pub(super) const STUCK_RENDERS: u32 = 10;

/// Longest output period, s: the sign test needs several outputs.
const RENDER_PERIOD_MAX_S: f64 = 0.0125;

/// What is believable and allowed for this device, SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetySettings {
    /// Estimated speed beyond which the force goes, m/s: 0 < .. < 32767 counts per sample.
    pub speed_max_m_per_s: f64,
    /// Fastest speed that the handle can have at all, m/s, at least `speed_max_m_per_s`: a larger
    /// move from one sample to the next is a count jump. One count is added for quantisation.
    pub speed_believable_m_per_s: f64,
    /// Lowest place at which force may be on, from zero, m: one to 2^30 counts below it.
    pub travel_low_m: f64,
    /// Highest such place, m: one to 2^30 counts above zero.
    pub travel_high_m: f64,
    /// Time over which the force comes in after `arm`, s: 0.02 to 10.
    pub ramp_in_s: f64,
    /// Force of the sign test, as a fraction of full scale: 0.001 to 0.05.
    pub sign_test_force: f64,
    /// What the sign test has to see, counts: 10 to 2^20. Below 8 quantisation alone could pass it.
    pub sign_test_counts: u32,
}

impl SafetySettings {
    /// Allowed times of the ramp, s. The lower end keeps the ramp below 5 % per output at 1 kHz.
    pub const RAMP_IN_S: RangeInclusive<f64> = 0.02..=10.0;
    /// Allowed forces of the sign test, fraction of full scale.
    pub const SIGN_TEST_FORCE: RangeInclusive<f64> = 0.001..=0.05;
    /// Allowed thresholds of the sign test, counts.
    pub const SIGN_TEST_COUNTS: RangeInclusive<f64> = 10.0..=1_048_576.0;

    /// Checks, and converts to counts, samples and outputs.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "every value is bounded by the check before it"
    )]
    pub fn build(&self, design: &Design) -> Result<SafetyPlan, SettingsError> {
        design.check()?;
        let period_s = f64::from(design.period) / design.rate_hz;
        within("period", period_s, 0.0..=RENDER_PERIOD_MAX_S).map_err(|_| SettingsError {
            parameter: "period",
            value: f64::from(design.period),
            range: 1.0..=libm::floor(RENDER_PERIOD_MAX_S * design.rate_hz),
        })?;
        let metres_per_second = design.resolution_m * design.rate_hz; // one count per sample
        let fastest = f64::from(Velocity::LIMIT - 1) * metres_per_second;
        // At least one LSB of velocity, so that a handle at rest is not too fast.
        let slowest = metres_per_second / f64::from(1u32 << Velocity::FRACTION_BITS);
        let speed = self.speed_max_m_per_s;
        within("speed_max_m_per_s", speed, slowest..=fastest)?;
        let believable = self.speed_believable_m_per_s;
        within("speed_believable_m_per_s", believable, speed..=fastest)?;
        let widest = design.resolution_m * f64::from(Position::LIMIT);
        within("travel_low_m", self.travel_low_m, -widest..=-design.resolution_m)?;
        within("travel_high_m", self.travel_high_m, design.resolution_m..=widest)?;
        within("ramp_in_s", self.ramp_in_s, Self::RAMP_IN_S)?;
        within("sign_test_force", self.sign_test_force, Self::SIGN_TEST_FORCE)?;
        let counts = f64::from(self.sign_test_counts);
        within("sign_test_counts", counts, Self::SIGN_TEST_COUNTS)?;
        let full = f64::from(Force::FULL_SCALE.bits());
        let velocity_lsb = f64::from(1u32 << Velocity::FRACTION_BITS);
        let least = Force::FULL_SCALE.bits().unsigned_abs() / SLEW.unsigned_abs() + 1;
        let ramp_renders = (libm::ceil(self.ramp_in_s / period_s) as u32).max(least);
        Ok(SafetyPlan {
            period: design.period,
            jump: libm::ceil(believable / metres_per_second) as u32 + 1,
            speed: (speed / metres_per_second * velocity_lsb) as u32,
            moved: libm::round(speed * period_s / design.resolution_m) as u32 + 1,
            travel: [self.travel_low_m, self.travel_high_m]
                .map(|end_m| libm::trunc(end_m / design.resolution_m) as i32),
            ramp_renders,
            ramp_step: (1 << Force::FRACTION_BITS) / ramp_renders,
            sign_quarter: (SIGN_TEST_S / period_s / 4.0) as u32,
            sign_force: Force::saturating_from_bits(
                ((self.sign_test_force * full) as i32).min(SLEW),
            ),
            sign_counts: self.sign_test_counts.cast_signed(),
            push_renders: libm::ceil(PUSH_S / period_s) as u32,
        })
    }
}

/// The limits in integers; made by [`SafetySettings::build`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SafetyPlan {
    /// Samples from one output to the next.
    pub(super) period: u32,
    /// Largest believable move in one sample, counts.
    pub(super) jump: u32,
    /// Largest allowed speed, LSB of [`Velocity`].
    pub(super) speed: u32,
    /// Largest allowed move from one output to the next, counts; one is for quantisation.
    pub(super) moved: u32,
    /// Lowest and highest place with force, counts.
    pub(super) travel: [i32; 2],
    /// Outputs over which the force comes in.
    pub(super) ramp_renders: u32,
    /// Part of the force that one output of the ramp adds, LSB of 2^-30, rounded down.
    pub(super) ramp_step: u32,
    /// Outputs of one of the four parts of the sign test.
    pub(super) sign_quarter: u32,
    /// Force of the sign test.
    pub(super) sign_force: Force,
    /// What it has to see, counts.
    pub(super) sign_counts: i32,
    /// Outputs that a push without motion may last.
    pub(super) push_renders: u32,
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::Output;

    pub const DESIGN: Design = Design {
        rate_hz: 10_000.0,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Dac { bits: 12 },
    };
    pub const SETTINGS: SafetySettings = SafetySettings {
        speed_max_m_per_s: 1.0,
        speed_believable_m_per_s: 5.0,
        travel_low_m: -0.1,
        travel_high_m: 0.2,
        ramp_in_s: 0.2,
        sign_test_force: 0.05,
        sign_test_counts: 20,
    };

    #[test]
    fn limits_become_counts_samples_and_outputs() {
        let plan = SETTINGS.build(&DESIGN).unwrap();
        assert_eq!(plan.jump, 501); // 5 m/s are 500 counts of 1 um in 100 us, and one more
        assert_eq!(plan.speed, 100 << 16);
        assert_eq!(plan.moved, 1001);
        assert_eq!(plan.travel, [-100_000, 200_000]);
        assert_eq!(plan.ramp_renders, 200);
        assert_eq!(plan.sign_quarter, 25);
        assert_eq!(plan.push_renders, 50);
        assert!(plan.sign_force.bits() <= SLEW);
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let named = |settings: SafetySettings| settings.build(&DESIGN).unwrap_err().parameter;
        let base = SETTINGS;
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 400.0] {
            let settings = SafetySettings { speed_max_m_per_s: bad, ..base };
            assert_eq!(named(settings), "speed_max_m_per_s", "{bad}");
        }
        assert_eq!(
            named(SafetySettings { speed_believable_m_per_s: 0.9, ..base }),
            "speed_believable_m_per_s"
        );
        for bad in [0.0, -0.1, 1e-7, 1100.0, f64::NAN] {
            assert_eq!(
                named(SafetySettings { travel_low_m: -bad, ..base }),
                "travel_low_m",
                "{bad}"
            );
            assert_eq!(
                named(SafetySettings { travel_high_m: bad, ..base }),
                "travel_high_m",
                "{bad}"
            );
        }
        assert_eq!(named(SafetySettings { ramp_in_s: 0.01, ..base }), "ramp_in_s");
        assert_eq!(named(SafetySettings { sign_test_force: 0.06, ..base }), "sign_test_force");
        assert_eq!(named(SafetySettings { sign_test_counts: 9, ..base }), "sign_test_counts");
        let slow = Design { period: 1000, ..DESIGN };
        let error = base.build(&slow).unwrap_err();
        assert_eq!((error.parameter, error.value, *error.range.end()), ("period", 1000.0, 125.0));
    }
}
