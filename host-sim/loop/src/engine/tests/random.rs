//! Random scenes, estimators, criteria and walls.

use proptest::{prelude::*, sample::select};

use super::*;

fn scenes() -> impl Strategy<Value = Scene> {
    let loops = (
        prop_oneof![Just(1u32), Just(2), Just(10), 1u32..40],
        prop_oneof![Just(0.0), Just(10.0), 0.0..45.0f64],
        prop_oneof![Just(1e4), 1e3..5e4f64],
        any::<bool>(),
        any::<bool>(),
        -7.9..-3.1f64,
    );
    let outputs = prop_oneof![
        Just(None),
        (2u32..=24).prop_map(|bits| Some(Quantisation::Dac { bits })),
        (2u32..10_000).prop_map(|steps| Some(Quantisation::Pwm { steps })),
    ];
    let estimators = prop_oneof![
        3 => select(&[EstimatorName::Butterworth, EstimatorName::ButterworthPrewarped][..]),
        1 => select(&[EstimatorName::FirstOrder, EstimatorName::FirstOrderPrewarped][..]),
        1 => Just(EstimatorName::Difference),
    ];
    let bodies = (-2.0..1.0f64, 0.0..20.0f64, 0.0..300.0f64, (0.05..1.2f64, any::<bool>()));
    let elements = (any::<bool>(), any::<bool>(), 100.0..3000.0f64, sensors());
    (loops, outputs, estimators, bodies, elements).prop_map(
        |(loops, output, velocity, (mass, damping, stiffness, push), (pole, arm, hz, sensor))| {
            let (push, by_hand) = push;
            let (period, latency, rate_hz, push_only, round, resolution) = loops;
            let mut scene = paper();
            scene.actuator.period = period;
            scene.actuator.latency = latency;
            scene.control.rate_hz = rate_hz;
            scene.wall.push_only = push_only;
            scene.encoder.rounding = if round { Rounding::Round } else { Rounding::Floor };
            scene.encoder.resolution_m = 10f64.powf(resolution);
            scene.output = output;
            scene.velocity = velocity.defaults().into();
            scene.device.mass_kg = 10f64.powf(mass);
            scene.device.damping_n_s_per_m = damping;
            scene.device.stiffness_n_per_m = stiffness;
            scene.wall_hit.push_n = push * 5.9; // the force saturates beyond 1
            scene.wall_hit.push_n = scene.wall_hit.push_n.min(5.9);
            scene.wall_hit.push_by = if by_hand { PushBy::Hand } else { PushBy::Motor };
            scene.device.rest_position_m = 0.069;
            scene.device.start_position_m = 0.0695;
            scene.wall_hit.settle_s = 0.05;
            scene.wall_hit.window_s = 0.07;
            scene.wall_hit.rms_limit_m = 15.0 * scene.encoder.resolution_m;
            scene.amplifier = pole.then_some(Amplifier { bandwidth_hz: hz });
            scene.arm = arm.then_some(Arm {
                mass_kg: 1.0,
                damping_n_s_per_m: 10.0,
                stiffness_n_per_m: 200.0,
                rest_position_m: 0.06,
                grip_damping_n_s_per_m: 20.0,
                grip_stiffness_n_per_m: 1000.0,
            });
            let unit = scene.encoder.resolution_m * rate_hz * rate_hz;
            scene.accelerometer = Some(sensor.of(unit));
            scene
        },
    )
}

/// An accelerometer. Each part of the sensor may be present or absent.
#[derive(Clone, Copy, Debug)]
struct Sensor {
    /// Range of the sensor, from 0 (nearly no range) to 1 (the core's range).
    full_scale: f64,
    /// Resolution, as an exponent of ten relative to full scale.
    resolution: Option<f64>,
    noise: Option<f64>,
    /// Reading at rest, as a fraction of full scale.
    bias: f64,
    /// Whether the bias is half a step. Then a reading at rest is exactly between two steps.
    tie: bool,
    bandwidth_hz: Option<f64>,
}

fn sensors() -> impl Strategy<Value = Sensor> {
    let full_scale = prop_oneof![0.0..1.0f64, Just(1.0)];
    let bias = prop_oneof![Just(0.0), -1.0..1.0f64, -0.01..0.01f64];
    let power = |least: f64| prop::option::of(prop_oneof![-4.0..0.0f64, least..0.0]);
    let bias = (bias, any::<bool>());
    let sensor = (full_scale, power(-300.0), power(-8.0), bias, prop::option::of(1.0..4.0f64));
    sensor.prop_map(|(full_scale, resolution, noise, (bias, tie), bandwidth)| Sensor {
        full_scale,
        resolution,
        noise,
        bias,
        tie,
        bandwidth_hz: bandwidth.map(|power| 10f64.powf(power)),
    })
}

