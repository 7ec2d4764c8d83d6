//! Tests shifted and mirrored scenes, neutral elements, and the orders of the integrators.

use host_sim::{
    numerics::integrator::Integrator,
    plant::{AnyPlant, Plant as _, Sensing},
    scene::{
        Accelerometer, Rounding, Scene,
        element::{
            Amplifier, AmplifierError, Arm, Cogging, EncoderError, EncoderNoise, Friction, Jitter,
            Mode, Travel,
        },
    },
    simulation::prepared::{Numeric, WallHit},
};

use crate::dice::{Dice, cases, trace};

#[test]
fn a_device_elsewhere_moves_alike() {
    cases(25, |dice| {
        let mut scene = dice.scene();
        dice.linear_elements(&mut scene);
        // Whole counts are then exact in binary.
        scene.encoder.resolution_m = dice.one_of(&[1.0, 2.0, 8.0]) / f64::from(1 << 20);
        // The start is not at an edge of a count, where rounding decides.
        let hit = WallHit { start_offset_counts: 0.3, ..dice.wall(&scene) };
        let counts = i32::try_from(dice.below(200_000)).unwrap() - 100_000;
        let far_m = f64::from(counts) * scene.encoder.resolution_m;
        let mut far = scene.clone();
        far.device.rest_position_m += far_m;
        far.device.start_position_m += far_m;
        far.wall.position_m += far_m;
        if let Some(arm) = &mut far.arm {
            arm.rest_position_m += far_m;
        }
        let numeric = dice.one_of(&[Numeric::Fixed, Numeric::F64]);
        let [here, there] = [&scene, &far].map(|scene| trace(scene, &hit, numeric));
        for (here, there) in here.iter().zip(&there) {
            assert_eq!(there.count - here.count, counts, "{}: {scene:?} {hit:?}", dice.name);
            assert_eq!((there.velocity, there.rendered), (here.velocity, here.rendered));
        }
    });
}

#[test]
fn a_late_reading_is_of_the_way_to_the_next_sample() {
    cases(25, |dice| {
        let mut scene = dice.scene();
        dice.linear_elements(&mut scene);
        scene.device.rest_position_m = dice.between(-0.02, 0.02);
        scene.actuator.latency = scene.actuator.latency.max(1.0);
        let peak_s = dice.between(0.0, 0.99) / scene.control.rate_hz;
        scene.jitter = Some(Jitter { peak_s, seed: dice.below(1000) });
        let hit = dice.wall(&scene);
        let resolution_m = scene.encoder.resolution_m;
        for around in trace(&scene, &hit, Numeric::F64).windows(5) {
            let at_m: [f64; 5] = std::array::from_fn(|n| around[n].position_m);
            // How far a reversal within the sample may reach beyond the positions at its ends.
            let bend_m = |n: usize| (at_m[n + 1] - 2.0 * at_m[n] + at_m[n - 1]).abs();
            let beyond_m = resolution_m + bend_m(1) + bend_m(2) + bend_m(3);
            let (low_m, high_m) = (at_m[2].min(at_m[3]), at_m[2].max(at_m[3]));
            let read_m = f64::from(around[2].count) * resolution_m;
            assert!(
                read_m >= low_m - beyond_m && read_m <= high_m + beyond_m,
                "{}: {read_m} of {low_m} to {high_m} at sample {} of {scene:?}",
                dice.name,
                around[2].index
            );
        }
    });
}

/// The scene mirrored at position 0. Its plant is mirrored, and so are the errors of its readings.
fn mirrored(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    scene.device.rest_position_m *= -1.0;
    if let Some(arm) = &mut scene.arm {
        arm.rest_position_m *= -1.0;
    }
    if let Some(Cogging { phase_rad, .. }) = &mut scene.cogging {
        *phase_rad *= -1.0;
    }
    if let Some(EncoderError { phase_rad, .. }) = &mut scene.encoder_error {
        *phase_rad *= -1.0;
    }
    if let Some(Travel::Spring { low_m, high_m, .. } | Travel::Rigid { low_m, high_m, .. }) =
        &mut scene.travel
    {
        (*low_m, *high_m) = (-*high_m, -*low_m);
    }
    scene
}

