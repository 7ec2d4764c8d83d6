//! Tests the documented properties and limits of tracking loop, observer and fusion.

use std::f64::consts::PI;

use host_sim::{
    scene::NamedScene,
    simulation::prepared::{Numeric, PreparedScene, WallHit},
};
use proptest::prelude::*;
use zwidth::{
    Design, VelocitySettings,
    units::{Acceleration, Force, Position, Velocity},
    velocity::{EstimatorName, OBSERVER_MAX, OBSERVER_MIN, ObserverDesign, Senses, TrackingLoop},
};

use crate::estimator_bench::{
    DESIGN, LSB, Motion, after_nonsense, hits_a_wall_like_its_twin, nonsense,
    reads_zero_after_a_stop, sines, twin_is_off_by,
};

const MASS_KG: f64 = 0.416;

fn tracking(bandwidth_hz: f64) -> VelocitySettings {
    VelocitySettings::TrackingLoop { bandwidth_hz }
}

fn observer(bandwidth_hz: f64) -> VelocitySettings {
    VelocitySettings::Observer { bandwidth_hz, mass_kg: MASS_KG }
}

fn fusion(crossover_hz: f64) -> VelocitySettings {
    VelocitySettings::Fusion { crossover_hz }
}

/// Each of the three estimators with tunings over its range, including the ends.
fn all() -> Vec<VelocitySettings> {
    let mut all = Vec::new();
    for of_rate in [3.5e-5, 1e-3, 0.01, 0.1, 0.25] {
        all.push(tracking(of_rate * DESIGN.rate_hz));
    }
    for of_rate in [OBSERVER_MIN, 0.005, 0.03, 0.1, OBSERVER_MAX] {
        all.push(observer(of_rate * DESIGN.rate_hz));
        all.push(fusion(of_rate * DESIGN.rate_hz));
    }
    all
}

/// Number of samples after which the effect of the start is far below an LSB, for a loop with poles at the bandwidth of
/// `settings`.
fn settled(settings: &VelocitySettings) -> i64 {
    let (_, hz) = settings.tuning().unwrap();
    (7.0 * DESIGN.rate_hz / hz) as i64 + 10
}

#[test]
fn constant_speed_is_measured_without_error() {
    for settings in all() {
        // Whole counts give no ripple, so the value is exact.
        for speed in [0, 1, -7, 300, -32_767] {
            let mut motion = Motion::new(settings, |t| f64::from(speed) * t);
            for _ in 0..settled(&settings) {
                motion.free();
            }
            for _ in 0..300 {
                assert_eq!(motion.free().core, f64::from(speed), "{settings:?}");
            }
        }
    }
}

/// With fractions of a count per sample, the counts cause ripple, but the mean must be exact.
#[test]
fn the_mean_at_a_constant_speed_between_counts_is_exact() {
    for settings in all() {
        let speed = 0.618_033_988_75;
        let mut motion = Motion::new(settings, |t| speed * t);
        for _ in 0..settled(&settings) {
            motion.free();
        }
        let samples = 20_000;
        let sum: f64 = (0..samples).map(|_| motion.free().core).sum();
        let off = (sum / f64::from(samples) - speed).abs();
        // The sum of the output is within a count or two of the position.
        assert!(off * f64::from(samples) <= 2.0, "{settings:?}: {off}");
    }
}

#[test]
fn a_handle_that_stops_reads_exactly_zero() {
    for settings in all() {
        reads_zero_after_a_stop(&settings, 2 * settled(&settings));
    }
}

/// Response of the loop's equations to a position that swings at `w` radians per sample. The result is in 1 / sample,
/// as real and imaginary part.
fn response(settings: &VelocitySettings, w: f64) -> [f64; 2] {
    let (gains, order) = match *settings {
        VelocitySettings::TrackingLoop { bandwidth_hz } => {
            let TrackingLoop { kp, ki, .. } =
                TrackingLoop::new(bandwidth_hz, DESIGN.rate_hz).unwrap();
            ([kp, ki, 0.0], 2)
        }
        VelocitySettings::Observer { bandwidth_hz: hz, .. }
        | VelocitySettings::Fusion { crossover_hz: hz } => {
            (ObserverDesign::of_accelerometer(hz, DESIGN.rate_hz).unwrap().gains, 3)
        }
        _ => panic!(),
    };
    // Input exp(j w n): runs the loop in complex numbers until it has settled.
    let (mut e, mut v, mut d) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    let mut out = [0.0; 2];
    let mut last = [1.0, 0.0];
    for n in 1..200_000 {
        let phase = w * f64::from(n);
        let x = [phase.cos(), phase.sin()];
        for i in 0..2 {
            let half = if order == 3 { 0.5 * d[i] } else { 0.0 };
            let now = e[i] + x[i] - last[i] - v[i] - half;
            e[i] = now - gains[0] * now;
            v[i] += d[i] + gains[1] * now;
            d[i] += gains[2] * now;
        }
        last = x;
        // v / x
        out = [v[0] * x[0] + v[1] * x[1], v[1] * x[0] - v[0] * x[1]];
    }
    out
}