impl Sensor {
    /// The accelerometer of a scene. `unit` is one count per sample^2, in m/s^2.
    fn of(self, unit: f64) -> Accelerometer {
        let most = 127.0 * unit;
        let full_scale_m_per_s2 = 1e-3 * (most / 1e-3).powf(self.full_scale);
        let full_scale_m_per_s2 = full_scale_m_per_s2.clamp(1e-3, most.max(1e-3));
        let share = |power: Option<f64>| power.map_or(0.0, |power| 10f64.powf(power));
        let resolution_m_per_s2 = share(self.resolution) * full_scale_m_per_s2;
        let half = (0.5 * resolution_m_per_s2).copysign(self.bias);
        Accelerometer {
            full_scale_m_per_s2,
            resolution_m_per_s2,
            noise_m_per_s2_per_sqrt_hz: share(self.noise) * full_scale_m_per_s2,
            bias_m_per_s2: if self.tie { half } else { self.bias * full_scale_m_per_s2 },
            bandwidth_hz: self.bandwidth_hz,
        }
    }
}

/// Settings of an estimator. `tuning` is a number from 0 to 1. It selects a value in the range of the estimator's
/// tuning parameter.
pub(super) fn tuned(name: EstimatorName, tuning: f64, scene: &Scene) -> VelocitySettings {
    let settings = name.defaults();
    let (rate_hz, noise_m) = (scene.control.rate_hz, scene.encoder.resolution_m / 12f64.sqrt());
    // u of the Kalman filters, from 0.001 to 0.94
    let u = 0.00101 * 930f64.powf(tuning);
    match settings {
        VelocitySettings::Kalman2 { .. } => {
            settings.with_tuning(2.0 * u * u / (1.0 - u) * noise_m * rate_hz.powi(2))
        }
        VelocitySettings::Kalman3 { .. } => {
            let ratio = 2.0 * u.powi(3) / ((1.0 - u) * (2.0 - u));
            settings.with_tuning(ratio * noise_m * rate_hz.powi(3))
        }
        VelocitySettings::LeastSquares1 { .. } | VelocitySettings::LeastSquares2 { .. } => {
            settings.with_tuning((2.0 * 32f64.powf(tuning)).round())
        }
        VelocitySettings::WindowDifference { .. } => {
            settings.with_tuning(255f64.powf(tuning).round())
        }
        VelocitySettings::SecondOrder { .. } => {
            let quality = 0.3 + 1.7 * (tuning * 37.0).fract();
            settings.with_tuning(1e-4 * 4900f64.powf(tuning) * rate_hz).with_second(quality)
        }
        VelocitySettings::Smoothing { .. } => {
            let ratio = 1e6f64.powf((tuning * 37.0).fract());
            settings.with_tuning(1e-4 * 2400f64.powf(tuning) * rate_hz).with_second(ratio)
        }
        VelocitySettings::TrackingLead { .. } => {
            let lead = 2.0 * (tuning * 37.0).fract() - 1.0;
            settings.with_tuning(1e-4 * 2400f64.powf(tuning) * rate_hz).with_second(lead)
        }
        VelocitySettings::FoawEnd { .. } | VelocitySettings::FoawBest { .. } => {
            let noise = 1000.0 * (tuning * 37.0).fract().powi(6);
            settings.with_tuning((32f64.powf(tuning)).round()).with_second(noise)
        }
        VelocitySettings::LevantExplicit { .. } | VelocitySettings::LevantImplicit { .. } => {
            let unit = scene.encoder.resolution_m * rate_hz * rate_hz;
            let lambda_ratio = 0.5 + 2.5 * (tuning * 37.0).fract();
            settings.with_tuning(1.001e-6 * 9.9e9f64.powf(tuning) * unit).with_second(lambda_ratio)
        }
        VelocitySettings::Observer { .. } => {
            let mass_kg = scene.device.mass_kg * 10f64.powf(2.0 * (tuning * 37.0).fract() - 1.0);
            settings.with_tuning(rate_hz * 1.001e-3 * 199f64.powf(tuning)).with_second(mass_kg)
        }
        VelocitySettings::Fusion { .. } => {
            settings.with_tuning(rate_hz * 1.001e-3 * 199f64.powf(tuning))
        }
        VelocitySettings::Biquad { .. } => {
            let damping = 0.1 * 10f64.powf((tuning * 37.0).fract());
            settings.with_tuning(3e-3 * 30f64.powf(tuning) * rate_hz).with_second(damping)
        }
        VelocitySettings::Biquad2 { .. } => {
            let ratio = 0.5 * 4f64.powf((tuning * 37.0).fract());
            settings.with_tuning(3e-3 * 30f64.powf(tuning) * rate_hz).with_parameter(4, ratio)
        }
        _ => settings,
    }
}

fn walls() -> impl Strategy<Value = Vec<WallHit>> {
    let wall = (0.0..1.0f64, 0.0..6.5f64, -1.0..4.0f64, 0.0..1.0f64).prop_map(
        |(cutoff, stiffness, damping, start)| WallHit {
            velocity: VelocitySettings::Butterworth { cutoff_hz: cutoff }, // 0 to 1; `spread` converts it
            stiffness_n_per_m: 10f64.powf(stiffness),
            damping_n_s_per_m: 10f64.powf(damping),
            start_offset_counts: start,
        },
    );
    prop::collection::vec(wall, 1..20)
}

