//! The finite difference, the low-passes after it, and every weighted sum of differences. The tests measure the
//! statements of docs/estimators.md. tests/host/filter.rs tests the low-passes' coefficients, responses and sums.

use std::f64::consts::PI;

use host_sim::{
    analysis::linear::{position_response, transfer_function},
    simulation::twin::TwinEstimator,
};
use proptest::{prelude::*, sample::select};
use zwidth::{
    VelocitySettings,
    velocity::{ButterworthDesign, EstimatorName, FirDesign, Senses},
};

use crate::estimator_bench::{
    DESIGN, LSB, Run, delay_over_a_chirp, pieces, response_of, response_to_a_position, rest_after,
    speeds, twin_over_random_motion,
};

/// Finite difference, low-passes, and every estimator that has weights in the table.
fn names() -> impl Iterator<Item = EstimatorName> {
    let usual = [EstimatorName::Butterworth, EstimatorName::FirstOrder, EstimatorName::Difference];
    let is_sum = |name: &EstimatorName| name.defaults().weights(&DESIGN).unwrap().is_some();
    usual.into_iter().chain(EstimatorName::ALL.iter().copied().filter(is_sum))
}

/// Tunings from slow to fast.
fn tunings(name: EstimatorName) -> Vec<VelocitySettings> {
    let values: &[f64] = match name {
        EstimatorName::Butterworth | EstimatorName::FirstOrder => &[5.0, 100.0, 1500.0, 4500.0],
        EstimatorName::LeastSquares1 => &[1.0, 2.0, 3.0, 16.0, 63.0, 64.0],
        EstimatorName::LeastSquares2 => &[2.0, 3.0, 4.0, 16.0, 63.0, 64.0],
        _ => return vec![name.defaults()],
    };
    values.iter().map(|&value| name.defaults().with_tuning(value)).collect()
}

/// Largest documented error at constant speed, in counts per sample. With `whole`, the error is for speeds of whole
/// counts per sample. Otherwise it is for any speed.
fn stated_error(settings: &VelocitySettings, whole: bool) -> f64 {
    match *settings {
        _ if whole => 0.0,
        VelocitySettings::Difference {} => 1.0,
        VelocitySettings::Taylor2 {} => 2.0,
        VelocitySettings::Taylor3 {} => 4.0,
        VelocitySettings::LeastSquares1 { window_samples } => 1.5 / f64::from(window_samples),
        VelocitySettings::LeastSquares2 { window_samples } => 6.0 / f64::from(window_samples),
        // A rounding error is within half a count about its mean.
        _ => 0.5 * response_to_a_position(settings).iter().map(|h| h.abs()).sum::<f64>(),
    }
}

/// Number of samples after which the effect of a change of speed is below half an LSB.
fn settling(settings: &VelocitySettings) -> usize {
    match *settings {
        VelocitySettings::Butterworth { cutoff_hz, .. }
        | VelocitySettings::FirstOrder { cutoff_hz, .. } => {
            (8.0 * DESIGN.rate_hz / cutoff_hz) as usize + 100
        }
        VelocitySettings::LeastSquares1 { window_samples }
        | VelocitySettings::LeastSquares2 { window_samples } => window_samples as usize + 1,
        _ => 4,
    }
}

/// Rounding error of the output, in LSB. A low-pass adds the rounding residue of a sample to the next sample, so the
/// error may reach a whole LSB.
fn rounding_lsb(settings: &VelocitySettings) -> f64 {
    match settings {
        VelocitySettings::Butterworth { .. } | VelocitySettings::FirstOrder { .. } => 1.0,
        VelocitySettings::Difference {} => 0.0,
        _ => 0.5,
    }
}

#[test]
fn constant_speed_is_measured_within_the_stated_error() {
    for name in names() {
        let mut closest = 0f64;
        for settings in tunings(name) {
            for speed in speeds() {
                let stated = stated_error(&settings, speed.fract() == 0.0);
                let mut run = Run::new(&settings, i32::MAX - 1000);
                let wait = settling(&settings);
                for n in 1..wait + 3000 {
                    let count = (speed * n as f64 + 0.3).floor() as i64;
                    let error = (run.at(i64::from(i32::MAX - 1000) + count) - speed).abs();
                    if n > wait {
                        let limit = stated + rounding_lsb(&settings) / LSB;
                        assert!(error <= limit, "{settings:?} at {speed}: {error}, {limit}");
                        if stated > 0.0 {
                            closest = closest.max(error / stated);
                        }
                    }
                }
            }
        }
        println!("{}: {closest:.3} of the stated error", name.text());
        // If the error never comes near the limit, the test proves nothing.
        assert!(closest > 0.4, "{}", name.text());
    }
}

