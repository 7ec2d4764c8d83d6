//! Tests that low-passes, gains, wall, actuator and RMS cannot overflow, for all inputs at once. `fir.rs`, `kalman.rs`
//! and `observer.rs` have the same tests for their estimators. Levant's differentiator, adaptive windowing and time
//! stamps are only tested with random motion and random senses. Their arithmetic does not have the shape that is
//! described below. Levant's differentiator has a root. Adaptive windowing and time stamps have divisions, and windows
//! that depend on the data.
//!
//! Every intermediate of the arithmetic below is affine or monotone in each of its arguments alone (products, sums,
//! shifts, clamps). Each partial sum is affine or monotone in the same way. So the extremes over a box of arguments lie
//! at corners of the box. The tests run the core's own functions, with overflow checks on, at all corners of the boxes
//! that their callers can reach. If no corner overflows, no point of the box overflows. Coefficients are arguments like
//! any other, so one run covers every cutoff and rate.
//!
//! Kani would prove the same with a solver. Arithmetic of this shape needs no solver.

use std::vec::Vec;

use crate::{
    Gain, Output,
    actuator::Actuator,
    experiment::{RmsLimit, RunningVariance},
    units::{Demand, Force, Position, Velocity},
    velocity::{Biquad, BiquadState, ButterworthDesign, CUTOFF_MAX, CUTOFF_MIN, FirstOrder},
    wall::Wall,
};

/// All ways to choose one of two ends for each of `N` arguments.
pub(crate) fn corners<T: Copy, const N: usize>(ends: [[T; 2]; N]) -> impl Iterator<Item = [T; N]> {
    (0u32..1 << N).map(move |choice| core::array::from_fn(|n| ends[n][(choice >> n & 1) as usize]))
}

/// Boxes that contain the coefficients of all accepted low-passes. The low-passes have order 1 or 2, with and without
/// pre-warping. Each small range of the cutoff has its own box. With a single box for all cutoffs, the corners
/// would combine coefficients that never occur together.
fn coefficient_boxes() -> Vec<[[i32; 2]; 5]> {
    const BOXES: u32 = 64;
    /// Number of cutoffs that are computed in each range, including both ends. Between two neighbouring cutoffs every
    /// coefficient is monotone, or leaves the range of its two values by less than `MARGIN`.
    const LOOKS: u32 = 64;
    const MARGIN: i32 = 1 << 12;
    let cutoff = |n: u32| {
        let part = f64::from(n) / f64::from(BOXES * LOOKS);
        (CUTOFF_MIN * (CUTOFF_MAX / CUTOFF_MIN).powf(part)).clamp(CUTOFF_MIN, CUTOFF_MAX) * 1e4
    };
    let mut boxes = Vec::new();
    for first in (0..BOXES * LOOKS).step_by(LOOKS as usize) {
        for kind in 0..4 {
            let filters = (first..=first + LOOKS).filter_map(|n| {
                let prewarp = kind % 2 == 1;
                if kind < 2 {
                    ButterworthDesign::new(cutoff(n), 1e4, prewarp)
                        .ok()
                        .map(|design| design.quantise())
                } else {
                    FirstOrder::new(cutoff(n), 1e4, prewarp).ok().map(|design| design.quantise())
                }
            });
            let ends = filters.fold(None, |ends: Option<[[i32; 2]; 5]>, biquad| {
                let bits = biquad.bits();
                let ends = ends.unwrap_or(bits.map(|bits| [bits, bits]));
                Some(core::array::from_fn(|n| [ends[n][0].min(bits[n]), ends[n][1].max(bits[n])]))
            });
            boxes.extend(ends.map(|ends| {
                ends.map(|[low, high]| [low.saturating_sub(MARGIN), high.saturating_add(MARGIN)])
            }));
        }
    }
    boxes
}

const VELOCITY: [i32; 2] = [-(Velocity::LIMIT << 16), Velocity::LIMIT << 16];
const STATE: [i32; 2] = [i32::MIN, i32::MAX];
const RESIDUE: [i32; 2] = [-(1 << 29), (1 << 29) - 1];