/// Maps cutoffs from 0 .. 1 to the range from 4e-5 to `highest`, times the scene's rate.
fn spread(hits: &mut [WallHit], scene: &Scene, highest: f64) {
    for hit in hits {
        let place = hit.velocity.cutoff_hz().unwrap();
        let cutoff_hz = scene.control.rate_hz * 4e-5 * (highest / 4e-5).powf(place);
        hit.velocity = hit.velocity.with_tuning(cutoff_hz);
    }
}

/// Checks that a scene has lanes, and compares the lanes with the scalar loop.
fn hold_in_lanes(prepared: &PreparedScene, hits: &[WallHit]) {
    assert!(lanes_for(prepared, Numeric::Fixed));
    hold(prepared, hits);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn random_scenes_are_the_same_bit_for_bit(scene in scenes(), mut hits in walls()) {
        prop_assume!(scene.check().is_ok());
        // cutoffs from the lowest to the highest that is accepted, with and without pre-warping
        spread(&mut hits, &scene, 0.379);
        hold_in_lanes(&PreparedScene::new(&scene).unwrap(), &hits);
    }

    #[test]
    fn random_scenes_of_every_estimator_are_the_same_bit_for_bit(
        scene in scenes(),
        mut hits in walls(),
        name in select(in_lanes().collect::<Vec<_>>()),
        (tuning, late) in (0.0..1.0f64, any::<bool>()),
    ) {
        let velocity = tuned(name, tuning, &scene);
        let mut scene = with_estimator(scene, velocity);
        scene.actuator.latency_known = name.sense() == Some(Sense::Force) && late;
        prop_assume!(scene.check().is_ok());
        spread(&mut hits, &scene, 0.24);
        hold_in_lanes(&PreparedScene::new(&scene).unwrap(), &hits);
    }

    #[test]
    fn a_window_of_any_length_is_the_same_bit_for_bit(
        scene in scenes(),
        mut hits in walls(),
        tuning in 0.0..1.0f64,
    ) {
        let velocity = tuned(EstimatorName::WindowDifference, tuning, &scene);
        let scene = with_estimator(scene, velocity);
        prop_assume!(scene.check().is_ok());
        spread(&mut hits, &scene, 0.24);
        hold_in_lanes(&PreparedScene::new(&scene).unwrap(), &hits);
    }

    #[test]
    fn an_observer_of_any_scene_is_the_same_bit_for_bit(
        scene in scenes(),
        mut hits in walls(),
        (tuning, late) in (0.0..1.0f64, any::<bool>()),
    ) {
        let velocity = tuned(EstimatorName::Observer, tuning, &scene);
        let mut scene = with_estimator(scene, velocity);
        scene.actuator.latency_known = late;
        prop_assume!(scene.check().is_ok());
        for hit in &mut hits {
            hit.velocity = hit.velocity.with_tuning(0.1 * scene.control.rate_hz);
        }
        hold_in_lanes(&PreparedScene::new(&scene).unwrap(), &hits);
    }

    #[test]
    fn fusion_beside_any_accelerometer_is_the_same_bit_for_bit(
        scene in scenes(),
        mut hits in walls(),
        (tuning, mode) in (0.0..1.0f64, any::<bool>()),
    ) {
        let velocity = tuned(EstimatorName::Fusion, tuning, &scene);
        let mut scene = with_estimator(scene, velocity);
        let body = Mode { mass_kg: 0.1, stiffness_n_per_m: 4e4, damping_n_s_per_m: 3.0 };
        scene.mode = mode.then_some(body);
        prop_assume!(scene.check().is_ok());
        for hit in &mut hits {
            hit.velocity = hit.velocity.with_tuning(0.1 * scene.control.rate_hz);
        }
        hold_in_lanes(&PreparedScene::new(&scene).unwrap(), &hits);
    }

    #[test]
    fn every_criterion_is_the_same_bit_for_bit(
        mut scene in scenes(),
        mut hits in walls(),
        criterion in select(&Criterion::ALL[..]),
        (motion, told, limit) in (any::<bool>(), any::<bool>(), -2.0..2.0f64),
    ) {
        let hit = &mut scene.wall_hit;
        hit.judge(criterion, Some(if motion { RmsOf::Motion } else { RmsOf::Counts }));
        hit.rms_limit_m = scene.encoder.resolution_m * 10f64.powf(limit);
        hit.felt_limit_db = 20.0 * limit;
        hit.force_rms_limit_n = Some(hit.push_n.abs().max(1e-3) * 10f64.powf(limit - 1.0));
        hit.settle_s = 0.02;
        hit.window_s = if criterion == Criterion::Felt { 0.5 } else { 0.07 };
        prop_assume!(scene.check().is_ok());
        spread(&mut hits, &scene, 0.379);
        hits.truncate(6);
        let told = told.then(|| PreparedScene::told(&scene)).transpose().unwrap();
        hold_in_lanes(&told.unwrap_or_else(|| PreparedScene::new(&scene).unwrap()), &hits);
    }
}
