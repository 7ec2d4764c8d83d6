//! Levant's differentiator into a Kalman filter, and dual-rate sampling: what docs/estimators.md states of them is
//! measured. Gains, delay of a constant acceleration and the noise that the filter assumes are held in their files.

use proptest::prelude::*;
use zwidth::{
    VelocitySettings,
    velocity::{EstimatorName, LevantKalmanDesign},
};

use crate::{
    estimator_bench::{
        DESIGN, LSB, Run, delay_over_a_chirp, hits_a_wall_like_its_twin, pieces, rest_after,
        speeds, twin_over_random_motion,
    },
    figure::figure,
};

/// C in counts per sample^2, and the filter's acceleration over it.
fn levant_kalman(c: f64, ratio: f64) -> VelocitySettings {
    let unit = DESIGN.resolution_m * DESIGN.rate_hz * DESIGN.rate_hz;
    EstimatorName::LevantKalman.defaults().with_tuning(c * unit).with_second(ratio)
}

fn design(settings: &VelocitySettings) -> (f64, LevantKalmanDesign) {
    let VelocitySettings::LevantKalman { acceleration_max_m_per_s2, rms_ratio } = *settings else {
        panic!("{settings:?}")
    };
    let unit = DESIGN.resolution_m * DESIGN.rate_hz * DESIGN.rate_hz;
    let design = LevantKalmanDesign::new(acceleration_max_m_per_s2, rms_ratio, &DESIGN).unwrap();
    (acceleration_max_m_per_s2 / unit, design)
}

fn dual_rate(decimation: u32) -> VelocitySettings {
    EstimatorName::DualRate.defaults().with_tuning(decimation.into())
}

/// Sums of the magnitudes of the filter's responses to the count and to the differentiator's velocity.
fn responses(settings: &VelocitySettings) -> [f64; 2] {
    let (_, LevantKalmanDesign { gains, .. }) = design(settings);
    [0, 1].map(|shown| {
        let [mut x, mut v] = [gains[0][shown], gains[1][shown]];
        let mut sum = 0.0;
        for _ in 0..20_000 {
            sum += f64::abs(v);
            let ahead = x + v;
            x = ahead - gains[0][0] * ahead - gains[0][1] * v;
            v -= gains[1][0] * ahead + gains[1][1] * v;
        }
        sum
    })
}

#[test]
fn constant_speed_is_measured_within_the_stated_error() {
    let both = [0.05, 0.2, 1.0, 5.0].map(|c| [0.1, 1.0, 10.0].map(|ratio| levant_kalman(c, ratio)));
    let dual = [1, 2, 3, 10, 255].map(dual_rate);
    for all in [both.as_flattened(), &dual[..]] {
        let mut closest = 0f64;
        for settings in all {
            let of_speed = |speed: f64| match *settings {
                VelocitySettings::DualRate { decimation_samples } => {
                    let n = f64::from(decimation_samples);
                    (if speed.fract() == 0.0 { 0.0 } else { 1.0 / n }, 2.0 * n)
                }
                _ => {
                    let (c, [of_count, shown]) = (design(settings).0, responses(settings));
                    let whole = speed.fract() == 0.0;
                    let levant = if whole { 2.0 * c } else { 2.5 * c.max(c.sqrt()) };
                    let count = if whole { 0.0 } else { 0.5 * of_count };
                    (count + shown * levant, 4.0 * speed.abs() / c + 3000.0)
                }
            };
            for speed in speeds() {
                let (stated, wait) = of_speed(speed);
                if wait > 300_000.0 {
                    continue; // minutes of a small C at a large speed
                }
                let mut run = Run::new(settings, i32::MAX - 1000);
                for n in 1..wait as usize + 2000 {
                    let count = (speed * n as f64 + 0.3).floor() as i64;
                    let error = (run.at(i64::from(i32::MAX - 1000) + count) - speed).abs();
                    if n > wait as usize {
                        assert!(error <= stated + 1.0 / LSB, "{settings:?} at {speed}: {error}");
                        closest = closest.max(error / stated.max(1.0 / LSB));
                    }
                }
            }
        }
        println!("{}: {closest:.3} of the stated error", all[0].name().text());
        // a bound that nothing comes near would say nothing
        assert!(closest > 0.7, "{closest}");
    }
}

