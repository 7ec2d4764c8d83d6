//! The return move: between two hits the handle is brought to the start slowly, by a soft spring whose
//! far end moves there at a limited speed.
//!
//! ```text
//! r     moves from the handle to the start, by at most `speed`, while r is within `lead` of x;
//!       never farther from the start than x is: a handle that is brought on by a hand takes r along
//! e     = r - x                                points to the start until the handle is past it
//! v     = speed of r, at most `speed`
//! force = clamp(K e + I + B (v - x'), +-limit)    I gathers Ki e while K e + I is within +-limit
//! ```
//!
//! **It moves towards its start only.** Spring and integral never point away from the start, whoever moves the handle,
//! as long as it is not past it; what does, brakes a handle that comes faster than `speed`. So what the force can make
//! of any handle is at most `speed + limit / B`.
//!
//! **A return that is taken starts**: a step of r fits the lead, or the spring would have to be stronger than `limit` for
//! the first one.
//!
//! The speed comes from the last eight milliseconds, not from the estimator: a return works with whatever
//! cutoff is tried. The integral finds the force that holds the handle at the start, against a spring
//! or its weight; a hand that holds the handle on the way does not wind it up.
//! In contact the force only ever points out of the wall.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::{
    Design, Gain,
    range::{SettingsError, within},
    units::{Force, Position},
};

/// Milliseconds over which the speed is measured; outputs where those are farther apart.
const SPAN: usize = 8;
/// Outputs for which the handle has to stand at the start, s.
const REST_S: f64 = 0.02;
/// Fractional bits of the moving reference.
const FRACTION: u32 = 16;

/// The return in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReturnSettings {
    /// Where a hit starts, m.
    pub start_m: f64,
    /// Speed of the reference, m/s: 0.001 to 1.
    pub speed_m_per_s: f64,
    /// Largest force, N: up to half of full scale.
    pub force_n: f64,
    /// Stiffness of the soft spring, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping, N s/m.
    pub damping_n_s_per_m: f64,
    /// Integral gain, N/(m s).
    pub integral_n_per_m_s: f64,
    /// Distance from the start that will do, m.
    pub tolerance_m: f64,
    /// Longest time that it may take, s: 0.1 to 60.
    pub timeout_s: f64,
}

/// The return in counts, outputs and fractions of full scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReturnPlan {
    start: Position,
    /// Counts per output, 16 fractional bits.
    step: i64,
    /// Largest distance of the reference from the handle, counts.
    lead: i32,
    limit: i64,
    /// Force LSB per count.
    stiffness: Gain,
    /// Force LSB per count by which the error changes in [`SPAN`] times `pace` outputs.
    damping: Gain,
    /// Outputs from one look at the speed to the next.
    pace: u32,
    /// Force LSB per count and output.
    integral: Gain,
    tolerance: u32,
    rest_outputs: u32,
    timeout_outputs: u32,
}

impl ReturnSettings {
    /// Soft enough for a hand to stop it: tuned on the paper's device and on handles of 0.05 to 2 kg, see the tests.
    pub const SOFT: Self = Self {
        start_m: 0.0,
        speed_m_per_s: 0.15,
        force_n: 1.4,
        stiffness_n_per_m: 300.0,
        damping_n_s_per_m: 15.0,
        integral_n_per_m_s: 600.0,
        tolerance_m: 5e-5,
        timeout_s: 10.0,
    };

