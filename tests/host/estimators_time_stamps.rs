//! Tests the documented properties of the estimator `time-stamps`, and the edges that a scene gives it.

use std::f64::consts::PI;

use host_sim::simulation::edge::last_edge;
use proptest::prelude::*;
use zwidth::{VelocitySettings, units::Velocity, velocity::SPAN_MAX};

use crate::estimator_bench::{
    DESIGN, LSB, Motion, after_nonsense, hits_a_wall_like_its_twin, nonsense,
    reads_zero_after_a_stop, sines, twin_is_off_by,
};

const MASS_KG: f64 = 0.416;
/// Number of samples without an edge after which the velocity is 0. A few samples are added as a reserve.
const STANDSTILL: i64 = 33_000;
const SPANS: [u32; 5] = [1, 2, 8, 16, SPAN_MAX];

fn stamps(span_samples: u32) -> VelocitySettings {
    VelocitySettings::TimeStamps { span_samples }
}

#[test]
fn constant_speed_is_measured_within_the_error_of_an_age() {
    for span in SPANS {
        for speed in [0, 1, -7, 300, -32_767] {
            let mut motion = Motion::new(stamps(span), |t| f64::from(speed) * t);
            for _ in 0..200 {
                motion.free();
            }
            // An age is rounded down to 2^-16 samples.
            let limit = f64::from(speed).abs() / (f64::from(span) - 0.5) + 0.5;
            for _ in 0..300 {
                let off = (motion.free().core - f64::from(speed)).abs() * LSB;
                assert!(off <= limit, "{span} at {speed}: {off} LSB");
            }
        }
        // Even with fractions of a count per sample there is no ripple.
        let mut motion = Motion::new(stamps(span), |t| 0.618_033_988_75 * t);
        for n in 0..20_000 {
            let off = (motion.free().core - 0.618_033_988_75).abs() * LSB;
            assert!(n < 200 || off <= 1.2, "{span}: {off} LSB");
        }
    }
}

#[test]
fn a_handle_that_stops_reads_exactly_zero() {
    for span in SPANS {
        reads_zero_after_a_stop(&stamps(span), STANDSTILL);
    }
}

/// Expected delay of a sine, in samples. It follows from the estimator's definition, if each sample has edges.
///
/// The mean m over the span is late by half the span. The mean may exceed the speed v, if the handle slows down or has
/// just reversed. Then the limit `1 / age` reduces the mean. With ages uniform over 0 .. 1 / v the mean output is
/// `v (1 + ln(m / v))`, with the sign of m.
fn expected_delay(span: u32, w: f64) -> f64 {
    const POINTS: u32 = 100_000;
    let half = w * f64::from(span) / 2.0;
    let (mut real, mut imaginary) = (0.0, 0.0);
    for n in 0..POINTS {
        let phase = 2.0 * PI * (f64::from(n) + 0.5) / f64::from(POINTS);
        let (v, m) = (phase.cos(), half.sin() / half * (phase - half).cos());
        let cut = v.abs() * (1.0 + (m / v).abs().ln());
        let output = if m.abs() > v.abs() { cut.copysign(m) } else { m };
        real += output * phase.cos();
        imaginary += output * phase.sin();
    }
    imaginary.atan2(real) / w
}

#[test]
fn the_delay_of_a_sine_is_that_of_mean_and_bound() {
    const AMPLITUDE: f64 = 20_000.0;
    let mut least = f64::INFINITY;
    for span in [1, 8, 32] {
        for hz in [10.0, 20.0, 40.0, 80.0] {
            let w = 2.0 * PI * hz / DESIGN.rate_hz;
            let period = (DESIGN.rate_hz / hz) as i64;
            let mut motion = Motion::new(stamps(span), |t| AMPLITUDE * (w * t).sin());
            for _ in 0..period {
                motion.free();
            }
            let (mut real, mut imaginary) = (0.0, 0.0);
            for _ in 0..10 * period {
                let seen = motion.free().core;
                let phase = w * motion.sample as f64;
                real += seen * phase.cos();
                imaginary -= seen * phase.sin();
            }
            let (delay, expected) = (-imaginary.atan2(real) / w, expected_delay(span, w));
            println!("span {span}, {hz} Hz: {delay:.3} samples, expected {expected:.3}");
            // Near a reversal, below one count per sample, not every sample has an edge.
            let limit = 0.04 + 0.015 * f64::from(span);
            assert!((delay - expected).abs() < limit, "{span} {hz}: {delay} {expected}");
            least = least.min(delay / (0.5 * f64::from(span)));
        }
    }
    assert!(least < 0.87, "the bound must show");
}

