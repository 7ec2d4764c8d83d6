//! Computes Colgate and Schenkel's condition with its own formula. The tests compare it with
//! [`Passivity`](super::Passivity).

use core::f64::consts::PI;

use nalgebra::Complex;

use super::{
    super::{LinearError, TransferFunction, boundary::minimum, transfer::polynomial},
    PER_DECADE, PassivityDemand, STABLE_RADIUS,
};

/// Lowest frequency of the search, in radians per sample. At lower frequencies, every estimator that the core accepts
/// (poles above 1e-4) has the same value as at w = 0. The grid has w = 0 as a separate point.
const OMEGA_MIN: f64 = 1e-7;
/// Number of search points from 0 to pi.
const LINEAR: u32 = 512;

/// The damping that a device needs so that a wall with K in N/m and B in N s/m is passive at all frequencies. B may
/// have any sign. The value is infinite if the estimator has a pole on or outside the unit circle, because the
/// condition is not valid for this estimator.
///
/// # Errors
/// A number is not finite, the rate is not above 0, or the estimator is not usable.
pub(in super::super) fn demand(
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    rate_hz: f64,
    estimator: &TransferFunction,
) -> Result<PassivityDemand, LinearError> {
    for (name, value) in
        [("virtual stiffness", stiffness_n_per_m), ("virtual damping", damping_n_s_per_m)]
    {
        if !value.is_finite() {
            return Err(LinearError::OutOfRange { name, low: f64::MIN, high: f64::MAX });
        }
    }
    if !(rate_hz >= f64::MIN_POSITIVE && rate_hz.is_finite()) {
        return Err(LinearError::OutOfRange {
            name: "rate_hz",
            low: f64::MIN_POSITIVE,
            high: f64::MAX,
        });
    }
    estimator.check()?;
    if estimator.poles_beyond(STABLE_RADIUS) > 0 {
        return Ok(PassivityDemand { damping_n_s_per_m: f64::INFINITY, frequency_hz: 0.0 });
    }
    let sample_s = 1.0 / rate_hz;
    let one = Complex::new(1.0, 0.0);
    let dc = estimator.at(one).re;
    let slope = slope(estimator, dc);
    // The damping that a device needs because of B, at one frequency.
    let cost = |omega: f64| {
        let back = Complex::new(libm::cos(omega), -libm::sin(omega));
        let w = polynomial(&slope, back) / polynomial(&estimator.den, back);
        -damping_n_s_per_m * sample_s * (back * w).re
    };
    let omegas = grid();
    let costs: Vec<f64> = omegas.iter().map(|w| cost(*w)).collect();
    let (mut worst, mut at) = (f64::NEG_INFINITY, 0.0);
    let mut consider = |omega: f64, cost: f64| {
        if cost > worst {
            (worst, at) = (cost, omega);
        }
    };
    for i in 0..omegas.len() {
        consider(omegas[i], costs[i]);
        let peaks =
            i > 0 && i + 1 < omegas.len() && costs[i] >= costs[i - 1] && costs[i] >= costs[i + 1];
        if peaks && damping_n_s_per_m != 0.0 {
            let refined = minimum(|omega| -cost(omega), omegas[i - 1], omegas[i + 1]);
            consider(refined, cost(refined));
        }
    }
    let spring = 0.5 * sample_s * (stiffness_n_per_m + damping_n_s_per_m * dc);
    Ok(PassivityDemand {
        damping_n_s_per_m: spring + worst,
        frequency_hz: at / (2.0 * PI) * rate_hz,
    })
}

/// Numerator of W in `V = dc + (1 - z^-1) W`. W has the same denominator as V. Running sums divide by `1 - z^-1`.
fn slope(estimator: &TransferFunction, dc: f64) -> Vec<f64> {
    let mut sum = 0.0;
    let mut sums: Vec<f64> = (0..=estimator.order())
        .map(|i| {
            sum += estimator.num.get(i).unwrap_or(&0.0) - dc * estimator.den.get(i).unwrap_or(&0.0);
            sum
        })
        .collect();
    sums.pop(); // the remainder is 0 with a rounding error
    sums
}

/// The frequencies of the search in ascending order: 0, then points up to pi, both logarithmic and linear.
fn grid() -> Vec<f64> {
    let ratio = libm::pow(10.0, 1.0 / f64::from(PER_DECADE));
    let step = PI / f64::from(LINEAR);
    let mut omegas = vec![0.0];
    let mut omega = OMEGA_MIN;
    while omega < PI {
        omegas.push(omega);
        omega = (omega * ratio).min(omega + step);
    }
    omegas.push(PI);
    omegas
}