/// Measures a chirp at each frequency by correlation. The delay equals the delay of the loop's own response. If a delay
/// is documented, both delays equal the documented delay.
#[test]
fn the_delay_is_the_stated_one() {
    const AMPLITUDE: f64 = 20_000.0;
    for (settings, stated) in [
        (tracking(500.0), TrackingLoop::new(500.0, 1e4).unwrap().delay_samples()),
        (tracking(1200.0), TrackingLoop::new(1200.0, 1e4).unwrap().delay_samples()),
        (observer(500.0), 0.0),
        (observer(100.0), 0.0),
    ] {
        for hz in [10.0, 20.0, 40.0, 80.0] {
            let w = 2.0 * PI * hz / DESIGN.rate_hz;
            let period = (DESIGN.rate_hz / hz) as i64;
            let mut motion = Motion::new(settings, |t| AMPLITUDE * (w * t).sin());
            for _ in 0..(settled(&settings) / period + 1) * period {
                motion.free();
            }
            let (mut real, mut imaginary) = (0.0, 0.0);
            for _ in 0..10 * period {
                let seen = motion.free().core;
                let phase = w * motion.sample as f64;
                // Correlates the velocity with cosine and sine.
                real += seen * phase.cos();
                imaginary -= seen * phase.sin();
            }
            let (magnitude, phase) = (real.hypot(imaginary), imaginary.atan2(real));
            let magnitude = magnitude / (5 * period) as f64 / (AMPLITUDE * w);
            let delay = -phase / w;
            let [re, im] = response(&settings, w);
            let expected = [re.hypot(im) / w, -(im.atan2(re) - PI / 2.0) / w];
            assert!((magnitude / expected[0] - 1.0).abs() < 2e-4, "{settings:?} {hz}: {magnitude}");
            assert!((delay - expected[1]).abs() < 2e-3, "{settings:?} {hz}: {delay} {expected:?}");
            // The documented delay is for DC. At other frequencies the phase differs by terms in x^3, with x =
            // frequency over bandwidth: 2 atan x = 2 x - 2/3 x^3 .., and 3 atan x - atan 3 x = 8 x^3 ..
            let bandwidth_hz = settings.tuning().unwrap().1;
            let cubed = (hz / bandwidth_hz).powi(3) / w;
            let expected = match settings {
                VelocitySettings::TrackingLoop { .. } => stated - 2.0 / 3.0 * cubed,
                _ => stated + 8.0 * cubed,
            };
            if hz / bandwidth_hz <= 0.1 {
                // These series are for the loop in continuous time. The error is of the order of the loop's w T.
                let order = 2.0 * PI * bandwidth_hz / DESIGN.rate_hz;
                let limit = 2e-3 + order.max(0.1) * (expected - stated).abs();
                assert!((delay - expected).abs() < limit, "{settings:?} {hz}: {delay} {expected}");
            }
        }
    }
}

/// The observer follows a known push without delay. An unknown constant force causes no lasting error.
#[test]
fn the_observer_follows_what_it_is_told_at_once() {
    let full_scale = DESIGN.full_scale_n / MASS_KG / DESIGN.resolution_m / 1e8; // counts / sample^2
    let unknown = 0.03;
    let error = |told: bool| {
        let at = |t: f64| {
            let known = if t > 5000.0 { full_scale * (t - 5000.0).powi(2) / 2.0 } else { 0.0 };
            known + unknown * t * t / 2.0
        };
        let mut motion = Motion::new(observer(100.0), at);
        let mut worst = 0.0f64;
        for n in 0..5400 {
            let pushed = told && n >= 5000;
            let force = if pushed { Force::FULL_SCALE } else { Force::ZERO };
            let seen = motion.next(force).core;
            if n > 4500 {
                worst = worst.max((seen - motion.speed(motion.sample as f64)).abs());
            }
        }
        worst
    };
    let (told, untold) = (error(true), error(false));
    // Without knowing the force, the error is A (t + w t^2) exp(-w t), at most 0.84 A / w. With the known force only
    // the count's ripple remains: l2 times a count.
    let largest = 0.84 * full_scale / (2.0 * PI * 100.0 / 1e4);
    let ripple = ObserverDesign::of_accelerometer(100.0, 1e4).unwrap().gains[1];
    println!("told {told}, untold {untold}, ripple {ripple}");
    assert!(told < 3.0 * ripple, "{told}");
    assert!((untold / largest - 1.0).abs() < 0.05, "{untold} {largest}");
}

