//! The limits of the supervisor. [`SafetySettings`] has them in SI units, for people. [`SafetyPlan`] has them in
//! counts, samples and outputs, for the loop.

use core::ops::RangeInclusive;

use crate::{
    Design,
    passivity::{Passivity, PassivitySettings},
    range::{SettingsError, within},
    units::{Force, Position, Velocity},
};

/// Largest change of the force in a millisecond, in LSB of [`Force`]. It is 5 % of full scale. Changes because of
/// position or velocity are not limited. A change by full scale takes 20 ms, and a change over the whole range 40 ms.
/// If outputs are more than a millisecond apart, this is the largest step of an output.
pub const SLEW: i32 = (1 << Force::FRACTION_BITS) / 20;

/// Largest force that may act for any time without a motion, in LSB of [`Force`]. It is 10 % of full scale. It is twice
/// the force with which the sign test moves the handle, so friction cannot be the reason for the missing motion.
pub(super) const PUSH_FORCE: i32 = (1 << Force::FRACTION_BITS) / 10;
/// The longest time, in s, for which a larger force may act without a motion.
pub(super) const PUSH_S: f64 = 0.05;
/// Smallest change of the count that counts as a motion. At rest the count can flicker by 1 at an edge, and by 2 with
/// noise.
pub(super) const PUSH_COUNTS: u32 = 3;
/// Binary places of a count in the computed motion of the heaviest handle.
pub(super) const HEAVIEST_BITS: u32 = 32;
/// Largest change of the heaviest handle's speed at full scale. It is 2^14 counts per output, so that the product with
/// a force does not overflow.
const YIELDS_MAX: u64 = 1 << 46;
/// Longest duration of the sign test, in s.
pub(super) const SIGN_TEST_S: f64 = 0.1;
/// Time, in s, after which the task `render` counts as stuck if no output comes.
const STUCK_S: f64 = 0.01;

/// Longest output period, in s. The sign test needs several outputs.
const RENDER_PERIOD_MAX_S: f64 = 0.0125;

/// What is believable and what is allowed for a device, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetySettings {
    /// Estimated speed, in m/s, above which the force is switched off. It must be above 0 and below 32767 counts per
    /// sample.
    pub speed_max_m_per_s: f64,
    /// Highest speed that the handle can have at all, in m/s. It is at least `speed_max_m_per_s`. A larger move from
    /// one sample to the next is a count jump. One count is added for quantisation.
    pub speed_believable_m_per_s: f64,
    /// Lowest position at which force may be on, in m. It must lie one to 2^30 counts below zero.
    pub travel_low_m: f64,
    /// Highest position at which force may be on, in m. It must lie one to 2^30 counts above zero.
    pub travel_high_m: f64,
    /// Time over which the force rises after `arm`, in s. The range is 0.02 to 10.
    pub ramp_in_s: f64,
    /// Force of the sign test, as a part of full scale. The range is 0.001 to 0.05.
    pub sign_test_force: f64,
    /// Motion that the sign test needs, in counts. The range is 10 to 2^20. With less than 8 counts, quantisation alone
    /// could pass the test.
    pub sign_test_counts: u32,
    /// Mass, in kg, of the heaviest handle that an experiment may push, with everything that hangs on it. The range is
    /// 1e-9 to 1e6. If a push moves the count by less than this handle would move, it is a push without motion.
    pub heaviest_mass_kg: f64,
    /// Damping of the heaviest handle, in N s/m. The range is 0 to 1e6.
    pub heaviest_damping_n_s_per_m: f64,
    /// Largest acceleration of the handle, in m/s^2, for the passivity controller of the wall. With 0 there is no
    /// controller.
    pub passive_acceleration_m_per_s2: f64,
}

impl SafetySettings {
    /// Allowed times of the ramp, in s. The lower end keeps the ramp below 5 % per output at 1 kHz.
    pub const RAMP_IN_S: RangeInclusive<f64> = 0.02..=10.0;
    /// Allowed forces of the sign test, as a part of full scale.
    pub const SIGN_TEST_FORCE: RangeInclusive<f64> = 0.001..=0.05;
    /// Allowed thresholds of the sign test, in counts.
    pub const SIGN_TEST_COUNTS: RangeInclusive<f64> = 10.0..=1_048_576.0;
    /// Allowed masses of the heaviest handle, in kg.
    pub const HEAVIEST_MASS_KG: RangeInclusive<f64> = 1e-9..=1e6;
    /// Allowed dampings of the heaviest handle, in N s/m.
    pub const HEAVIEST_DAMPING_N_S_PER_M: RangeInclusive<f64> = 0.0..=1e6;

