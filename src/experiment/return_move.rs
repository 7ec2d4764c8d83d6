//! The return move brings the handle slowly to the start between two hits, by a soft spring. The far end of the spring
//! moves to the start at a limited speed.
//!
//! ```text
//! r     moves from the handle to the start, by at most `speed`, while r is within `lead` of x;
//!       never farther from the start than x is: a handle that is brought on by a hand takes r along
//! e     = r - x                                points to the start until the handle is past it
//! v     = speed of r, at most `speed`
//! force = clamp(K e + I + B (v - x'), +-limit)    I gathers Ki e while K e + I is within +-limit
//! ```
//!
//! **It moves only towards its start.** Until the handle has passed the start, spring and integral never point away
//! from the start, whoever moves the handle. Only the damper may point away from the start: it brakes a handle that is
//! faster than `speed`. So the force accelerates no handle beyond `speed + limit / B`.
//!
//! **Every accepted return can start**: a step of r is within the lead. Otherwise the spring's first step would need
//! more than `limit`.
//!
//! The speed is measured over the last eight milliseconds, without the estimator, so a return works with any cutoff.
//! The integral finds the force that holds the handle at the start, against a spring or its weight. A hand that holds
//! the handle on the way does not wind up the integral. In contact the force only points out of the wall.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::{
    Design, Gain,
    range::{SettingsError, within},
    safety::sum,
    units::{Force, Position},
};

/// Time over which the speed is measured, in milliseconds. If outputs are more than 1 ms apart, it is this number of
/// outputs.
const SPAN: usize = 8;
/// Time for which the handle must rest at the start, in s.
const REST_S: f64 = 0.02;
/// Fractional bits of the reference r, which moves to the start.
const FRACTION: u32 = 16;

/// Settings of the return move, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReturnSettings {
    /// Start of a hit, in m.
    pub start_m: f64,
    /// Speed of the reference, in m/s. It is 0.001 to 1.
    pub speed_m_per_s: f64,
    /// Largest force, in N. It is at most half of full scale.
    pub force_n: f64,
    /// Stiffness of the soft spring, in N/m.
    pub stiffness_n_per_m: f64,
    /// Damping of the return, in N s/m.
    pub damping_n_s_per_m: f64,
    /// Integral gain, in N/(m s).
    pub integral_n_per_m_s: f64,
    /// Largest distance from the start that counts as arrived, in m.
    pub tolerance_m: f64,
    /// Longest time of the return, in s. It is 0.1 to 60.
    pub timeout_s: f64,
}

/// The return in counts, outputs and fractions of full scale.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub struct ReturnPlan {
    start: Position,
    /// Step of the reference r at each output, in counts with 16 fractional bits.
    step: i64,
    /// Largest distance of the reference from the handle, in counts.
    lead: i32,
    limit: i64,
    /// Force in LSB per count of e.
    stiffness: Gain,
    /// Force of the damper, in LSB per count. The counts are the change of e over [`SPAN`] * `pace` outputs.
    damping: Gain,
    /// Number of outputs from one measurement of the speed to the next.
    pace: u32,
    /// Force in LSB that the integral gathers at each output, per count of e.
    integral: Gain,
    tolerance: u32,
    rest_outputs: u32,
    timeout_outputs: u32,
}

#[cfg(test)]
impl ReturnPlan {
    /// Flips a bit of the largest force.
    pub(crate) fn spoil(&mut self) {
        self.limit ^= 1 << 29;
    }
}

impl ReturnSettings {
    /// Settings of a return move that a hand can easily stop. They were tuned on the paper's device and on handles of
    /// 0.05 to 2 kg. See the tests.
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

    /// Checks and converts the settings.
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
        // With a stiffer spring the first step of r would be longer than the lead, and the return could not begin.
        let stiffest = f64::min(1e4, self.force_n * outputs_per_s / self.speed_m_per_s);
        within("return_stiffness_n_per_m", self.stiffness_n_per_m, 1.0..=stiffest)?;
        within("return_damping_n_s_per_m", self.damping_n_s_per_m, 0.0..=1e3)?;
        within("return_integral_n_per_m_s", self.integral_n_per_m_s, 0.0..=1e5)?;
        within("return_timeout_s", self.timeout_s, 0.1..=60.0)?;
        let counts = |metres: f64| metres / design.resolution_m;
        // At most 2^20 counts, so that products with the gains stay far from the ends of the range.
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
    /// Position where the return ends.
    pub fn start(&self) -> Position {
        self.start
    }

    /// Largest force of the return.
    pub fn force(&self) -> Force {
        Force::saturating_from_bits(i32::try_from(self.limit).unwrap_or(i32::MAX))
    }
}

/// Result of one output of a return.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReturnStep {
    /// The return continues, with this force.
    Push(Force),
    /// The handle rests at the start.
    Arrived,
    /// The return took too long: the handle is held, or something is in its way.
    TooLong,
}