/// A golden section finds the maximum of a parabola to about 1e-16 of its height.
const PEAK_TOLERANCE: f64 = 1e-9;

fn damping(k: f64, b: f64, rate: f64, estimator: &TransferFunction) -> f64 {
    demand(k, b, rate, estimator).unwrap().damping_n_s_per_m
}

/// The condition as it was published, on a dense grid that leaves out w = 0, where the quotient is 0/0.
fn swept(k: f64, b: f64, rate: f64, estimator: &TransferFunction) -> f64 {
    let points = 200_000;
    (1..=points)
        .map(|i| {
            let w = PI * f64::from(i) / f64::from(points);
            let back = Complex::new(w.cos(), -w.sin());
            let c = estimator.at(back) * b + k;
            ((-back + 1.0) * c).re / (1.0 - w.cos()) * 0.5 / rate
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn maximum_is_at_least_that_of_a_dense_sweep() {
    // A narrow resonance lies between the points of any grid. The refinement finds its maximum.
    let (radius, angle) = (0.9995_f64, 0.7123_f64);
    let gain = 1e3 * (1.0 - radius);
    let resonant = TransferFunction {
        num: vec![gain, -gain],
        den: vec![1.0, -2.0 * radius * angle.cos(), radius * radius],
    };
    for estimator in [
        resonant,
        TransferFunction::paper(1e3, 50.0).unwrap(),
        TransferFunction::paper(1e3, 300.0).unwrap(),
    ] {
        for b in [-3.0, 5.0] {
            let (ours, sweep) =
                (damping(1000.0, b, 1e3, &estimator), swept(1000.0, b, 1e3, &estimator));
            // Near w = 0, cancellation in the published quotient causes an error of 1e-16 / w^2.
            assert!(
                ours >= sweep * (1.0 - 1e-6) && ours <= sweep * (1.0 + 1e-3),
                "{ours} against {sweep}"
            );
        }
    }
}

#[test]
fn limits_at_both_ends_are_taken() {
    // For the plain difference, the strictest frequency is half the rate for B > 0, and zero for B < 0. The result is
    // exactly |B|.
    let plain = TransferFunction::finite_difference(1e4);
    let positive = demand(0.0, 7.0, 1e4, &plain).unwrap();
    assert!(
        (positive.damping_n_s_per_m - 7.0).abs() < PEAK_TOLERANCE
            && positive.frequency_hz == 5000.0
    );
    let negative = demand(0.0, -7.0, 1e4, &plain).unwrap();
    assert!(
        (negative.damping_n_s_per_m - 7.0).abs() < PEAK_TOLERANCE && negative.frequency_hz == 0.0
    );
}

#[test]
fn a_constant_is_a_spring() {
    let constant = TransferFunction { num: vec![30.0], den: vec![1.0] };
    assert!((damping(1000.0, 2.0, 1e3, &constant) - 0.53).abs() < PEAK_TOLERANCE);
}

#[test]
fn extremes_give_numbers() {
    for cutoff in [zwidth::velocity::CUTOFF_MIN, 1e-3, 0.49] {
        for b in [0.0, -1e6, 1e-9, 1e12] {
            let demand =
                demand(0.0, b, 5e4, &TransferFunction::paper(5e4, cutoff * 5e4).unwrap()).unwrap();
            assert!(
                demand.damping_n_s_per_m.is_finite() && demand.damping_n_s_per_m >= 0.0,
                "{cutoff} {b}"
            );
        }
    }
    // V / (1 - z^-1) has a pole on the circle.
    let integrator = TransferFunction { num: vec![1.0], den: vec![1.0, 1.0] };
    assert_eq!(damping(0.0, -1.0, 1e3, &integrator), f64::INFINITY);
    let plain = TransferFunction::finite_difference(1e3);
    assert!(demand(f64::NAN, 0.0, 1e3, &plain).is_err() && demand(0.0, 0.0, 0.0, &plain).is_err());
}

#[test]
fn lower_cutoff_relaxes_passivity() {
    // By passivity, the order of the cutoffs is opposite to the order by the stability boundary.
    let at = |hz| damping(20_000.0, 20.0, 1e4, &TransferFunction::paper(1e4, hz).unwrap());
    let demands = [50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 4000.0].map(at);
    assert!(demands.is_sorted(), "{demands:?}");
}