    /// Checks, and converts.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::float_arithmetic,
        reason = "design time; every value is bounded by the check before it"
    )]
    pub fn build(&self, design: &Design) -> Result<ReturnPlan, SettingsError> {
        design.check()?;
        let outputs_per_s = design.rate_hz / f64::from(design.period);
        let pace = design.outputs_per_ms();
        within("return_speed_m_per_s", self.speed_m_per_s, 1e-3..=1.0)?;
        let half = design.full_scale_n / 2.0;
        within("return_force_n", self.force_n, 1e-3 * design.full_scale_n..=half)?;
        // r has to be able to take its first step.
        let stiffest = f64::min(1e4, self.force_n * outputs_per_s / self.speed_m_per_s);
        within("return_stiffness_n_per_m", self.stiffness_n_per_m, 1.0..=stiffest)?;
        within("return_damping_n_s_per_m", self.damping_n_s_per_m, 0.0..=1e3)?;
        within("return_integral_n_per_m_s", self.integral_n_per_m_s, 0.0..=1e5)?;
        within("return_timeout_s", self.timeout_s, 0.1..=60.0)?;
        let counts = |metres: f64| metres / design.resolution_m;
        // At most 2^20 counts, so that products with the gains stay far from the ends.
        let widest = f64::from(1 << 20) * design.resolution_m;
        within("return_tolerance_m", self.tolerance_m, 4.0 * design.resolution_m..=widest)?;
        let lsb_per_n = f64::from(Force::FULL_SCALE.bits()) / design.full_scale_n;
        let lsb_per_count = lsb_per_n * design.resolution_m;
        let gain = |name, value: f64, lsb: f64| {
            let range = 0.0..=libm::scalbn(1.0, 50) / lsb;
            Gain::from_f64(value * lsb).ok_or(SettingsError { parameter: name, value, range })
        };
        #[expect(clippy::cast_precision_loss, reason = "8")]
        let span_s = SPAN as f64 * f64::from(pace) / outputs_per_s;
        let step = counts(self.speed_m_per_s) / outputs_per_s * f64::from(1u32 << FRACTION);
        Ok(ReturnPlan {
            start: design.position("start_m", self.start_m)?,
            step: (libm::ceil(step) as i64).max(1),
            lead: libm::ceil(counts(self.force_n / self.stiffness_n_per_m)) as i32,
            limit: (self.force_n * lsb_per_n) as i64,
            stiffness: gain("return_stiffness_n_per_m", self.stiffness_n_per_m, lsb_per_count)?,
            damping: gain(
                "return_damping_n_s_per_m",
                self.damping_n_s_per_m,
                lsb_per_count / span_s,
            )?,
            pace,
            integral: gain(
                "return_integral_n_per_m_s",
                self.integral_n_per_m_s,
                lsb_per_count / outputs_per_s,
            )?,
            tolerance: counts(self.tolerance_m) as u32,
            rest_outputs: libm::ceil(REST_S * outputs_per_s) as u32,
            timeout_outputs: libm::ceil(self.timeout_s * outputs_per_s) as u32,
        })
    }
}

impl ReturnPlan {
    /// Where it ends.
    pub fn start(&self) -> Position {
        self.start
    }

    /// The largest force.
    pub fn force(&self) -> Force {
        Force::saturating_from_bits(i32::try_from(self.limit).unwrap_or(i32::MAX))
    }
}

/// What one output of a return leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReturnStep {
    /// Go on, with this force.
    Push(Force),
    /// The handle stands at the start.
    Arrived,
    /// It took too long: the handle is held, or something is in its way.
    TooLong,
}

/// A return in progress.
#[derive(Clone, Copy, Debug)]
pub struct Return {
    plan: ReturnPlan,
    /// Counts, 16 fractional bits; `None` before the first output.
    reference: Option<i64>,
    integral: i64,
    /// How far r has moved by its own steps, 16 fractional bits.
    planned: i64,
    /// The last distances of that from the handle, newest first, counts: one each millisecond.
    past: [i64; SPAN],
    /// By how much they have grown, and outputs until the next look.
    widened: i64,
    left: u32,
    /// Where the handle has stood, within the tolerance, for that many outputs.
    rest: (Position, u32),
    outputs: u32,
}

impl Return {
    /// A return whose first output is still to come.
    pub fn new(plan: ReturnPlan) -> Self {
        Self {
            plan,
            reference: None,
            integral: 0,
            planned: 0,
            past: [0; SPAN],
            widened: 0,
            left: 0,
            rest: (Position::default(), 0),
            outputs: 0,
        }
    }