#[test]
fn the_stated_delay_is_that_over_a_chirp() {
    for (c, ratio) in [(0.05, 1.0), (0.05, 10.0), (0.2, 0.1), (0.2, 1.0), (1.0, 1.0)] {
        let settings = levant_kalman(c, ratio);
        // up to 0.6 of the largest acceleration
        let amplitude = 0.6 * c * 1e8 / (8.0 * std::f64::consts::PI).powi(2);
        let measured = delay_over_a_chirp(&settings, amplitude, 0.5, 4.0);
        let stated = design(&settings).1.delay_samples();
        println!("{settings:?}: {measured:.3} samples, stated {stated:.3}");
        assert!((measured - stated).abs() < 0.1 * f64::max(stated, 1.0), "{settings:?}");
    }
    for decimation in [1, 2, 10, 60] {
        let measured = delay_over_a_chirp(&dual_rate(decimation), 20_000.0, 0.2, 1.0);
        let stated = f64::from(decimation) - 0.5;
        println!("dual-rate {decimation}: {measured:.4} samples, stated {stated}");
        assert!((measured - stated).abs() < 0.02 * stated, "{decimation}");
    }
}

#[test]
fn the_twin_in_f64_is_within_the_stated_lsb_over_random_motion() {
    /// Of levant-kalman: what levant-explicit is off by, and the residue of the rounding, which is carried.
    const STATED: [f64; 2] = [3.0, 0.8];
    let both = [0.01, 0.05, 0.2, 1.0, 5.0]
        .map(|c| [0.1, 1.0, 10.0].map(|ratio| (levant_kalman(c, ratio), 0.4 * c)));
    let dual = [1, 2, 10, 255].map(|n| (dual_rate(n), 0.2));
    for (all, stated) in [both.as_flattened(), &dual[..]].into_iter().zip(STATED) {
        let worst = |(settings, push): &(VelocitySettings, f64)| {
            let (worst, _) = twin_over_random_motion(settings, *push);
            println!("{settings:?}: {worst:.3} LSB, stated {stated}");
            assert!(worst <= stated, "{settings:?}: {worst}");
            worst
        };
        let largest = all.iter().map(worst).fold(0.0, f64::max);
        figure(&format!("host/estimators/{}/twin_lsb", all[0].0.name().text()), largest);
    }
}

/// A wall hit with each of them.
#[test]
fn scenes_run_and_core_and_twin_agree() {
    hits_a_wall_like_its_twin("estimator = \"dual-rate\"\ndecimation_samples = 5", 1000.0, "");
    for rest in ["", "\nrms_ratio = 0.5"] {
        let velocity = "estimator = \"levant-kalman\"\nacceleration_max_m_per_s2 = 20";
        hits_a_wall_like_its_twin(&format!("{velocity}{rest}"), 1000.0, "");
    }
    hits_a_wall_like_its_twin(
        "estimator = \"algebraic\"\ndegree = 2\nwindow_samples = 9",
        1000.0,
        "",
    );
    let some = "estimator = \"algebraic\"\ndegree = 1\nkappa = 0.5\nmu = 3\nwindow_samples = 4";
    hits_a_wall_like_its_twin(some, 1000.0, "");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    /// Overflow checks are on in tests. Whatever came before: at rest, every estimator is at rest.
    #[test]
    fn nothing_makes_an_estimator_panic_or_stick(
        c in 0.2..5.0f64,
        ratio in 0.1..10.0f64,
        decimation in 1..=255u32,
        start in any::<i32>(),
        pieces in pieces(),
    ) {
        let velocity = rest_after(&dual_rate(decimation), start, &pieces, 510);
        prop_assert!(velocity == 0.0, "{}: {}", decimation, velocity);
        let settings = levant_kalman(c, ratio);
        let wait = (4.0 * 65_536.0 / c) as usize + 3000;
        let velocity = rest_after(&settings, start, &pieces, wait);
        let stated = responses(&settings)[1] * 2.0 * c;
        prop_assert!(velocity <= stated + 2.0 / LSB, "{:?}: {}", settings, velocity);
    }
}
