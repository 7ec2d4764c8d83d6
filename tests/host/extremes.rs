//! Tests the ends of every range. Nothing may panic, wrap or fail silently. Tests check for overflow, so an addition
//! that wraps fails the test.

use host_sim::{
    scene::{Accelerometer, NamedScene, Scene},
    simulation::prepared::{HitError, HitReport, Numeric, PreparedScene, WallHit},
};
use proptest::{prelude::*, test_runner::TestRunner};
use zwidth::{
    CounterWidth, Design, Gain, LoopParameters, Output, Sampled, Sampler, Settings,
    VelocitySettings, WallSettings,
    experiment::Verdict,
    units::{Force, Position, Velocity},
    velocity::{CUTOFF_MAX, CUTOFF_MIN, EstimatorName, Numbers, PARAMETERS, Sense},
};

fn paper() -> Scene {
    NamedScene::load("paper-1um").unwrap().scene
}

fn wall(cutoff_hz: f64, stiffness_n_per_m: f64, damping_n_s_per_m: f64) -> WallHit {
    let velocity = VelocitySettings::Butterworth { cutoff_hz };
    WallHit { velocity, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts: 0.0 }
}

/// A hit with core and twin. Every number of the result must be finite.
fn hit(scene: &Scene, wall: &WallHit) -> [Result<HitReport, HitError>; 2] {
    let prepared = PreparedScene::new(scene).unwrap();
    [Numeric::Fixed, Numeric::F64].map(|numeric| {
        let report = prepared.hit(numeric, wall, |sample| {
            assert!(sample.position_m.is_finite() && sample.output_n.is_finite());
            assert!(sample.output_n.abs() <= scene.full_scale_n());
        })?;
        let HitReport { mean_m, peak_penetration_m, .. } = report;
        let rms_m = report.rms_m;
        assert!([rms_m, mean_m, peak_penetration_m].iter().all(|value| value.is_finite()));
        Ok(report)
    })
}

fn build(design: &Design, cutoff_hz: f64, stiffness: f64, damping: f64) -> LoopParameters {
    let settings = Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz },
        wall: WallSettings {
            position_m: 0.0,
            stiffness_n_per_m: stiffness,
            damping_n_s_per_m: damping,
            push_only: false,
        },
    };
    settings.build(design).unwrap()
}

#[test]
fn an_encoder_at_the_ends_of_i32_and_jumping_saturates_the_velocity_and_is_out_of_range() {
    let design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 1,
        output: Output::Dac { bits: 12 },
    };
    for cutoff_hz in [CUTOFF_MIN * 1e4, 1500.0, CUTOFF_MAX * 1e4] {
        let control = build(&design, cutoff_hz, 1e7, 1e4);
        let mut sampler = Sampler::new(0, CounterWidth::Bits32);
        let readings = [0, i32::MAX, i32::MIN, -1, i32::MIN, i32::MAX, 0, 1 << 30, -(1 << 30)];
        for reading in readings.into_iter().cycle().take(5000) {
            let motion = sampler.sample(&control, reading as u32).motion;
            assert_eq!(motion.position.counts(), reading);
            assert!(motion.velocity.bits().abs() <= Velocity::LIMIT << 16);
            assert_eq!(motion.position.in_range(), reading.unsigned_abs() <= 1 << 30);
            for push in [Force::FULL_SCALE, Force::ZERO, Force::saturating_from_bits(-(1 << 30))] {
                let drive = control.render(motion, push);
                assert!(drive.force.bits().abs() <= Force::FULL_SCALE.bits());
                assert!((1..=4095).contains(&control.actuator.command(drive.force).code()));
            }
        }
    }
}

#[test]
fn gains_at_both_ends_of_their_range_and_zero_are_exact_for_any_resolution_and_actuator() {
    const RELATIVE_ERROR_MAX: f64 = 1.0 / (1 << 20) as f64;
    for resolution_m in [1e-8, 1e-6, 1e-3] {
        for rate_hz in [1e3, 1e4, 5e4] {
            for full_scale_n in [1e-2, 5.906, 1e3] {
                let output = Output::Continuous;
                let design = Design { rate_hz, resolution_m, full_scale_n, period: 1, output };
                for (stiffness, damping) in
                    [(0.0, 0.0), (1.0, 0.01), (1e7, 1e4), (0.0, 1e4), (1e7, 0.0)]
                {
                    let control = build(&design, 0.1 * rate_hz, stiffness, damping);
                    // The handle is one count deep in the wall: first at rest, then at a speed of one count per sample.
                    let position = Position::from_counts(1);
                    let lsb_per_n = f64::from(Force::FULL_SCALE.bits()) / full_scale_n;
                    let at_rest = control.wall.demand(position, Velocity::ZERO);
                    let moving = control.wall.demand(position, Velocity::saturating_from_counts(1));
                    let spring = stiffness * resolution_m * lsb_per_n;
                    let damper = damping * resolution_m * rate_hz * lsb_per_n;
                    for (force, exact) in [(at_rest, spring), (moving, spring + damper)] {
                        let exact = exact.min(Gain::PRODUCT_LIMIT as f64);
                        let error = (force.bits() as f64 - exact).abs();
                        assert!(error <= 1.0 + RELATIVE_ERROR_MAX * exact, "{design:?} {error}");
                    }
                }
            }
        }
    }
}