/// A return in progress.
#[derive(Clone, Copy, Debug, Default)]
pub struct Return {
    /// Position of the reference r, in counts with 16 fractional bits. It is `None` before the first output.
    reference: Option<i64>,
    integral: i64,
    /// Distance that r has moved by its own steps, in counts with 16 fractional bits. The handle may have taken r along
    /// in addition.
    planned: i64,
    /// The last distances from the handle to `planned`, in counts, one for each millisecond. `oldest` is the index of
    /// the oldest one.
    past: [i64; SPAN],
    oldest: usize,
    /// Change of the distance from the oldest to the newest value in `past`, in counts. `left` is the number of outputs
    /// until the next measurement.
    widened: i64,
    left: u32,
    /// Position at which the handle rests, and the number of outputs for which it has stayed there, within half the
    /// tolerance.
    rest: (Position, u32),
    outputs: u32,
}

impl Return {
    /// A sum of the numbers that decide about the force for longer than one measurement of the speed.
    #[inline(always)]
    pub(super) fn sum(&self) -> u32 {
        sum(&(self.reference.unwrap_or(i64::MIN), self.integral, self.planned))
    }

    /// Flips a bit of the reference.
    #[cfg(test)]
    pub(super) fn spoil(&mut self) {
        self.reference = self.reference.map(|reference| reference ^ 1 << 40);
    }

    /// Begins a new return move. Its first output is still to come.
    #[inline(always)]
    pub fn restart(&mut self) {
        // The first output sets all other fields. The fields are set one by one, so that nothing is copied.
        (self.reference, self.integral, self.planned) = (None, 0, 0);
        (self.widened, self.left, self.outputs) = (0, 0, 0);
    }

    /// Computes the force for this output. `plan` must be the same at each output of a return. `contact` says whether
    /// the handle is inside the wall.
    pub fn output(&mut self, plan: &ReturnPlan, position: Position, contact: bool) -> ReturnStep {
        let x = i64::from(position.counts());
        let start = i64::from(plan.start.counts());
        let target = start << FRACTION;
        let here = x << FRACTION;
        let first = self.reference.is_none();
        // The reference lies between handle and start. If the handle overtakes it, the reference moves along.
        let mut reference =
            self.reference.unwrap_or(here).max(here.min(target)).min(here.max(target));
        let step = between(target - reference, plan.step);
        // The reference waits for a handle that is held.
        if (reference + step - here).abs() >> FRACTION <= i64::from(plan.lead) {
            reference += step;
            self.planned += step;
        }
        self.reference = Some(reference);
        let ahead = (self.planned >> FRACTION) - x;
        if first {
            (self.rest, self.past) = ((position, 0), [ahead; SPAN]);
        }
        // It is above the pace only after a flipped bit.
        if self.left == 0 || self.left > plan.pace {
            self.left = plan.pace;
            let at = self.oldest % SPAN;
            self.widened = ahead - core::mem::replace(&mut self.past[at], ahead);
            self.oldest = at + 1;
        }
        self.left -= 1;
        let [error, widened] = [(reference >> FRACTION) - x, self.widened].map(|counts| {
            i32::try_from(counts).unwrap_or(if counts < 0 { i32::MIN } else { i32::MAX })
        });
        let limit = plan.limit;
        // Each product with a gain is within +-2^61, so the sum cannot overflow.
        let spring = plan.stiffness.apply(error);
        let integral = between(self.integral + plan.integral.apply(error), limit);
        // The integral does not wind up against a hand: beyond the limit it only gets smaller.
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
        if self.has_arrived(plan, position, reference == target) {
            return ReturnStep::Arrived;
        }
        if self.outputs > plan.timeout_outputs {
            return ReturnStep::TooLong;
        }
        // The force is within the limit, which is at most half of full scale. So nothing is cut off here.
        ReturnStep::Push(Force::saturating_from_bits(i32::try_from(force).unwrap_or_default()))
    }

    /// Whether the handle is near the start and rests. It rests if it has stayed within half the tolerance of one
    /// position for [`REST_S`].
    fn has_arrived(&mut self, plan: &ReturnPlan, position: Position, at_end: bool) -> bool {
        let tolerance = plan.tolerance;
        let (anchor, outputs) = self.rest;
        let still = position.wrapping_since(anchor).unsigned_abs() <= tolerance / 2;
        self.rest = if still { (anchor, outputs.saturating_add(1)) } else { (position, 0) };
        let near = position.wrapping_since(plan.start).unsigned_abs() <= tolerance;
        at_end && near && self.rest.1 >= plan.rest_outputs
    }
}

/// Limits `value` to +-`limit`. Unlike `clamp`, this code cannot panic.
fn between(value: i64, limit: i64) -> i64 {
    value.max(-limit).min(limit)
}

#[cfg(test)]
pub(crate) mod tests;