    /// The force for this output. `contact`: the handle is inside the wall.
    pub fn output(&mut self, position: Position, contact: bool) -> ReturnStep {
        let plan = self.plan;
        let x = i64::from(position.counts());
        let start = i64::from(plan.start.counts());
        let target = start << FRACTION;
        let here = x << FRACTION;
        let first = self.reference.is_none();
        // Between handle and start; one that the handle has passed is taken along.
        let mut reference =
            self.reference.unwrap_or(here).max(here.min(target)).min(here.max(target));
        let step = between(target - reference, plan.step);
        // It waits for a handle that is held.
        if (reference + step - here).abs() >> FRACTION <= i64::from(plan.lead) {
            reference += step;
            self.planned += step;
        }
        self.reference = Some(reference);
        let ahead = (self.planned >> FRACTION) - x;
        if first {
            (self.rest, self.past) = ((position, 0), [ahead; SPAN]);
        }
        if self.left == 0 {
            self.left = plan.pace;
            self.widened = ahead - self.past.last().copied().unwrap_or(ahead);
            self.past.copy_within(..SPAN - 1, 1);
            if let Some(newest) = self.past.first_mut() {
                *newest = ahead;
            }
        }
        self.left -= 1;
        let [error, widened] = [(reference >> FRACTION) - x, self.widened].map(|counts| {
            i32::try_from(counts).unwrap_or(if counts < 0 { i32::MIN } else { i32::MAX })
        });
        let limit = plan.limit;
        // each product within +-2^61
        let spring = plan.stiffness.apply(error);
        let integral = between(self.integral + plan.integral.apply(error), limit);
        // It does not wind up against a hand: beyond the limit it only gets smaller.
        let more = spring.saturating_add(integral);
        if more.abs() <= limit || integral.abs() < self.integral.abs() {
            self.integral = integral;
        }
        let soft = spring.saturating_add(plan.damping.apply(widened));
        let mut force = between(soft.saturating_add(self.integral), limit);
        if contact {
            (force, self.integral) = (force.min(0), self.integral.min(0));
        }
        self.outputs = self.outputs.saturating_add(1);
        if self.has_arrived(position, reference == target) {
            return ReturnStep::Arrived;
        }
        if self.outputs > plan.timeout_outputs {
            return ReturnStep::TooLong;
        }
        // within the limit, which is at most half of full scale
        ReturnStep::Push(Force::saturating_from_bits(i32::try_from(force).unwrap_or_default()))
    }

    /// Near the start, and no further than half the tolerance from where it was all the time.
    fn has_arrived(&mut self, position: Position, at_end: bool) -> bool {
        let tolerance = self.plan.tolerance;
        let (anchor, outputs) = self.rest;
        let still = position.wrapping_since(anchor).unsigned_abs() <= tolerance / 2;
        self.rest = if still { (anchor, outputs.saturating_add(1)) } else { (position, 0) };
        let near = position.wrapping_since(self.plan.start).unsigned_abs() <= tolerance;
        at_end && near && self.rest.1 >= self.plan.rest_outputs
    }
}