/// Compares the weights with independent closed expressions. Some are the derivative of the parabola through three
/// points, and of the cubic through four points. A regression's slope has this weight for difference j:
/// `6 (j + 1) (w - j) / (w (w + 1) (w + 2))`. A quadratic fit follows every parabola. Of all weights that do so, the
/// weights of the fit have the least sum of squares.
#[test]
fn weights_are_those_of_the_polynomials() {
    let close = |ours: &[f64], theirs: &[f64]| {
        assert_eq!(ours.len(), theirs.len());
        ours.iter().zip(theirs).for_each(|(a, b)| assert!((a - b).abs() < 1e-13, "{a} {b}"));
    };
    close(FirDesign::taylor(2).unwrap().weights(), &[1.5, -0.5]);
    close(FirDesign::taylor(3).unwrap().weights(), &[11.0 / 6.0, -7.0 / 6.0, 1.0 / 3.0]);
    for window in 1..=64u32 {
        let w = f64::from(window);
        let slope: Vec<f64> = (0..window)
            .map(|j| 6.0 * f64::from(j + 1) * f64::from(window - j) / (w * (w + 1.0) * (w + 2.0)))
            .collect();
        close(FirDesign::least_squares(1, window).unwrap().weights(), &slope);
        if window < 2 {
            continue;
        }
        let design = FirDesign::least_squares(2, window).unwrap();
        // Weights of the positions, newest first. The weights are exact for 1, t and t^2, and are a combination of
        // these three functions. So their sum of squares is the least.
        let g = design.weights();
        let h: Vec<f64> = (0..=window as usize)
            .map(|i| g.get(i).unwrap_or(&0.0) - if i > 0 { g[i - 1] } else { 0.0 })
            .collect();
        let moment = |power: i32| -> f64 {
            h.iter().enumerate().map(|(i, h)| h * (-(i as f64)).powi(power)).sum()
        };
        assert!(moment(0).abs() < 1e-13 && (moment(1) - 1.0).abs() < 1e-12);
        assert!(moment(2).abs() < 1e-10, "{window}: {}", moment(2));
        for i in 3..h.len() {
            let third = h[i] - 3.0 * h[i - 1] + 3.0 * h[i - 2] - h[i - 3];
            assert!(third.abs() < 1e-13, "a parabola over the window: {third}");
        }
    }
}

#[test]
fn the_stated_delay_is_that_over_a_chirp() {
    /// Largest allowed error of the delay, in samples or relative to the delay. It comes from quantisation, and from
    /// frequencies of the chirp above zero.
    const ERROR_MAX: f64 = 0.02;
    for name in names() {
        for settings in tunings(name) {
            let stated = match settings {
                VelocitySettings::Butterworth { cutoff_hz, .. } => {
                    0.5 + 2f64.sqrt() * DESIGN.rate_hz / (2.0 * PI * cutoff_hz)
                }
                VelocitySettings::FirstOrder { cutoff_hz, .. } => {
                    0.5 + DESIGN.rate_hz / (2.0 * PI * cutoff_hz)
                }
                VelocitySettings::Difference {} => 0.5,
                VelocitySettings::LeastSquares1 { window_samples } => {
                    f64::from(window_samples) / 2.0
                }
                VelocitySettings::Taylor2 {}
                | VelocitySettings::Taylor3 {}
                | VelocitySettings::LeastSquares2 { .. } => 0.0,
                // Each difference is the velocity half a sample earlier.
                _ => {
                    let sum = settings.weights(&DESIGN).unwrap().unwrap();
                    sum.weights().iter().zip(0u8..).map(|(g, age)| g * (f64::from(age) + 0.5)).sum()
                }
            };
            let measured = delay_over_a_chirp(&settings, 20_000.0, 0.2, 1.0);
            println!("{settings:?}: {measured:.4} samples, stated {stated:.4}");
            let off = (measured - stated).abs();
            assert!(off < ERROR_MAX * f64::max(stated, 1.0), "{settings:?}: {measured} {stated}");
        }
    }
}