#[test]
fn a_mirrored_plant_moves_the_other_way() {
    cases(25, |dice| {
        let mut scene = dice.scene();
        dice.linear_elements(&mut scene);
        dice.encoder_elements(&mut scene);
        if dice.coin() {
            dice.nonlinear_elements(&mut scene);
        }
        let (sample_s, fraction) = (1.0 / scene.control.rate_hz, scene.actuator.latency.fract());
        let plants = [scene.clone(), mirrored(&scene)];
        let sensing = plants.clone().map(|scene| Sensing::of(&scene));
        let plants = plants.map(|scene| AnyPlant::unsensed(&scene, sample_s, fraction));
        let start_m = dice.between(0.0, 0.01);
        let mut states = [plants[0].at_rest(start_m), plants[1].at_rest(-start_m)];
        for sample in 0..2000 {
            let (before_n, after_n) = (dice.between(-3.0, 3.0), dice.between(-3.0, 3.0));
            states[0] = plants[0].advance_split(&states[0], before_n, after_n);
            states[1] = plants[1].advance_split(&states[1], -before_n, -after_n);
            let [here, there] = [0, 1].map(|side| plants[side].position_m(&states[side]));
            assert_eq!(here, -there, "{}: sample {sample} of {scene:?}", dice.name);
            let shown = |side: usize, at: f64| sensing[side].shown_m(at, 0, 0);
            assert_eq!(shown(0, here), -shown(1, there));
        }
    });
}

#[test]
fn an_element_of_no_size_changes_no_bit() {
    type Edit = fn(&mut Scene);
    let exact: [(&str, Edit); 7] = [
        ("amplifier_error", |scene| scene.amplifier_error = Some(AmplifierError { cubic: 0.0 })),
        ("encoder_error", |scene| {
            let (first_m, second_m, phase_rad) = (0.0, 0.0, 1.0);
            scene.encoder_error =
                Some(EncoderError { cycle_m: 1e-4, first_m, second_m, phase_rad });
        }),
        ("encoder_noise", |scene| scene.encoder_noise = Some(EncoderNoise { rms_m: 0.0, seed: 3 })),
        ("accelerometer", |scene| {
            scene.accelerometer = Some(Accelerometer {
                full_scale_m_per_s2: 10.0,
                resolution_m_per_s2: 0.1,
                noise_m_per_s2_per_sqrt_hz: 0.1,
                bias_m_per_s2: 0.1,
                bandwidth_hz: None,
            });
        }),
        ("latency_known", |scene| scene.actuator.latency_known = true),
        ("walk and sweep", |scene| {
            scene.walk.stiffness_start_n_per_m = 77.0;
            scene.sweep.cutoffs_hz = vec![11.0];
        }),
        ("rms limit", |scene| scene.wall_hit.rms_limit_m *= 2.0),
    ];
    let integrated: [(&str, Edit); 2] = [
        ("cogging", |scene| {
            scene.cogging = Some(Cogging { amplitude_n: 0.0, pitch_m: 1e-3, phase_rad: 0.5 });
        }),
        ("travel", |scene| {
            scene.travel = Some(Travel::Rigid { low_m: -1.0, high_m: 1.0, restitution: 0.5 });
        }),
    ];
    cases(6, |dice| {
        let mut scene = dice.scene();
        dice.linear_elements(&mut scene);
        let hit = dice.wall(&scene);
        let mut stepped = scene.clone();
        stepped.integrator = Some(Integrator::Rk4 { steps_per_sample: 16 });
        let rows = exact.iter().map(|row| (&scene, row));
        let stepped_rows = integrated.iter().map(|row| (&stepped, row));
        for (scene, (name, edit)) in rows.chain(stepped_rows) {
            let mut with = scene.clone();
            edit(&mut with);
            if scene.check().is_err() {
                continue; // the steps are too long for these elements
            }
            let [plain, with] = [scene, &with].map(|scene| trace(scene, &hit, Numeric::Fixed));
            assert!(plain == with, "{}: {name} in {scene:?}", dice.name);
        }
    });
}

/// Largest distance between two runs in their first samples, relative to the largest position.
fn apart(scene: &Scene, other: &Scene, hit: &WallHit) -> f64 {
    let [one, other] = [scene, other].map(|scene| trace(scene, hit, Numeric::F64));
    let largest = one.iter().map(|sample| sample.position_m.abs()).fold(0.0, f64::max);
    let distance = |n: usize| (one[n].position_m - other[n].position_m).abs();
    (0..one.len()).map(distance).fold(0.0, f64::max) / largest
}

