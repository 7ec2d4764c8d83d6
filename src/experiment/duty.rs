//! The duty limit. It is an I^2 t model of the motor's winding. With it, experiments pause before they overheat the
//! winding.
//!
//! A motor's loss rises with the square of its current. With a current-mode amplifier the force is proportional to the
//! current. The winding is one thermal mass. IEC 60034-11 calls this protection "thermal model", drives call it I^2 t:
//!
//! ```text
//! heat' = (u^2 - heat) / tau          u = force / full scale
//! ```
//!
//! `heat` is the mean of u^2, weighted by exp(-age / tau). With each output of length T, `heat` moves by
//! `1 - exp(-T / tau)` of its distance from u^2. While u is constant this step is exact, for every accepted T and tau.
//! Heat and u^2 lie within 0..=1 at 60 fractional bits, so the format itself excludes an overflow. [`Duty::is_ready`]
//! lets a hit begin only if `heat` stays within its limit even at full force for the whole hit. So no sequence of hits
//! exceeds the limit, and no hit is broken off. Hits wait instead.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::{
    Design, Gain,
    range::{SettingsError, within},
    safety::Doubled,
    units::Force,
};

/// Fractional bits of the heat.
const FRACTION: u32 = 2 * Force::FRACTION_BITS;
/// Fractional bits of a difference of heats in the multiplication. With them the range +-1 fits into 32 bits.
const DIFFERENCE: u32 = 30;

/// Thermal limits of the motor, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DutySettings {
    /// Force, in N, that the motor can give for ever. The limit of the heat is (continuous force / full scale)^2.
    pub continuous_force_n: f64,
    /// Thermal time constant of the winding, in s. It is 1 to 3600.
    pub time_constant_s: f64,
}

/// The limit in integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DutyPlan {
    /// Factor by which one output moves the heat towards u^2. The unit is LSB of the heat per LSB of the difference.
    exchange: Gain,
    /// Heat that must not be exceeded.
    limit: i64,
    /// Heat at which a hit may begin.
    ready: i64,
    patience: u32,
}

impl DutyPlan {
    /// Outputs after which a motor without force is certainly ready, however warm it was.
    pub fn patience(&self) -> u32 {
        self.patience
    }

    /// Flips a bit of the limit.
    #[cfg(test)]
    pub(crate) fn spoil(&mut self) {
        self.limit ^= 1 << DIFFERENCE;
    }
}

impl DutySettings {
    /// Length, in s, of the longest hit at full force that a cold motor can bear. It is 0 if the motor can bear none,
    /// and infinite if it can give full scale for ever.
    #[expect(clippy::float_arithmetic, reason = "design time")]
    pub fn longest_hit_s(&self, design: &Design) -> f64 {
        let period_s = design.period_s();
        let part = self.continuous_force_n / design.full_scale_n;
        if part >= 1.0 {
            return f64::INFINITY;
        }
        // The inverse of the condition in `build`.
        let kept = (1.0 - part * part) / (1.0 - RESERVE);
        let outputs = -libm::log(kept) * self.time_constant_s / period_s;
        f64::max(0.0, libm::floor(outputs - spare_outputs(design)) * period_s)
    }

    /// Checks and converts the limits. A hit lasts `samples`.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range. The force is out of range if even a cold motor
    /// would be too hot after a hit at full force.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::float_arithmetic,
        reason = "design time; every value is bounded by the check before it"
    )]
    pub fn build(&self, design: &Design, samples: u32) -> Result<DutyPlan, SettingsError> {
        design.check()?;
        let tau = within("duty_time_constant_s", self.time_constant_s, 1.0..=3600.0)?;
        let part = design.period_s() / tau;
        let outputs = libm::ceil(f64::from(samples) / f64::from(design.period));
        let outputs = outputs + spare_outputs(design);
        let kept = libm::exp(-outputs * part);
        let least = libm::sqrt(1.0 - kept + RESERVE * kept) * design.full_scale_n;
        let force = self.continuous_force_n;
        within("duty_continuous_force_n", force, least..=design.full_scale_n)?;
        let limit = (force / design.full_scale_n) * (force / design.full_scale_n);
        // The rounding of a small `kept` could give less than the lower end of the range above. So the value is at
        // least this lower end.
        let ready = f64::max(1.0 - (1.0 - limit) / kept, RESERVE) - 1e-4;
        let bits = |value: f64| libm::floor(libm::scalbn(value, FRACTION.cast_signed())) as i64;
        Ok(DutyPlan {
            // 5e-9 to 0.64, times 2^30: far from the ends of a gain
            exchange: Gain::from_f64(libm::scalbn(
                1.0 - libm::exp(-part),
                (FRACTION - DIFFERENCE).cast_signed(),
            ))
            .unwrap_or_default(),
            limit: bits(limit),
            ready: bits(ready),
            patience: libm::ceil(PATIENCE / part) as u32,
        })
    }
}

/// Reserve of heat for rounding, and for a return move that warms a cold motor before the hit.
const RESERVE: f64 = 1e-3;