#[test]
fn fusion_rejects_the_bias_and_follows_without_delay() {
    let w = 2.0 * PI * 200.0 / 1e4; // four times the crossover
    let settings = fusion(50.0);
    let mut motion = Motion::new(settings, |t| 300.0 * (w * t).sin());
    let bias = 0.02 * f64::from(1 << 24);
    let mut worst = 0.0f64;
    for n in 0..20_000i64 {
        let (t0, t1) = (n as f64, (n + 1) as f64);
        let acceleration = (motion.speed(t1) - motion.speed(t0)) * f64::from(1 << 24) + bias;
        let senses = Senses {
            acceleration: Acceleration::saturating_from_bits(acceleration.round() as i32),
            ..Senses::NONE
        };
        let count = (motion.at)(t1).floor() as i32;
        let position = Position::from_counts(count);
        let seen = motion.estimator.update(&mut motion.state, position, &senses);
        if n > 3000 {
            worst = worst.max((f64::from(seen.bits()) / LSB - motion.speed(t1)).abs());
        }
    }
    // The speed is 37 counts per sample. A low-pass of 200 Hz would have an error of half this speed.
    println!("fusion: {worst} counts per sample");
    assert!(worst < 0.01 * 300.0 * w, "{worst}");
}

/// Largest allowed difference between core and twin in random motion, in LSB. The speeds go up to `fastest` LSB.
///
/// The core computes the tracking loop as a low-pass with coefficients of 30 fractional bits. The sum ki of these
/// coefficients has an error of up to 2^-31. This changes the response by a fraction of up to 2 * 2^-31 / ki, and the
/// damping by less. The observer's gains have 32 bits.
fn twin_lsb(settings: &VelocitySettings, fastest: f64) -> f64 {
    match *settings {
        VelocitySettings::TrackingLoop { bandwidth_hz } => {
            let TrackingLoop { ki, .. } = TrackingLoop::new(bandwidth_hz, DESIGN.rate_hz).unwrap();
            1.5 + fastest * 3.0 * 2f64.powi(-31) / ki
        }
        _ => 1.0,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Smooth random walks at all speeds, under random forces.
    #[test]
    fn the_core_follows_its_twin(which in 0..15usize, steps in sines(), speed in 0.001..300.0f64) {
        let settings = all()[which];
        let (worst, fastest) = twin_is_off_by(&settings, &steps, speed);
        let limit = twin_lsb(&settings, fastest);
        prop_assert!(worst <= limit, "{settings:?}: {worst} LSB of {limit}");
    }

    /// Nothing overflows. After any input, the estimator ends at zero.
    #[test]
    fn nothing_overflows_and_every_speed_stays_in_range(which in 0..15usize, any in nonsense()) {
        let settings = all()[which];
        let last = after_nonsense(&settings, &any, 12 * settled(&settings) + 60_000);
        prop_assert_eq!(last, Velocity::ZERO, "{:?}", settings);
    }
}

#[test]
fn what_is_out_of_range_is_refused_by_name() {
    let refused = |settings: VelocitySettings| settings.build(&DESIGN).unwrap_err().parameter;
    for bad in [0.3, 2501.0, 0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(refused(tracking(bad)), "bandwidth_hz", "{bad}");
    }
    for bad in [9.9, 2001.0, f64::NAN] {
        assert_eq!(refused(observer(bad)), "bandwidth_hz");
        assert_eq!(refused(fusion(bad)), "crossover_hz");
    }
    for mass_kg in [0.0, 9e-4, 101.0, f64::NAN] {
        let settings = VelocitySettings::Observer { bandwidth_hz: 100.0, mass_kg };
        assert_eq!(refused(settings), "mass_kg");
    }
    // This motor is so strong that the velocity leaves its range within one sample.
    let strong = Design { full_scale_n: 1e4, resolution_m: 1e-8, rate_hz: 1e3, ..DESIGN };
    for mass_kg in [0.0, 1.0, 101.0] {
        let settings = VelocitySettings::Observer { bandwidth_hz: 10.0, mass_kg };
        let error = settings.build(&strong).unwrap_err();
        assert_eq!(error.parameter, "mass_kg");
        // The range in the message does not depend on the requested value.
        assert!((30.5..30.6).contains(error.range.start()), "{error}");
    }
}

#[test]
fn estimators_say_what_they_need() {
    use zwidth::velocity::Sense;
    let board = [Sense::Force];
    for &name in EstimatorName::ALL {
        let missing = name.missing(&board);
        match name {
            EstimatorName::TimeStamps => assert_eq!(missing, Some(Sense::Edge)),
            EstimatorName::Fusion => assert_eq!(missing, Some(Sense::Acceleration)),
            _ => assert_eq!(missing, None, "{name:?}"),
        }
    }
    assert_eq!(EstimatorName::Observer.missing(&[]), Some(Sense::Force));
}

/// A wall hit with each of the three estimators.
#[test]
fn scenes_with_senses_run_and_core_and_twin_agree() {
    let accelerometer = "\n[accelerometer]\nfull_scale_m_per_s2 = 100.0\nbandwidth_hz = 1000.0\n\
                         noise_m_per_s2_per_sqrt_hz = 0.001\nbias_m_per_s2 = 0.3\n\
                         resolution_m_per_s2 = 0.005\n";
    hits_a_wall_like_its_twin("estimator = \"tracking-loop\"", 1000.0, "");
    hits_a_wall_like_its_twin("estimator = \"observer\"\nmass_kg = 0.416", 300.0, "");
    hits_a_wall_like_its_twin("estimator = \"fusion\"", 100.0, accelerometer);
    let usual = "estimator = \"butterworth\"\nprewarp = false";
    let without = host_sim::scene::BUILT_IN[0].1.replace(usual, "estimator = \"fusion\"");
    let refused = NamedScene::parse("x".into(), without, "x").unwrap_err().to_string();
    assert!(refused.contains("accelerometer") || refused.contains("cutoffs_hz"), "{refused}");
}

/// With `[mode]` the accelerometer is on the body with motor and encoder. Above its crossover, fusion uses the
/// accelerometer. So fusion follows this body. The handle behind the transmission swings in the opposite direction.
#[test]
fn the_accelerometer_is_on_the_body_with_the_encoder() {
    let usual = "estimator = \"butterworth\"\nprewarp = false";
    let text = host_sim::scene::BUILT_IN[0].1.replace(usual, "estimator = \"fusion\"")
        + "\n[accelerometer]\nfull_scale_m_per_s2 = 100.0\n\
           [mode]\nmass_kg = 0.3\nstiffness_n_per_m = 2e4\ndamping_n_s_per_m = 0.5\n";
    let text = text.replace("200, 500, 1000, 1200, 1500, 1700, 2000, 2500, 3000, 4000]", "200]");
    let scene = NamedScene::parse("x".into(), text, "x").unwrap().scene;
    let hit = WallHit {
        velocity: scene.velocity.at(10.0),
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        start_offset_counts: 0.3,
    };
    let mut samples = vec![];
    let prepared = PreparedScene::new(&scene).unwrap();
    prepared
        .hit(Numeric::Fixed, &hit, |sample| samples.push((sample.position_m, sample.velocity)))
        .unwrap();
    let speeds: Vec<[f64; 2]> = samples[1000..2500]
        .windows(3)
        .map(|of| [(of[2].0 - of[0].0) / 2.0 / scene.encoder.resolution_m, of[1].1])
        .collect();
    // The swing is the deviation from a mean over its 18 ms.
    let swing: Vec<[f64; 2]> = speeds
        .windows(181)
        .map(|of| [0, 1].map(|n| of[90][n] - of.iter().map(|speed| speed[n]).sum::<f64>() / 181.0))
        .collect();
    let rms = |value: &dyn Fn(&[f64; 2]) -> f64| {
        (swing.iter().map(|both| value(both).powi(2)).sum::<f64>() / swing.len() as f64).sqrt()
    };
    let (true_speed, off) = (rms(&|both| both[0]), rms(&|both| both[1] - both[0]));
    println!("swing {true_speed:.4} counts per sample, off by {off:.4}");
    assert!(true_speed > 0.3 && off < 0.2 * true_speed, "{true_speed} {off}");
}