/// Runs one step of a biquad at every corner of the box of coefficients, inputs, outputs and residues.
fn at_all_corners(coefficients: [[i32; 2]; 5]) {
    for bits in corners(coefficients) {
        for second in [0, -1] {
            let biquad = Biquad::from_bits(bits, second);
            let arguments = [VELOCITY, VELOCITY, VELOCITY, STATE, STATE, RESIDUE, RESIDUE];
            for [x0, x1, x2, y1, y2, e1, e2] in corners(arguments) {
                let mut state = BiquadState::from_bits([x1, x2], [y1, y2], [e1, e2]);
                let velocity = biquad.update(&mut state, Velocity::saturating_from_bits(x0));
                assert!((VELOCITY[0]..=VELOCITY[1]).contains(&velocity.bits()));
                let [e0, _] = state.residue();
                assert!((RESIDUE[0]..=RESIDUE[1]).contains(&e0), "{e0}");
            }
        }
    }
}

#[test]
#[cfg_attr(miri, ignore = "millions of corners")]
fn a_low_pass_never_overflows_whatever_the_cutoff_and_its_state() {
    let boxes = coefficient_boxes();
    assert!(boxes.len() > 200, "{}", boxes.len());
    for ends in boxes {
        at_all_corners(ends);
    }
}

/// The positive control. With coefficients beyond the accepted ones, the same test must find an overflow.
#[test]
#[cfg_attr(miri, ignore = "millions of corners")]
#[should_panic(expected = "overflow")]
fn coefficients_at_the_ends_of_their_format_would_overflow() {
    at_all_corners([[i32::MIN, i32::MAX]; 5]);
}

#[test]
#[cfg_attr(miri, ignore = "millions of corners")]
fn products_walls_and_codes_never_overflow() {
    let mut gains = Vec::from([Gain::default()]);
    for shift in Gain::SHIFTS {
        gains.extend([1 << 30, i32::MAX].map(|mantissa| Gain::from_parts(mantissa, shift)));
    }
    let counts = [i32::MIN, -(1 << 30), -1, 0, 1, 1 << 30, i32::MAX];
    for &stiffness in &gains {
        for &value in &counts {
            assert!(stiffness.apply(value).unsigned_abs() <= Gain::PRODUCT_LIMIT.unsigned_abs());
        }
        for &damping in &gains {
            for push_only in [false, true] {
                for [surface, position] in corners([[i32::MIN, i32::MAX]; 2]) {
                    let surface = Position::from_counts(surface);
                    let wall = Wall { surface, stiffness, damping, push_only };
                    for velocity in VELOCITY {
                        let velocity = Velocity::saturating_from_bits(velocity);
                        let demand = wall.demand(Position::from_counts(position), velocity);
                        for push in [i32::MIN, 0, i32::MAX] {
                            let push = Force::saturating_from_bits(push);
                            let (force, _) = demand.against(push).saturate();
                            assert!(force.bits().abs() <= Force::FULL_SCALE.bits());
                        }
                    }
                }
            }
        }
    }
    for bits in [i64::MIN, i64::MAX] {
        let _ = Demand::from_bits(bits).against(Force::FULL_SCALE).saturate();
    }
    for output in [
        Output::Continuous,
        Output::Dac { bits: 2 },
        Output::Dac { bits: 24 },
        Output::Pwm { steps: 2 },
        Output::Pwm { steps: 1 << 24 },
    ] {
        let actuator = Actuator::new(output).unwrap();
        for force in [i32::MIN, 0, i32::MAX] {
            let _ = actuator.command(Force::saturating_from_bits(force));
        }
    }
}

/// The sums of an RMS at their largest: 2^24 samples, each 2^31 counts from the first sample. The test sets the sums
/// directly. No sample can add more to the sum or to the sum of squares.
#[test]
fn the_sums_of_a_hit_hold_its_longest_window() {
    let mut scatter = RunningVariance::at_its_widest(1 << 24);
    for position in [i32::MIN, i32::MAX] {
        scatter.push(Position::from_counts(position));
        for limit in [0, u32::MAX] {
            let limit = RmsLimit::from_bits(limit);
            let _ = (scatter.is_below(limit), scatter.must_reach(limit, 1 << 24));
        }
        assert!(scatter.rms_counts().is_finite() && scatter.mean_counts().is_finite());
    }
}