/// Number of outputs that the model adds to a hit, because the force of a hit also has to rise and to fall. They last
/// 50 ms, and are at least 50.
fn spare_outputs(design: &Design) -> f64 {
    f64::from(50 * design.samples_per_ms().div_ceil(design.period.max(1)))
}

/// Number of time constants after which the motor counts as cold. exp(-9.3) is 1e-4, and no `ready` is smaller.
const PATIENCE: f64 = 9.3;

/// Temperature of the motor in the model. The motor is cold at reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Duty {
    /// Heat as a part of the final heat at full force, 0 to 1, with [`FRACTION`] fractional bits.
    heat: Doubled<i64>,
}

impl Default for Duty {
    fn default() -> Self {
        Self { heat: Doubled::new(0) }
    }
}

impl Duty {
    /// Whether the heat is unchanged.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.heat.is_whole()
    }

    /// Flips a bit of the second copy of the heat.
    #[cfg(test)]
    pub(crate) fn spoil(&mut self) {
        self.heat.spoil(*self.heat ^ 1 << DIFFERENCE);
    }

    /// Adds the force of one output.
    #[inline]
    pub fn add(&mut self, plan: &DutyPlan, force: Force) {
        let force = i64::from(force.bits());
        if !self.heat.is_whole() {
            return; // a change would hide the flipped bit
        }
        let heat = *self.heat;
        #[expect(clippy::cast_possible_truncation, reason = "+-2^30")]
        let difference = ((force * force - heat) >> (FRACTION - DIFFERENCE)) as i32;
        self.heat.set(heat + plan.exchange.apply(difference));
    }

    /// Whether a hit may begin.
    pub fn is_ready(&self, plan: &DutyPlan) -> bool {
        *self.heat <= plan.ready
    }

    /// Whether the limit is exceeded.
    pub fn is_too_warm(&self, plan: &DutyPlan) -> bool {
        *self.heat > plan.limit
    }

    /// Heat in thousandths of the final heat at full force.
    pub fn per_mille(&self) -> u32 {
        u32::try_from(((*self.heat >> DIFFERENCE) * 1000) >> (FRACTION - DIFFERENCE))
            .unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::return_move::tests::DESIGN;
    use proptest::prelude::*;

    const SETTINGS: DutySettings = DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 };
    /// A hit of 6 s.
    const SAMPLES: u32 = 60_000;
    const OUTPUTS: u32 = 6_000;
    const CASES: u32 = if cfg!(miri) { 1 } else { 12 };
    const HITS: usize = if cfg!(miri) { 2 } else { 25 };

    fn force(part: f64) -> Force {
        #[expect(clippy::cast_possible_truncation, reason = "within +-1")]
        Force::saturating_from_bits((part * 2f64.powi(30)) as i32)
    }

    #[test]
    #[cfg_attr(miri, ignore = "660 000 outputs of the same few lines")]
    fn it_follows_the_differential_equation() {
        let plan = SETTINGS.build(&DESIGN, SAMPLES).unwrap();
        let mut duty = Duty::default();
        for n in 1..=60_000 {
            duty.add(&plan, force(-0.6));
            let exact = 0.36 * (1.0 - (-f64::from(n) * 1e-3 / 30.0).exp());
            assert!((*duty.heat as f64 / 2f64.powi(FRACTION.cast_signed()) - exact).abs() < 1e-5);
        }
        for _ in 0..600_000 {
            duty.add(&plan, Force::ZERO);
        }
        assert!(duty.per_mille() == 0 && duty.is_ready(&plan));
    }

    /// Compares the model with the weighted mean that it approximates, over the accepted output periods, sample rates
    /// and time constants.
    #[test]
    fn no_accepted_design_overflows_or_loses_the_heat() {
        for (rate_hz, period) in [(1e3, 10), (1e3, 1000), (5e4, 1000), (1e4, 10), (5e4, 1)] {
            for time_constant_s in [1.0, 5.0, 3600.0] {
                let design = Design { rate_hz, period, ..DESIGN };
                let settings = DutySettings { continuous_force_n: 5.906, time_constant_s };
                let plan = settings.build(&design, period).unwrap();
                let decay = (-f64::from(period) / rate_hz / time_constant_s).exp();
                let (mut duty, mut mean) = (Duty::default(), 0.0);
                for n in 0..if cfg!(miri) { 60 } else { 20_000 } {
                    let part = [1.0, -1.0, 0.3, 0.0][n / 7 % 4];
                    duty.add(&plan, force(part));
                    mean = mean * decay + (1.0 - decay) * part * part;
                    let heat = *duty.heat as f64 / 2f64.powi(FRACTION.cast_signed());
                    assert!(
                        (heat - mean).abs() < 1e-5,
                        "{rate_hz} {period} {time_constant_s}: {heat} {mean}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_longest_hit_is_the_longest_that_is_taken() {
        for continuous_force_n in [1.0, 2.0, 4.1, 5.0] {
            let settings = DutySettings { continuous_force_n, ..SETTINGS };
            let longest = settings.longest_hit_s(&DESIGN) * DESIGN.rate_hz;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive")]
            let samples = longest.round() as u32;
            assert!(settings.build(&DESIGN, samples).is_ok(), "{longest}");
            assert!(settings.build(&DESIGN, samples + DESIGN.period).is_err(), "{longest}");
        }
        let strong = DutySettings { continuous_force_n: 6.0, ..SETTINGS };
        assert_eq!(strong.longest_hit_s(&DESIGN), f64::INFINITY);
        assert_eq!(
            DutySettings { continuous_force_n: 0.1, ..SETTINGS }.longest_hit_s(&DESIGN),
            0.0
        );
    }

    fn warm(heat: i64) -> Duty {
        Duty { heat: Doubled::new(heat) }
    }

    #[test]
    fn a_bit_of_the_heat_that_flips_stays_visible() {
        let plan = SETTINGS.build(&DESIGN, SAMPLES).unwrap();
        for bit in 0..i64::BITS {
            let mut duty = warm(plan.ready);
            duty.heat.spoil(plan.ready ^ 1 << bit);
            duty.add(&plan, force(0.3));
            assert!(!duty.is_whole(), "{bit}");
        }
    }

    #[test]
    fn exactly_at_a_limit_is_within_it() {
        let plan = SETTINGS.build(&DESIGN, SAMPLES).unwrap();
        for more in [0, 1] {
            assert_eq!(warm(plan.ready + more).is_ready(&plan), more == 0);
            assert_eq!(warm(plan.limit + more).is_too_warm(&plan), more == 1);
        }
    }

    #[test]
    fn heat_is_told_in_thousandths() {
        for (part, per_mille) in [(0.0, 0), (0.0625, 62), (0.5, 500), (1.0, 1000)] {
            let heat = i64::from(force(part).bits()) << (FRACTION - Force::FRACTION_BITS);
            assert_eq!(warm(heat).per_mille(), per_mille);
        }
    }

    #[test]
    fn the_outputs_to_spare_last_50_ms_or_more() {
        for (rate_hz, period, outputs) in
            [(1e4, 10, 50.0), (1e4, 1, 500.0), (1e4, 20, 50.0), (1e4, 3, 200.0), (5e4, 1, 2_500.0)]
        {
            assert_eq!(spare_outputs(&Design { rate_hz, period, ..DESIGN }), outputs);
        }
    }

    #[test]
    fn a_motor_too_weak_for_one_hit_is_refused_with_the_least_force() {
        let weak = DutySettings { continuous_force_n: 2.0, ..SETTINGS };
        let error = weak.build(&DESIGN, SAMPLES).unwrap_err();
        assert_eq!(error.parameter, "duty_continuous_force_n");
        // 1 - exp(-6.05 s / 30 s) is 0.183
        assert!((*error.range.start() / 5.906 - 0.184f64.sqrt()).abs() < 2e-3, "{error}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(CASES))]

        /// Hits have any force and any length, and the next hit may come at any time. The weighted mean square never
        /// exceeds the limit, and each hit comes in time.
        #[test]
        fn no_sequence_of_hits_exceeds_the_limit(
            hits in prop::collection::vec((0.0..=1.0f64, 1u32..=OUTPUTS, 0.0..0.25f64), 1..HITS)
        ) {
            let plan = SETTINGS.build(&DESIGN, SAMPLES).unwrap();
            let mut duty = Duty::default();
            // the mean square of the force, computed in floats
            let (mut mean, decay) = (0.0, (-1e-3f64 / 30.0).exp());
            let limit = (4.1f64 / 5.906).powi(2);
            for (part, outputs, hold) in hits {
                let mut waited = 0;
                while !duty.is_ready(&plan) {
                    duty.add(&plan, force(hold)); // the return holds the handle meanwhile
                    mean = mean * decay + (1.0 - decay) * hold * hold;
                    waited += 1;
                    prop_assert!(waited < 100_000, "it never gets its turn");
                }
                // worse than any real hit: full force for a while, then a part of it
                for n in 0..outputs {
                    let part = if n % 2 == 0 { 1.0 } else { part };
                    duty.add(&plan, force(part));
                    mean = mean * decay + (1.0 - decay) * part * part;
                    prop_assert!(!duty.is_too_warm(&plan));
                    prop_assert!(mean <= limit, "{mean}");
                }
            }
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "120 000 outputs of the same few lines")]
    fn full_force_hits_one_after_the_other_just_keep_the_limit() {
        let plan = SETTINGS.build(&DESIGN, SAMPLES).unwrap();
        let mut duty = Duty::default();
        let mut warmest = 0;
        for _ in 0..20 {
            while !duty.is_ready(&plan) {
                duty.add(&plan, Force::ZERO);
            }
            for _ in 0..OUTPUTS + 50 {
                duty.add(&plan, Force::FULL_SCALE);
            }
            assert!(!duty.is_too_warm(&plan));
            warmest = warmest.max(*duty.heat);
        }
        // the limit is nearly reached
        assert!(warmest as f64 > 0.995 * plan.limit as f64);
    }
}