/// `value` within +-`limit`; unlike `clamp` without a way to panic.
fn between(value: i64, limit: i64) -> i64 {
    value.max(-limit).min(limit)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub use crate::design::tests::DESIGN;
    pub const SETTINGS: ReturnSettings = ReturnSettings::SOFT;

    /// A handle on a spring to `rest_m`.
    pub struct Handle {
        pub mass_kg: f64,
        pub damping: f64,
        pub spring: f64,
        pub rest_m: f64,
        pub x: f64,
        pub v: f64,
    }

    impl Handle {
        /// The paper's, at `x`.
        pub fn at(x: f64) -> Self {
            Self { mass_kg: 0.416, damping: 5.5195, spring: 11.0626, rest_m: 0.0517, x, v: 0.0 }
        }

        pub fn position(&self) -> Position {
            #[expect(clippy::cast_possible_truncation, reason = "a metre at most")]
            Position::from_counts((self.x / 1e-6).floor() as i32)
        }

        /// One output period with that force.
        pub fn go(&mut self, force: Force) {
            for _ in 0..10 {
                let force = f64::from(force.bits()) / 2f64.powi(30) * DESIGN.full_scale_n;
                let spring = self.spring * (self.x - self.rest_m);
                self.v += (force - spring - self.damping * self.v) / self.mass_kg * 1e-4;
                self.x += self.v * 1e-4;
            }
        }
    }

    /// How it ended, after how many outputs, the highest speed, the largest force (fraction).
    fn bring_back(mut handle: Handle, held: bool) -> (ReturnStep, u32, f64, f64) {
        let mut back = Return::new(SETTINGS.build(&DESIGN).unwrap());
        let (mut fastest, mut strongest) = (0f64, 0f64);
        for outputs in 0.. {
            match back.output(handle.position(), false) {
                ReturnStep::Push(force) => {
                    strongest = strongest.max(f64::from(force.bits()).abs() / 2f64.powi(30));
                    if !held {
                        handle.go(force);
                    }
                }
                end => {
                    assert!(end == ReturnStep::TooLong || handle.x.abs() < 6e-5, "{}", handle.x);
                    return (end, outputs, fastest, strongest);
                }
            }
            fastest = fastest.max(handle.v.abs());
        }
        unreachable!()
    }

    #[test]
    fn it_comes_back_slowly_from_either_side_and_from_the_start_itself() {
        let starts: &[f64] = if cfg!(miri) { &[-0.01] } else { &[0.07, 0.0517, 0.01, 0.0, -0.03] };
        for &from_m in starts {
            let (end, outputs, fastest, strongest) = bring_back(Handle::at(from_m), false);
            assert_eq!(end, ReturnStep::Arrived, "{from_m}");
            assert!(outputs < 2_000, "{from_m}: {outputs}");
            assert!(fastest < 0.25, "{from_m}: {fastest}");
            assert!(strongest <= 1.4 / 5.906 + 1e-9);
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "six returns in closed loop")]
    fn light_heavy_and_undamped_handles_come_back_as_well() {
        for mass_kg in [0.05, 0.4, 2.0] {
            for (damping, spring) in [(0.5, 0.0), (5.0, 11.0)] {
                let handle = Handle { mass_kg, damping, spring, ..Handle::at(0.07) };
                let (end, outputs, fastest, _) = bring_back(handle, false);
                assert_eq!(end, ReturnStep::Arrived, "{mass_kg} {damping}");
                assert!(outputs < 4_000 && fastest < 0.3, "{mass_kg} {outputs} {fastest}");
            }
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "10 s in steps of 1 ms")]
    fn a_handle_that_is_held_ends_it_and_never_feels_more_than_the_limit() {
        let (end, outputs, _, strongest) = bring_back(Handle::at(0.05), true);
        assert_eq!((end, outputs), (ReturnStep::TooLong, 10_000));
        assert!(strongest <= 1.4 / 5.906 + 1e-9);
    }

    /// A hand that brings the handle to the start faster than the return would, holds it there for a moment or not,
    /// and lets go: it stays there, but for what its own spring moves it by.
    #[test]
    #[cfg_attr(miri, ignore = "returns in closed loop")]
    fn a_handle_that_a_hand_has_brought_to_the_start_is_not_driven_away() {
        for (mass_kg, spring) in [(0.416, 0.0), (0.05, 0.0), (0.416, 11.0626)] {
            for (from_m, to_m) in [(0.05, 0.0), (-0.03, 0.0), (0.05, 0.005)] {
                for (outputs, wait) in [(100, 0), (500, 0), (100, 15), (500, 300)] {
                    let mut handle = Handle { mass_kg, spring, ..Handle::at(from_m) };
                    let mut back = Return::new(SETTINGS.build(&DESIGN).unwrap());
                    let (mut farthest, mut fastest, mut arrived) = (0f64, 0f64, false);
                    for n in 0..6_000 {
                        let ReturnStep::Push(force) = back.output(handle.position(), false) else {
                            arrived = true;
                            break;
                        };
                        if n < outputs + wait {
                            let part = f64::from(n.min(outputs)) / f64::from(outputs);
                            (handle.x, handle.v) = (from_m + (to_m - from_m) * part, 0.0);
                            continue;
                        }
                        handle.go(force);
                        farthest = farthest.max(handle.x.abs() - to_m);
                        fastest = fastest.max(handle.v.abs());
                    }
                    let case = std::format!(
                        "{mass_kg} kg, {spring} N/m, {from_m} to {to_m} m, {outputs} + {wait}"
                    );
                    assert!(arrived, "{case}");
                    let sag = 2.5e-3 * spring / 11.0626;
                    // for eight outputs the brake still sees the speed of the hand
                    assert!(farthest < 1.5e-3 + sag, "{case}: {farthest} m away");
                    assert!(fastest < 0.25, "{case}: {fastest} m/s");
                }
            }
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "returns in closed loop")]
    fn a_return_that_is_taken_starts_and_one_that_cannot_start_is_refused_with_the_range() {
        let stiff = |stiffness_n_per_m| ReturnSettings { stiffness_n_per_m, ..SETTINGS };
        let error = stiff(9_400.0).build(&DESIGN).unwrap_err();
        assert_eq!(error.parameter, "return_stiffness_n_per_m");
        let most = *error.range.end();
        assert!((9_300.0..9_334.0).contains(&most), "{error}");
        for settings in
            [stiff(most), ReturnSettings { force_n: 0.006, speed_m_per_s: 0.01, ..stiff(600.0) }]
        {
            for resolution_m in [1e-6, 7.3e-6, 1e-7] {
                let design = Design { resolution_m, ..DESIGN };
                let settings = ReturnSettings { tolerance_m: 5e-5, ..settings };
                let mut back = Return::new(settings.build(&design).unwrap());
                #[expect(clippy::cast_possible_truncation, reason = "half a metre")]
                let at = Position::from_counts((0.05 / resolution_m) as i32);
                let moved = (0..20).any(|_| {
                    matches!(back.output(at, false), ReturnStep::Push(force) if force.bits() < 0)
                });
                assert!(moved, "{settings:?} {resolution_m}");
            }
        }
    }

    /// A step that is a whole number of counts but for its rounding up fits a lead of as many, on either side.
    #[test]
    fn a_step_as_long_as_the_lead_is_taken_on_either_side() {
        let full_scale_n = 2.189_657_517_033_622;
        let design =
            Design { rate_hz: 5e4, resolution_m: 1e-8, full_scale_n, period: 42, ..DESIGN };
        let settings = ReturnSettings {
            speed_m_per_s: 1.0,
            force_n: 1e-3 * full_scale_n,
            stiffness_n_per_m: 2.606_735_139_325_740_7,
            ..SETTINGS
        };
        for at in [-1_000_000, 1_000_000] {
            let mut back = Return::new(settings.build(&design).unwrap());
            let step = back.output(Position::from_counts(at), false);
            assert!(
                matches!(step, ReturnStep::Push(force) if force.bits() * at.signum() < 0),
                "{step:?} at {at}"
            );
        }
    }

    #[test]
    fn in_the_wall_it_only_pulls_out() {
        let mut back = Return::new(SETTINGS.build(&DESIGN).unwrap());
        for _ in 0..100 {
            let ReturnStep::Push(force) = back.output(Position::from_counts(-20_000), true) else {
                panic!("it is not back yet");
            };
            assert!(force.bits() <= 0, "{force:?}");
        }
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let named = |settings: ReturnSettings| settings.build(&DESIGN).unwrap_err().parameter;
        let base = SETTINGS;
        assert_eq!(named(ReturnSettings { force_n: 3.0, ..base }), "return_force_n");
        assert_eq!(named(ReturnSettings { start_m: f64::NAN, ..base }), "start_m");
        assert_eq!(named(ReturnSettings { tolerance_m: 1e-6, ..base }), "return_tolerance_m");
        assert_eq!(named(ReturnSettings { speed_m_per_s: 0.0, ..base }), "return_speed_m_per_s");
    }
}