/// Largest documented difference from the twin, in LSB of 2^-16 counts per sample. `fastest` is the largest speed, in
/// LSB.
fn stated_lsb(settings: &VelocitySettings, fastest: f64) -> f64 {
    match *settings {
        VelocitySettings::Difference {} => 0.0,
        _ if settings.weights(&DESIGN).unwrap().is_some() => 0.6,
        // a1 is rounded to 2^-30 and a2 to half of this. The effect grows as the sum 1 + a1 + a2 = 4 b0 becomes
        // smaller.
        VelocitySettings::Butterworth { cutoff_hz } => {
            let b0 = ButterworthDesign::new(cutoff_hz, DESIGN.rate_hz, false).unwrap().b0;
            1.5 + fastest * 3.0 * 2f64.powi(-31) / (4.0 * b0)
        }
        _ => 1.5,
    }
}

#[test]
fn the_twin_in_f64_is_within_the_stated_lsb_over_random_motion() {
    for name in names() {
        let mut largest = 0f64;
        for settings in tunings(name) {
            let (worst, fastest) = twin_over_random_motion(&settings, 0.2);
            largest = largest.max(worst);
            let stated = stated_lsb(&settings, fastest);
            println!("{settings:?}: {worst:.3} LSB, stated {stated:.3}");
            assert!(worst <= stated, "{settings:?}: {worst}");
        }
        crate::figure::figure(&format!("host/estimators/{}/twin_lsb", name.text()), largest);
    }
}

/// The test fails if a row of the table has no twin, or if a linear row has no transfer function. An estimator is
/// linear if the response to a sum is the sum of the responses. The test adds responses of the twin to slow motions, in
/// which windows are long.
#[test]
fn every_estimator_has_a_twin_and_if_it_is_linear_its_transfer_function() {
    let mut linear = 0;
    for &name in EstimatorName::ALL {
        let settings = name.defaults();
        let run = |differences: &[i32]| -> Vec<f64> {
            let mut twin = TwinEstimator::new(&settings, &DESIGN).unwrap();
            differences.iter().map(|d| twin.update(*d, &Senses::NONE)).collect()
        };
        let close = |ours: &[f64], theirs: &[f64]| {
            ours.iter().zip(theirs).all(|(a, b)| (a - b).abs() < 1e-9)
        };
        let mut core = Run::new(&settings, 0);
        let ramp = (1..5000).map(|count| core.at(count)).collect::<Vec<_>>();
        for velocities in [ramp, run(&[1; 5000])] {
            let mean = velocities[4000..].iter().sum::<f64>() / velocities[4000..].len() as f64;
            assert!((mean - 1.0).abs() < 0.01, "{name:?}: {mean} at one count per sample");
        }

        let every = |n: i32| (0..1000).map(|k| i32::from(k % n == 0)).collect::<Vec<_>>();
        let [a, b] = [every(3), every(7)];
        let both: Vec<i32> = a.iter().zip(&b).map(|(a, b)| a + b).collect();
        let sum: Vec<f64> = run(&a).iter().zip(run(&b)).map(|(a, b)| a + b).collect();
        let adds_up = close(&run(&both), &sum);
        let stated = transfer_function(&settings, &DESIGN).unwrap().is_some();
        assert_eq!(stated, adds_up && name.sense().is_none(), "{name:?}");
        if adds_up {
            let mut there_and_back = [0; 1000];
            there_and_back[..2].copy_from_slice(&[1, -1]);
            let function = position_response(&settings, &DESIGN).unwrap().unwrap();
            assert!(close(&run(&there_and_back), &response_of(&function)), "{name:?}");
            linear += 1;
        }
    }
    assert!(linear >= 12 && linear < EstimatorName::ALL.len(), "{linear}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    /// Tests check for overflow. After any motion, every estimator at rest has the velocity 0.
    #[test]
    fn nothing_makes_an_estimator_panic_or_stick(
        name in select(names().collect::<Vec<_>>()),
        tuning in 0..6usize,
        start in any::<i32>(),
        pieces in pieces(),
    ) {
        let all = tunings(name);
        let settings = all[tuning % all.len()];
        let velocity = rest_after(&settings, start, &pieces, 3 * settling(&settings));
        let stated = rounding_lsb(&settings) / LSB;
        prop_assert!(velocity <= stated, "{:?}: {}", settings, velocity);
    }
}