#[test]
fn an_element_that_hardly_acts_hardly_changes_anything() {
    type Edit = fn(&mut Scene);
    let edits: [(&str, Edit); 6] = [
        ("amplifier", |scene| scene.amplifier = Some(Amplifier { bandwidth_hz: 1e7 })),
        ("mode", |scene| {
            let (stiffness_n_per_m, damping_n_s_per_m) = (0.0, 0.0);
            scene.mode = Some(Mode { mass_kg: 0.1, stiffness_n_per_m, damping_n_s_per_m });
        }),
        ("arm", |scene| {
            scene.arm = Some(Arm {
                mass_kg: 1.0,
                damping_n_s_per_m: 5.0,
                stiffness_n_per_m: 100.0,
                rest_position_m: 0.05,
                grip_damping_n_s_per_m: 0.0,
                grip_stiffness_n_per_m: 0.0,
            });
        }),
        ("jitter", |scene| scene.jitter = Some(Jitter { peak_s: 0.0, seed: 1 })),
        ("friction", |scene| {
            let (coulomb_n, static_n, stribeck_speed_m_per_s) = (1e-12, 1e-12, 0.01);
            scene.friction = Some(Friction { coulomb_n, static_n, stribeck_speed_m_per_s });
            scene.integrator = Some(Integrator::Rk4 { steps_per_sample: 64 });
        }),
        ("integrator", |scene| {
            let (relative_tolerance, absolute_tolerance_m) = (1e-12, 1e-15);
            scene.integrator =
                Some(Integrator::DormandPrince { relative_tolerance, absolute_tolerance_m });
        }),
    ];
    cases(6, |dice| {
        let mut scene = dice.scene();
        // Free motion only: in contact, a difference of one count has unlimited effects.
        scene.wall.position_m = 500.0;
        (scene.wall_hit.settle_s, scene.wall_hit.window_s) = (0.05, 0.05);
        scene.encoder.resolution_m = 1e-3;
        let hit = dice.wall(&scene);
        for (name, edit) in edits {
            let mut with = scene.clone();
            edit(&mut with);
            let off = apart(&scene, &with, &hit);
            // An amplifier of 10 MHz is 16 ns late, relative to some ms.
            let limit = if name == "amplifier" { 1e-4 } else { 1e-9 };
            assert!(off < limit, "{}: {name} by {off:e} in {scene:?}", dice.name);
        }
    });
}

#[test]
fn integrators_come_to_the_exact_step_with_their_order() {
    let device = |dice: &mut Dice| {
        let mut scene = dice.scene();
        scene.device.mass_kg = 0.1;
        scene.device.stiffness_n_per_m = dice.between(4e3, 2e4);
        scene.device.damping_n_s_per_m = dice.between(0.0, 5.0);
        scene
    };
    cases(10, |dice| {
        let scene = device(dice);
        let sample_s = 1e-3;
        let forces: Vec<f64> = (0..40).map(|_| dice.between(-5.0, 5.0)).collect();
        let chain = scene.chain();
        let run = |integrator: Option<Integrator>| {
            let plant = match integrator {
                None => AnyPlant::exact(&chain, sample_s, 0.0),
                Some(integrator) => {
                    let nonlinear = scene.nonlinear();
                    AnyPlant::integrated(&chain, &nonlinear, integrator, sample_s, 0.0)
                }
            };
            let start = plant.at_rest(0.003);
            let last = forces.iter().fold(start, |state, &force_n| plant.advance(&state, force_n));
            [plant.position_m(&last), 1e-2 * plant.speed_m_per_s(&last)]
        };
        let exact = run(None);
        let error = |integrator| {
            let [x, v] = run(Some(integrator));
            (x - exact[0]).hypot(v - exact[1])
        };
        let euler = |steps_per_sample| error(Integrator::SemiImplicitEuler { steps_per_sample });
        let rk4 = |steps_per_sample| error(Integrator::Rk4 { steps_per_sample });
        for (method, order, steps) in [(&euler as &dyn Fn(u32) -> f64, 1.0, 256), (&rk4, 4.0, 8)] {
            let found = (method(steps) / method(2 * steps)).log2();
            assert!((found - order).abs() < 0.2, "{}: {found} for {order} {scene:?}", dice.name);
        }
        let tolerant = |relative_tolerance: f64| {
            let absolute_tolerance_m = 1e-3 * relative_tolerance;
            error(Integrator::DormandPrince { relative_tolerance, absolute_tolerance_m })
        };
        assert!(tolerant(1e-9) < 1e-9 && tolerant(1e-9) < 0.1 * tolerant(1e-5).max(1e-10));
    });
}

#[test]
fn a_count_that_is_rounded_is_a_floor_half_a_count_on() {
    cases(20, |dice| {
        let mut scene = dice.scene();
        scene.encoder.resolution_m = dice.one_of(&[1.0, 2.0, 8.0]) / f64::from(1 << 20);
        scene.encoder.rounding = Rounding::Floor;
        let hit = dice.wall(&scene);
        let half_m = 0.5 * scene.encoder.resolution_m;
        // Everything is half a count lower, except for the wall, which both scenes round to a count.
        let wall_counts = (scene.wall.position_m / scene.encoder.resolution_m).round();
        scene.wall.position_m = wall_counts * scene.encoder.resolution_m;
        let mut lower = scene.clone();
        lower.encoder.rounding = Rounding::Round;
        lower.device.rest_position_m -= half_m;
        lower.device.start_position_m -= half_m;
        let [one, other] = [&scene, &lower].map(|scene| trace(scene, &hit, Numeric::Fixed));
        for (one, other) in one.iter().zip(&other) {
            assert_eq!(one.count, other.count, "{}: {scene:?}", dice.name);
            assert_eq!(one.rendered, other.rendered);
        }
    });
}
