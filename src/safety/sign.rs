//! The sign test. A small force must move the count the right way. If it moved the count the wrong way, the wall would
//! pull.
//!
//! The handle may drift, hang from a spring or touch a stop. So the test has four quarters of equal length. In the
//! first quarter the force acts away from the wall, in the next two towards the wall, and in the last away again. The
//! result is the fourth difference of the count. A steady speed, a steady outside force and a steadily changing outside
//! force cancel in this difference. The handle ends at its first position, with its first speed.
//!
//! ```text
//! count      x0      x1      x2      x3      x4
//! force          -f      +f      +f      -f
//! answer = -(x0 - 4 x1 + 6 x2 - 4 x3 + x4)  =  2 f h^2 / m           (h a quarter, m the mass)
//! ```
//!
//! Quantisation changes the result by less than 8 counts. If the handle cannot move, or its encoder is dead, the result
//! is 0, and the test fails.

#![deny(clippy::float_arithmetic)]

use super::SafetyPlan;
use crate::units::{Force, Position};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SignTest {
    outputs: u32,
    /// Positions at the beginning of the test and at the end of each quarter.
    marks: [Position; 5],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SignStep {
    /// The test continues, with this force.
    Push(Force),
    Passed,
    Failed,
}

impl SignTest {
    /// Makes a test whose first output is still to come.
    pub fn new() -> Self {
        Self { outputs: 0, marks: [Position::default(); 5] }
    }

    /// Takes the count at an output. After four quarters of `plan.sign_quarter` outputs it returns the result.
    pub fn step(&mut self, plan: &SafetyPlan, position: Position) -> SignStep {
        let quarter = self.outputs / plan.sign_quarter.max(1);
        let start = self.outputs.is_multiple_of(plan.sign_quarter.max(1));
        if start
            && let Some(mark) = usize::try_from(quarter).ok().and_then(|n| self.marks.get_mut(n))
        {
            *mark = position;
        }
        let between = self.outputs - quarter * plan.sign_quarter.max(1) < plan.per_ms;
        self.outputs = self.outputs.saturating_add(1);
        match quarter {
            // The force changes from -f to +f and back in two steps, a millisecond apart. Each step is at most 5 % of
            // full scale.
            1 | 3 if between => SignStep::Push(Force::ZERO),
            0 | 3 => SignStep::Push(Force::saturating_from_bits(-plan.sign_force.bits())),
            1 | 2 => SignStep::Push(plan.sign_force),
            _ if self.answer() >= i64::from(plan.sign_counts) => SignStep::Passed,
            _ => SignStep::Failed,
        }
    }

    fn answer(&self) -> i64 {
        let [x0, x1, x2, x3, x4] = self.marks;
        let [x1, x2, x3, x4] = [x1, x2, x3, x4].map(|x| i64::from(x.wrapping_since(x0)));
        4 * x1 - 6 * x2 + 4 * x3 - x4
    }
}

#[cfg(test)]
#[expect(clippy::float_arithmetic, clippy::cast_possible_truncation, reason = "a plant in floats")]
mod tests {
    use super::*;
    use crate::safety::plan::tests::{DESIGN, SETTINGS};

    /// A handle of 0.4 kg with 5.5 N s/m, on a motor of 5.9 N. Outputs come at 1 kHz, and a count is 1 um.
    struct Handle {
        position_m: f64,
        velocity_m_per_s: f64,
        /// Steady force from outside, in N.
        load_n: f64,
        /// The sign of the motor times the sign of the encoder. With 0 the handle cannot move.
        sign: f64,
        stop_m: f64,
    }

    const HANDLE: Handle =
        Handle { position_m: 0.0, velocity_m_per_s: 0.0, load_n: 0.0, sign: 1.0, stop_m: -1.0 };

    /// Runs a test. Returns its result, and the number of outputs with a force.
    fn test(mut handle: Handle) -> (SignStep, u32) {
        let plan = SETTINGS.build(&DESIGN).unwrap();
        let mut test = SignTest::new();
        for outputs in 0.. {
            let count = (handle.position_m / 1e-6).floor() as i32;
            let step = test.step(&plan, Position::from_counts(count));
            let SignStep::Push(force) = step else {
                return (step, outputs);
            };
            assert!(force.bits().abs() <= (1 << 30) / 20);
            let drive = f64::from(force.bits()) / 2f64.powi(30) * 5.9 * handle.sign;
            let acceleration = (drive + handle.load_n - 5.5 * handle.velocity_m_per_s) / 0.4;
            handle.velocity_m_per_s += acceleration * 1e-3;
            handle.position_m += handle.velocity_m_per_s * 1e-3;
            if handle.position_m < handle.stop_m {
                (handle.position_m, handle.velocity_m_per_s) = (handle.stop_m, 0.0);
            }
            if handle.sign == 0.0 {
                handle.position_m = 0.0;
            }
        }
        unreachable!()
    }

    #[test]
    fn the_right_sign_passes_within_100_ms() {
        let (step, outputs) = test(HANDLE);
        assert_eq!((step, outputs), (SignStep::Passed, 100));
    }

    #[test]
    fn drift_load_and_a_stop_on_either_side_do_not_deceive_it() {
        for sign in [1.0, -1.0] {
            let expected = if sign > 0.0 { SignStep::Passed } else { SignStep::Failed };
            for load_n in [-1.0, 0.0, 1.0] {
                for velocity_m_per_s in [-0.1, 0.0, 0.1] {
                    let handle = Handle { load_n, velocity_m_per_s, sign, ..HANDLE };
                    assert_eq!(test(handle).0, expected, "{sign} {load_n} {velocity_m_per_s}");
                }
            }
        }
        assert_eq!(test(Handle { stop_m: 0.0, ..HANDLE }).0, SignStep::Passed);
    }

    #[test]
    fn a_wrong_sign_and_a_dead_encoder_fail() {
        assert_eq!(test(Handle { sign: -1.0, ..HANDLE }).0, SignStep::Failed);
        assert_eq!(test(Handle { sign: 0.0, ..HANDLE }).0, SignStep::Failed);
    }
    /// The force acts out of the wall, into it for two quarters, and out again. Each change takes two steps, a
    /// millisecond apart, at every output period.
    #[test]
    fn the_force_goes_out_in_in_and_out_with_a_step_between() {
        for (period, per_ms, quarter) in [(10, 1, 25), (5, 2, 50), (1, 10, 250)] {
            let plan = SETTINGS.build(&crate::Design { period, ..DESIGN }).unwrap();
            let f = plan.sign_force.bits();
            let mut test = SignTest::new();
            for (n, force) in [-f, f, f, -f].into_iter().enumerate() {
                for output in 0..quarter {
                    let force = if n % 2 == 1 && output < per_ms { 0 } else { force };
                    let expected = SignStep::Push(Force::saturating_from_bits(force));
                    let step = test.step(&plan, Position::default());
                    assert_eq!(step, expected, "period {period} quarter {n} output {output}");
                }
            }
            assert_eq!(test.step(&plan, Position::default()), SignStep::Failed);
        }
    }
}