    /// Checks the limits, and converts them to counts, samples and outputs.
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
        let period_s = design.period_s();
        within("period", period_s, 0.0..=RENDER_PERIOD_MAX_S).map_err(|_| SettingsError {
            parameter: "period",
            value: f64::from(design.period),
            range: 1.0..=libm::floor(RENDER_PERIOD_MAX_S * design.rate_hz),
        })?;
        let metres_per_second = design.resolution_m * design.rate_hz; // one count per sample
        let fastest = f64::from(Velocity::LIMIT - 1) * metres_per_second;
        // The limit must be at least one LSB of the velocity. With a limit of 0, a handle at rest would be too fast.
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
        within("heaviest_mass_kg", self.heaviest_mass_kg, Self::HEAVIEST_MASS_KG)?;
        within(
            "heaviest_damping_n_s_per_m",
            self.heaviest_damping_n_s_per_m,
            Self::HEAVIEST_DAMPING_N_S_PER_M,
        )?;
        let passivity = match self.passive_acceleration_m_per_s2 {
            0.0 => None,
            acceleration_m_per_s2 => {
                let settings = PassivitySettings { acceleration_m_per_s2, latency: 0 };
                let named = |error: SettingsError| SettingsError {
                    parameter: "passive_acceleration_m_per_s2",
                    ..error
                };
                Some(settings.build(design).map_err(named)?)
            }
        };
        let slows = self.heaviest_damping_n_s_per_m / self.heaviest_mass_kg / design.rate_hz;
        let yields = design.full_scale_n
            / (self.heaviest_mass_kg * design.resolution_m)
            / (design.rate_hz * design.rate_hz);
        let full = f64::from(Force::FULL_SCALE.bits());
        let velocity_lsb = f64::from(1u32 << Velocity::FRACTION_BITS);
        let samples = |seconds: f64| seconds * design.rate_hz;
        let plan = SafetyPlan {
            jump: libm::ceil(believable / metres_per_second) as u32 + 1,
            speed: (speed / metres_per_second * velocity_lsb) as u32,
            travel: [self.travel_low_m, self.travel_high_m]
                .map(|end_m| libm::trunc(end_m / design.resolution_m) as i32),
            sign_force: Force::saturating_from_bits(
                ((self.sign_test_force * full) as i32).min(SLEW),
            ),
            sign_counts: self.sign_test_counts.cast_signed(),
            samples: Samples {
                // The cast saturates, so `yields` is at most 1 count.
                yields: libm::ldexp(yields, HEAVIEST_BITS.cast_signed()) as u32,
                slows: libm::ldexp(slows, HEAVIEST_BITS.cast_signed()) as u32,
                ms: design.samples_per_ms(),
                ramp: libm::ceil(samples(self.ramp_in_s)) as u32,
                sign_quarter: (samples(SIGN_TEST_S) / 4.0) as u32,
                push: libm::ceil(samples(PUSH_S)) as u32,
                stuck: libm::round(samples(STUCK_S)) as u32,
            },
            passivity,
            ..SafetyPlan::default()
        };
        Ok(plan.at(design.period))
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Samples {
    /// The values of [`SafetyPlan::yields`] and [`SafetyPlan::slows`] for an output at every sample.
    yields: u32,
    slows: u32,
    ms: u32,
    ramp: u32,
    sign_quarter: u32,
    push: u32,
    stuck: u32,
}

impl SafetyPlan {
    /// The wall's passivity controller, if there is one.
    pub fn passivity(&self) -> Option<&Passivity> {
        self.passivity.as_ref()
    }

    /// Returns the same limits for an output every `period` samples.
    pub(crate) fn at(self, period: u32) -> Self {
        let period = period.max(1);
        let Samples { yields, slows, ms, ramp, sign_quarter, push, stuck } = self.samples;
        let per_ms = (ms / period).max(1);
        // The step is 5 % * `period` / `ms`. Both are at most 50, so the product is within 32 bits.
        let slew =
            if period < ms { SLEW.unsigned_abs() * period / ms } else { SLEW.unsigned_abs() };
        let ramp_renders =
            ramp.div_ceil(period).max(Force::FULL_SCALE.bits().unsigned_abs() / slew.max(1) + 1);
        let moved = (u64::from(self.speed) * u64::from(per_ms * period)) >> Velocity::FRACTION_BITS;
        Self {
            period,
            stuck: stuck.max(2 * period),
            slew: slew.cast_signed(),
            per_ms,
            #[expect(
                clippy::cast_possible_truncation,
                reason = "2^15 counts times 1000 samples at most"
            )]
            moved: moved as u32 + 1,
            ramp_renders,
            ramp_step: (1 << Force::FRACTION_BITS) / ramp_renders.max(1),
            sign_quarter: sign_quarter / period,
            push_renders: push.div_ceil(period),
            // If the value is limited here, the check only becomes less strict.
            yields: (u64::from(yields) * u64::from(period) * u64::from(period)).min(YIELDS_MAX),
            slows: slows.saturating_mul(period),
            passivity: self.passivity.map(|plan| plan.at(period)),
            ..self
        }
    }
}