#[test]
fn the_lowest_and_highest_cutoff_and_zero_gains_run_at_every_rate() {
    for rate_hz in [1e3, 1e4, 5e4] {
        let mut scene = paper();
        scene.control.rate_hz = rate_hz;
        scene.sweep.cutoffs_hz = vec![0.1 * rate_hz];
        for cutoff_hz in [CUTOFF_MIN * rate_hz, CUTOFF_MAX * rate_hz] {
            for (stiffness, damping) in
                [(0.0, 0.0), (1e7, 0.0), (0.0, 1e4), (1e7, 1e4), (1.0, 0.01)]
            {
                for report in hit(&scene, &wall(cutoff_hz, stiffness, damping)) {
                    let report = report.unwrap();
                    if (stiffness, damping) == (0.0, 0.0) {
                        assert!(report.peak_penetration_m > 0.05, "nothing holds the handle");
                    }
                }
            }
        }
    }
}

#[test]
fn an_actuator_that_saturates_all_the_time_is_reported() {
    let mut scene = paper();
    scene.actuator.limit_v = scene.wall_hit.push_n / scene.actuator.gain_n_per_v;
    // The handle is always behind the surface, so that the wall always requires more force than is available.
    scene.wall.position_m = -0.5;
    scene.device.damping_n_s_per_m = 100.0;
    for report in hit(&scene, &wall(1000.0, 1e7, 0.0)) {
        let report = report.unwrap();
        assert!(report.saturated_fraction > 0.99, "{report:?}");
    }
}

#[test]
fn plants_a_thousand_times_lighter_or_stiffer_stay_finite() {
    for (mass, stiffness, damping) in
        [(1e-3, 1.0, 1.0), (1e3, 1.0, 1.0), (1.0, 1e3, 1.0), (1.0, 1.0, 1e3), (1.0, 1.0, 1e-3)]
    {
        let mut scene = paper();
        scene.device.mass_kg = (scene.device.mass_kg * mass).clamp(1e-3, 100.0);
        scene.device.stiffness_n_per_m *= stiffness;
        scene.device.damping_n_s_per_m *= damping;
        for wall in [wall(50.0, 2000.0, 10.0), wall(2000.0, 1e6, 1000.0)] {
            for report in hit(&scene, &wall) {
                report.unwrap();
            }
        }
    }
}

#[test]
fn stiff_and_undamped_devices_at_the_ends_of_the_scene_ranges_run() {
    for (mass_kg, damping, stiffness) in
        [(1e-3, 0.0, 1e9), (1e-3, 1e6, 1e9), (100.0, 0.0, 0.0), (100.0, 1e6, 0.0), (1e-3, 1e6, 0.0)]
    {
        let mut scene = paper();
        scene.device.mass_kg = mass_kg;
        scene.device.damping_n_s_per_m = damping;
        scene.device.stiffness_n_per_m = stiffness;
        scene.device.start_position_m = scene.device.rest_position_m;
        for result in hit(&scene, &wall(1000.0, 5000.0, 50.0)) {
            let report = result.unwrap();
            if stiffness == 1e9 {
                assert_eq!(report.verdict, Verdict::NoContact, "the push bends it by nanometres");
            }
        }
    }
}

#[test]
fn a_push_too_weak_to_touch_is_no_contact() {
    let mut scene = paper();
    scene.wall_hit.push_n = 0.1;
    for report in hit(&scene, &wall(1000.0, 5000.0, 50.0)) {
        let report = report.unwrap();
        assert_eq!(report.verdict, Verdict::NoContact);
        assert_eq!((report.contact_fraction, report.peak_penetration_m), (0.0, 0.0));
    }
}

#[test]
fn a_handle_that_leaves_the_range_of_the_core_ends_the_hit_by_name() {
    let mut scene = paper();
    scene.encoder.resolution_m = 1e-8; // 2^30 counts are 10.7 m
    scene.device.stiffness_n_per_m = 0.0;
    scene.device.damping_n_s_per_m = 0.0;
    scene.wall.position_m = 10.0;
    for result in hit(&scene, &wall(1000.0, 0.0, 0.0)) {
        let error = result.unwrap_err();
        assert!(matches!(error, HitError::OutOfRange(_)));
        assert!(error.to_string().contains("out of range"), "{error}");
    }
}

/// Draws an estimator of the core, and each parameter as a fraction of its range.
fn any_estimator() -> impl Strategy<Value = (EstimatorName, Numbers)> {
    let part = prop_oneof![1 => Just(0.0), 4 => 0.0..=1.0f64];
    (proptest::sample::select(EstimatorName::ALL), proptest::array::uniform8(part))
}