/// If edges are rarer than the span, the output keeps the mean of the last period between edges. Under a constant
/// acceleration the delay is exactly half the period plus the age of the edge.
#[test]
fn the_delay_of_a_slow_motion_is_half_a_period_and_the_age_of_the_edge() {
    let (v0, a) = (0.02, 2e-5);
    let place = |t: f64| v0 * t + 0.5 * a * t * t;
    // Time at which the motion reaches a count.
    let at = |count: f64| ((v0 * v0 + 2.0 * a * count).sqrt() - v0) / a;
    let mut motion = Motion::new(stamps(2), place);
    let mut checked = 0;
    for n in 1..3000 {
        let seen = motion.free().core;
        let now = f64::from(n);
        let count = place(now).floor();
        if count < 3.0 {
            continue;
        }
        let [edge, before] = [at(count), at(count - 1.0)];
        let (period, age) = (edge - before, now - edge);
        let late = 0.5 * period + age;
        let expected = v0 + a * (now - late);
        assert!((seen - expected).abs() * LSB < 2.0, "{n}: {seen} {expected}");
        checked += 1;
    }
    assert!(checked > 2500);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn the_core_follows_its_twin(which in 0..5usize, steps in sines(), speed in 0.001..300.0f64) {
        let (worst, _) = twin_is_off_by(&stamps(SPANS[which]), &steps, speed);
        prop_assert!(worst <= 1.0, "{}: {worst} LSB", SPANS[which]);
    }

    #[test]
    fn nothing_overflows_and_every_speed_stays_in_range(which in 0..5usize, any in nonsense()) {
        let last = after_nonsense(&stamps(SPANS[which]), &any, STANDSTILL);
        prop_assert_eq!(last, Velocity::ZERO);
    }
}

#[test]
fn spans_out_of_range_are_refused_by_name() {
    for span in [0, 63] {
        assert_eq!(stamps(span).build(&DESIGN).unwrap_err().parameter, "span_samples");
    }
}

/// A simulated scene takes its edges from a cubic polynomial between two samples. The test compares these edges with
/// the motion itself.
#[test]
fn edges_of_a_simulated_motion_are_where_the_motion_crosses() {
    // The handle reverses within a sample, over an edge and back. The edge is then the return crossing.
    assert_eq!(
        last_edge([0.5, 3.0], [0.5, -3.0]).map(|(at, up)| (at > 0.5, up)),
        Some((true, false))
    );
    assert_eq!(last_edge([0.5, 1.0], [0.5, -1.0]), None, "a turn within the cell");
    let (at, up) = last_edge([0.25, 1.5], [1.75, 1.5]).unwrap();
    assert!((at - 0.5).abs() < 1e-9 && up);
    let (at, up) = last_edge([1.75, -2.5], [-0.75, -2.5]).unwrap();
    assert!((at - 0.7).abs() < 1e-9 && !up);
    // A force that steps by the full range of the paper's device within the sample.
    let step = 2.0 * DESIGN.full_scale_n / MASS_KG / 1e-6 / 1e8; // counts / sample^2
    let mut worst = 0.0f64;
    for split in [0.1, 0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0, 0.75, 0.9] {
        for offset in 0..100 {
            let start = 0.001 + 0.01 * f64::from(offset);
            let at = |t: f64| start + t + 0.5 * step * (t - split).max(0.0).powi(2);
            let end = [at(1.0), 1.0 + step * (1.0 - split)];
            let (edge, up) = last_edge([start, 1.0], end).unwrap();
            assert!(up);
            worst = worst.max((at(edge) - end[0].floor()).abs());
        }
    }
    println!("edge off by {worst} counts");
    assert!(worst < 0.0186 * step, "{worst}");
}

#[test]
fn a_wall_is_hit_as_by_the_twin() {
    hits_a_wall_like_its_twin("estimator = \"time-stamps\"\nspan_samples = 4", 0.0, "");
}