/// The limits in integers. Made by [`SafetySettings::build`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SafetyPlan {
    /// Samples from one output to the next.
    pub(super) period: u32,
    /// Largest believable move in one sample, in counts.
    pub(super) jump: u32,
    /// Largest allowed speed, in LSB of [`Velocity`].
    pub(super) speed: u32,
    /// Number of samples without an output after which the task `render` counts as stuck.
    pub(super) stuck: u32,
    /// Largest step of the force from one output to the next that does not come from position or velocity.
    pub(super) slew: i32,
    /// Number of outputs in a millisecond. It is at least 1.
    pub(super) per_ms: u32,
    /// Largest allowed move in `per_ms` outputs, in counts. One count for quantisation is included.
    pub(super) moved: u32,
    /// Lowest and highest position with force, in counts.
    pub(super) travel: [i32; 2],
    /// Outputs over which the force rises.
    pub(super) ramp_renders: u32,
    /// Part of the force that one output of the ramp adds, in units of 2^-30, rounded down.
    pub(super) ramp_step: u32,
    /// Outputs of one of the four parts of the sign test.
    pub(super) sign_quarter: u32,
    pub(super) sign_force: Force,
    /// Motion that the sign test needs, in counts.
    pub(super) sign_counts: i32,
    /// The largest number of outputs for which a push may cause no motion.
    pub(super) push_renders: u32,
    /// Speed that the force at full scale adds to the heaviest handle from one output to the next, in units of 2^-32
    /// counts per output.
    pub(super) yields: u64,
    /// Part of its speed that the heaviest handle loses by damping from one output to the next, in units of 2^-32.
    pub(super) slows: u32,
    pub(super) passivity: Option<Passivity>,
    /// Times in samples, from which the numbers of outputs are computed.
    samples: Samples,
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
        heaviest_mass_kg: 8.0,
        heaviest_damping_n_s_per_m: 110.0,
        passive_acceleration_m_per_s2: 0.0,
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
        let weak = SafetySettings { sign_test_force: 0.02, ..SETTINGS }.build(&DESIGN).unwrap();
        assert_eq!(weak.sign_force.bits(), Force::FULL_SCALE.bits() / 50);
        assert_eq!((plan.slew, plan.per_ms, plan.stuck), (SLEW, 1, 100));
    }

    /// The times of the plan are the same at every output period. If outputs are more than a millisecond apart, the
    /// step stays 5 %.
    #[test]
    fn outputs_that_are_closer_share_the_step_and_the_time() {
        for (period, per_ms) in [(1, 10), (2, 5), (5, 2), (10, 1), (20, 1), (125, 1)] {
            let plan = SETTINGS.build(&Design { period, ..DESIGN }).unwrap();
            assert_eq!(plan.per_ms, per_ms, "{period}");
            let steps = per_ms.cast_signed();
            assert!(plan.slew * steps <= SLEW && (plan.slew + 1) * steps > SLEW, "{period}");
            let times = [
                (plan.ramp_renders, 2000),
                (4 * plan.sign_quarter, 1000),
                (plan.push_renders, 500),
            ];
            for (outputs, samples) in times.into_iter().take(if period > 20 { 0 } else { 3 }) {
                let far = (outputs * period).abs_diff(samples);
                assert!(far < 4 * period, "{period}: {outputs} {samples}");
            }
            assert_eq!(plan.stuck, if period > 50 { 250 } else { 100 });
        }
        let quick = SafetySettings { ramp_in_s: 0.02, ..SETTINGS };
        let plan = quick.build(&Design { period: 1, ..DESIGN }).unwrap();
        assert!(plan.ramp_step <= plan.slew.unsigned_abs());
    }

    /// Tries limits from one LSB of the velocity to one count below the end of its range.
    #[test]
    fn every_speed_that_can_be_told_apart_can_be_a_limit() {
        let build = |speed_max_m_per_s, speed_believable_m_per_s| {
            SafetySettings { speed_max_m_per_s, speed_believable_m_per_s, ..SETTINGS }
                .build(&DESIGN)
                .map(|plan| plan.speed)
        };
        let count_m_per_s = 0.01;
        let lsb_m_per_s = count_m_per_s / 65_536.0;
        assert_eq!(build(1.01 * lsb_m_per_s, 5.0), Ok(1));
        assert!(build(0.99 * lsb_m_per_s, 5.0).is_err());
        let highest = f64::from(Velocity::LIMIT - 1) * count_m_per_s;
        assert!(build(1.0, highest).is_ok());
        assert!(build(1.0, highest + count_m_per_s).is_err());
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