/// The estimator with its parameters at these fractions of the ranges that the core accepts on this device. The ranges
/// are read from the error messages, one parameter after another.
fn tuned(name: EstimatorName, parts: Numbers, design: &Design) -> VelocitySettings {
    let mut numbers = [f64::NAN; PARAMETERS];
    for _ in 0..2 * PARAMETERS {
        let Err(error) = name.settings(numbers).build(design) else { break };
        let place = name.keys().iter().position(|key| *key == error.parameter).unwrap();
        let (low, high) = (*error.range.start(), *error.range.end());
        numbers[place] = match low > 0.0 {
            true => (low * (high / low).powf(parts[place])).clamp(low, high),
            false => low + (high - low) * parts[place],
        };
        if name.parameters()[place].is_some_and(|parameter| parameter.is_whole()) {
            numbers[place] = numbers[place].round();
        }
    }
    name.settings(numbers)
}

fn any_scene() -> impl Strategy<Value = (Scene, WallHit)> {
    let log = |low: f64, high: f64| (low.log10()..high.log10()).prop_map(|x| 10f64.powf(x));
    let device = (log(1e-3, 100.0), log(1e-3, 1e6), log(1e-3, 1e9));
    let control = (log(1e3, 5e4), log(1e-8, 1e-3), 1u32..=50, 0.0..60.0f64);
    let gains = (log(1.0, 1e7), log(0.01, 1e4), any::<bool>());
    (device, control, gains, any_estimator()).prop_map(|(device, control, gains, estimator)| {
        let mut scene = paper();
        (scene.device.mass_kg, scene.device.damping_n_s_per_m, scene.device.stiffness_n_per_m) =
            device;
        let (rate_hz, resolution_m, period, latency) = control;
        scene.control.rate_hz = rate_hz;
        scene.encoder.resolution_m = resolution_m;
        scene.actuator.period = period;
        scene.actuator.latency = latency;
        let (stiffness, damping, push_only) = gains;
        scene.wall.push_only = push_only;
        let (name, parts) = estimator;
        let velocity = tuned(name, parts, &scene.design());
        scene.velocity = velocity.into();
        if name.sense() == Some(Sense::Acceleration) {
            scene.accelerometer = Some(Accelerometer {
                full_scale_m_per_s2: 160.0,
                resolution_m_per_s2: 0.005,
                noise_m_per_s2_per_sqrt_hz: 1e-3,
                bias_m_per_s2: 0.2,
                bandwidth_hz: Some(1000.0),
            });
        }
        scene.sweep.cutoffs_hz = vec![velocity.cutoff_hz().unwrap_or(0.1 * rate_hz)];
        scene.wall_hit.settle_s = 0.2;
        scene.wall_hit.window_s = 0.1;
        scene.wall_hit.rms_limit_m = resolution_m;
        (scene, WallHit { velocity, ..wall(0.0, stiffness, damping) })
    })
}

#[test]
fn random_scenes_never_panic_and_stay_finite() {
    let config =
        ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() };
    let ran = std::cell::RefCell::new(std::collections::BTreeMap::<&str, u32>::new());
    TestRunner::new(config)
        .run(&any_scene(), |(scene, wall)| {
            if let Err(refusal) = scene.check() {
                // Errors for values without an allowed range on this device.
                let known = ["accelerometer.full_scale_m_per_s2 is", "mass_kg is"];
                prop_assert!(known.iter().any(|known| refusal.contains(known)), "{refusal}");
                return Ok(());
            }
            for result in hit(&scene, &wall) {
                if let Err(error) = result {
                    prop_assert!(matches!(error, HitError::OutOfRange(_)), "{error}");
                }
            }
            *ran.borrow_mut().entry(scene.velocity.name()).or_default() += 1;
            Ok(())
        })
        .unwrap();
    println!("{:?}", ran.borrow());
    assert_eq!(ran.borrow().len(), EstimatorName::ALL.len(), "{:?}", ran.borrow());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn no_reading_makes_a_step_panic(
        readings in prop::collection::vec(any::<u32>(), 1..300),
        cutoff in 0.0..1.0f64, stiffness in 0.0..1e7f64, damping in 0.0..1e4f64,
        resolution in -8.0..-3.0f64, bits16 in any::<bool>(),
    ) {
        let design = Design {
            rate_hz: 1e4,
            resolution_m: 10f64.powf(resolution),
            full_scale_n: 5.906,
            period: 3,
            output: Output::Pwm { steps: 4500 },
        };
        let cutoff_hz = 1e4 * CUTOFF_MIN * (CUTOFF_MAX / CUTOFF_MIN).powf(cutoff * 0.999 + 0.0005);
        let control = build(&design, cutoff_hz, stiffness, damping);
        let width = if bits16 { CounterWidth::Bits16 } else { CounterWidth::Bits32 };
        let mut sampler = Sampler::new(readings[0], width);
        for (n, reading) in readings.into_iter().enumerate() {
            let Sampled { motion, due } = sampler.sample(&control, reading);
            prop_assert_eq!(due, n % 3 == 0);
            let drive = control.render(motion, Force::FULL_SCALE);
            prop_assert!(control.actuator.command(drive.force).code().abs() <= 4500);
        }
    }
}
