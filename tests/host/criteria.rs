//! Tests properties that the protocols and the criteria of stability must have.

use std::sync::atomic::AtomicBool;

use host_sim::{
    engine::Engine,
    numerics::integrator::Integrator,
    plant::{AnyPlant, Moment, Plant as _},
    scene::{
        Criterion, Device, NamedScene, PushBy, RmsOf, Scene, Walk,
        element::{Amplifier, Arm, Mode},
    },
    simulation::prepared::{Numeric, PreparedScene, WallHit},
    study::{
        How,
        limits::{Limit, Question, Situation, limits},
        sweep::filters,
        walk::walk,
    },
};
use zwidth::{VelocitySettings, experiment::Verdict};

mod felt;
mod protocols;
mod quiet;
mod second;
mod tables;

fn paper(name: &str) -> Scene {
    NamedScene::load(name).unwrap().scene
}

fn by_hand(mut scene: Scene) -> Scene {
    scene.wall_hit.push_by = PushBy::Hand;
    scene
}

/// A scene without the hand's constant push. Instead, the end of the hand's spring is moved by push / k.
fn with_moved_spring(mut scene: Scene) -> Scene {
    let Device { stiffness_n_per_m, rest_position_m, .. } = &mut scene.device;
    *rest_position_m += scene.wall_hit.push_n / *stiffness_n_per_m;
    scene.wall_hit.push_n = 0.0;
    scene
}

fn area(scene: &Scene, cutoff_hz: f64) -> f64 {
    area_of(scene, cutoff_hz, Numeric::Fixed, 0.0)
}

fn area_of(scene: &Scene, cutoff_hz: f64, numeric: Numeric, start: f64) -> f64 {
    let (prepared, stop) = (PreparedScene::new(scene).unwrap(), AtomicBool::new(false));
    let filter = scene.velocity.at(cutoff_hz);
    walk(Engine::lanes(), &prepared, numeric, filter, start, &stop).unwrap().area
}

fn within(found: f64, expected: f64, share: f64, what: &str) {
    let off = found / expected - 1.0;
    println!("{what}: {found:.4e}, expected {expected:.4e}, {:+.1} %", off * 100.0);
    assert!(off.abs() <= share, "{what}: {found:e} {expected:e}");
}

#[test]
fn a_hand_is_a_spring_whose_end_is_moved() {
    let hand = by_hand(paper("paper-1um"));
    let spring = with_moved_spring(paper("paper-1um"));
    let hit = WallHit {
        velocity: VelocitySettings::Butterworth { cutoff_hz: 500.0 },
        stiffness_n_per_m: 20_000.0,
        damping_n_s_per_m: 100.0,
        start_offset_counts: 0.5,
    };
    let positions = [hand, spring].map(|scene| {
        let mut positions = vec![];
        let prepared = PreparedScene::new(&scene).unwrap();
        prepared.hit(Numeric::Fixed, &hit, |sample| positions.push(sample.position_m)).unwrap();
        positions
    });
    let [hand, spring] = &positions;
    // The comparison ends before rounding gives the two scenes different counts.
    let apart = hand.iter().zip(spring).take(2000).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-14, "{apart:e}");
    assert!(hand[6000] > 0.069, "it reached the wall: {}", hand[6000]);
}

#[test]
fn every_plant_moves_under_a_hand_as_its_integrator_says() {
    let amplifier = Some(Amplifier { bandwidth_hz: 900.0 });
    let mode = Some(Mode { mass_kg: 0.15, stiffness_n_per_m: 6e4, damping_n_s_per_m: 4.0 });
    let arm = Some(Arm {
        mass_kg: 1.2,
        damping_n_s_per_m: 12.0,
        stiffness_n_per_m: 250.0,
        rest_position_m: 0.05,
        grip_damping_n_s_per_m: 25.0,
        grip_stiffness_n_per_m: 1200.0,
    });
    for (amplifier, mode, arm) in [
        (None, None, None),
        (amplifier, None, None),
        (None, mode, None),
        (amplifier, None, arm),
        (None, mode, arm),
        (amplifier, mode, arm),
    ] {
        for stiffness_n_per_m in [11.0626, 0.0] {
            let mut exact = by_hand(paper("paper-1um"));
            exact.device.stiffness_n_per_m = stiffness_n_per_m;
            (exact.amplifier, exact.mode, exact.arm) = (amplifier, mode, arm);
            let mut integrated = exact.clone();
            integrated.integrator = Some(Integrator::Rk4 { steps_per_sample: 40 });
            exact.check().unwrap();
            let [exact, integrated] =
                [exact, integrated].map(|scene| AnyPlant::of(&scene, 1e-4, 0.3));
            let mut at = [exact.at_rest(0.0), integrated.at_rest(0.0)];
            for n in 0..2000u32 {
                let forces = [f64::from(n % 7) - 3.0, f64::from((n + 1) % 7) - 3.0];
                let advanced = |plant: &AnyPlant, state| match n % 5 {
                    0 => plant.advance_split(state, forces[0], forces[1]),
                    _ => plant.advance(state, forces[0]),
                };
                at = [advanced(&exact, &at[0]), advanced(&integrated, &at[1])];
            }
            let [a, b] = [exact.position_m(&at[0]), integrated.position_m(&at[1])];
            assert!((a - b).abs() < 1e-9, "{stiffness_n_per_m} {mode:?} {arm:?}: {a} {b}");
            assert!(a > 1e-3, "the hand moves it: {a}");
        }
    }
}

#[test]
fn late_readings_know_of_the_hand() {
    let mut scene = by_hand(paper("paper-1um"));
    scene.wall_hit.push_n = 40.0;
    scene.jitter = Some(host_sim::scene::element::Jitter { peak_s: 9e-5, seed: 3 });
    let plant = AnyPlant::of(&scene, 1e-4, 0.0);
    let fine = AnyPlant::unsensed(&scene, 1e-7, 0.0);
    let state = plant.at_rest(0.0);
    let read_m = plant.reading_m(&state, &Moment { index: 4, before_n: 0.0, after_n: 0.0 });
    let mut later = fine.at_rest(0.0);
    let mut steps = 0;
    while fine.position_m(&later) < read_m && steps < 1000 {
        later = fine.advance(&later, 0.0);
        steps += 1;
    }
    // 40 N on the handle's mass for up to 90 us give 0.4 um. The spring adds its own force.
    let off_m = fine.position_m(&later) - read_m;
    assert!(steps > 100 && steps < 900 && off_m < 2e-8, "{steps} {off_m:e} {read_m:e}");
}

#[test]
fn without_saturation_it_does_not_matter_who_pushes() {
    let mut motor = paper("paper-2um");
    motor.actuator.limit_v = 100.0;
    motor.walk.stiffness_step_n_per_m = 8000.0;
    motor.walk.damping_step_n_s_per_m = 40.0;
    let [motor, hand] = [motor.clone(), by_hand(motor)].map(|scene| area(&scene, 700.0));
    within(hand, motor, 0.05, "hand against motor");
    let mut limited = paper("paper-2um");
    limited.walk.stiffness_step_n_per_m = 8000.0;
    limited.walk.damping_step_n_s_per_m = 40.0;
    assert!(area(&by_hand(limited.clone()), 700.0) > 3.0 * area(&limited, 700.0));
}

#[test]
fn a_hand_may_push_harder_than_the_actuator_can() {
    let mut scene = by_hand(paper("paper-1um"));
    scene.wall_hit.push_n = 50.0;
    scene.check().unwrap();
    scene.wall_hit.push_n = 2e5;
    let refused = scene.check().unwrap_err();
    let expected = "wall_hit.push_n with push_by = \"hand\" is 200000, allowed -100000 to 100000";
    assert_eq!(refused, expected);
}

#[test]
fn limits_that_share_hits_are_the_walks_one_by_one() {
    let mut scene = paper("paper-2um");
    scene.device.start_position_m = 0.068;
    scene.wall_hit.settle_s = 0.5;
    scene.wall_hit.window_s = 0.5;
    let grid = Walk {
        stiffness_start_n_per_m: 4000.0,
        stiffness_step_n_per_m: 4000.0,
        damping_start_n_s_per_m: 20.0,
        damping_step_n_s_per_m: 40.0,
        ..scene.walk
    };
    let mut arm = scene.named_arm("light").unwrap();
    arm.mass_kg = 0.7;
    scene.arms.insert("mine".into(), arm);
    let situation = |push, arm: Option<&str>| Situation { push, arm: arm.map(str::to_owned) };
    let question = Question {
        limits: vec![
            Limit::Rms(4e-6),
            Limit::Felt(20.0),
            Limit::Rms(15e-6),
            Limit::Felt(35.0),
            Limit::Quiet(0.4),
        ],
        rms_of: RmsOf::Motion,
        filters: filters(&scene.velocity, &[1000.0, 300.0]),
        repeats: 2,
        walk: grid,
        situations: vec![situation(PushBy::Motor, None), situation(PushBy::Hand, Some("mine"))],
        told: true,
    };
    let stop = AtomicBool::new(false);
    let all = [Engine::lanes(), Engine::Core].map(|engine| {
        limits(How { engine, numeric: Numeric::Fixed, stop: &stop }, &scene, &question, || ())
            .unwrap()
    });
    assert_eq!(format!("{:?}", all[0]), format!("{:?}", all[1]));
    let [results, _] = all;
    assert_eq!(results.len(), 5 * 3, "two situations and the worst of them");
    for result in &results[..10] {
        let asked = result.situation.clone().unwrap();
        let mut own = scene.clone();
        own.walk = grid;
        own.wall_hit.push_by = asked.push;
        own.wall_hit.rms_of = Some(RmsOf::Motion);
        own.arm = asked.arm.map(|name| scene.arms[&name]);
        match result.limit {
            Limit::Rms(limit_m) => own.wall_hit.rms_limit_m = limit_m,
            Limit::Felt(limit_db) => {
                own.wall_hit.criterion = Criterion::Felt;
                own.wall_hit.felt_limit_db = limit_db;
            }
            Limit::Quiet(limit_n) => {
                own.wall_hit.judge(Criterion::Quiet, Some(RmsOf::Motion));
                own.wall_hit.force_rms_limit_n = Some(limit_n);
            }
        }
        let prepared = PreparedScene::new(&own).unwrap();
        let told = PreparedScene::told(&own).unwrap();
        let area = |prepared, filter, offset| {
            walk(Engine::lanes(), prepared, Numeric::Fixed, filter, offset, &stop).unwrap().area
        };
        assert_eq!(result.result.cutoffs.len(), 2);
        for cutoff in &result.result.cutoffs {
            let found: Vec<f64> = cutoff.boundaries.iter().map(|b| b.area).collect();
            let expected = [0.0, 0.5].map(|offset| area(&prepared, cutoff.velocity, offset));
            assert_eq!(found, expected, "{:?} {}", result.limit, cutoff.cutoff_hz);
        }
        let found: Vec<f64> = result.told.iter().map(|b| b.area).collect();
        let expected =
            [0.0, 0.5].map(|offset| area(&told, VelocitySettings::Difference {}, offset));
        assert_eq!(found, expected, "{:?}", result.limit);
    }
    for worst in &results[10..] {
        let of_limit = results[..10].iter().filter(|other| other.limit == worst.limit);
        let areas = of_limit.map(|other| other.result.cutoffs[0].boundaries.area());
        assert_eq!(worst.result.cutoffs[0].boundaries.area(), areas.fold(f64::INFINITY, f64::min));
    }
    assert!(results[0].area() > 1e5, "{}", results[0].area());
}

#[test]
fn each_criterion_is_what_its_hit_shows() {
    let scene = paper("paper-2um");
    let base = PreparedScene::new(&scene).unwrap().with_felt();
    let (mut verdicts, mut limited) = ([0; 2], 0);
    for (stiffness_n_per_m, damping_n_s_per_m) in
        [(4000.0, 20.0), (30_000.0, 100.0), (60_000.0, 300.0), (20_000.0, 500.0), (90_000.0, 500.0)]
    {
        let hit = WallHit {
            velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
            stiffness_n_per_m,
            damping_n_s_per_m,
            start_offset_counts: 0.3,
        };
        let report = base.report(Numeric::Fixed, &hit).unwrap();
        limited += u32::from(report.at_limit_fraction > 0.0);
        for (criterion, rms_of) in [
            (Criterion::Rms, RmsOf::Counts),
            (Criterion::Rms, RmsOf::Motion),
            (Criterion::Unsaturated, RmsOf::Motion),
            (Criterion::Felt, RmsOf::Counts),
        ] {
            for limit in [0.9, 1.1] {
                let mut scene = scene.clone();
                let by = &mut scene.wall_hit;
                by.judge(criterion, Some(rms_of));
                let counts = rms_of == RmsOf::Counts;
                let rms_m = if counts { report.rms_m } else { report.rms_motion_m };
                by.rms_limit_m = (limit * rms_m).max(1e-8);
                by.felt_limit_db = report.sensation_db.unwrap().max(-50.0) + limit - 1.0;
                let verdict =
                    PreparedScene::new(&scene).unwrap().verdict(Numeric::Fixed, &hit).unwrap();
                let unsaturated = report.at_limit_fraction == 0.0;
                let quiet = limit > 1.0 || (rms_m == 0.0 && criterion != Criterion::Felt);
                let stable = quiet && (criterion != Criterion::Unsaturated || unsaturated);
                assert_eq!(verdict == Verdict::Stable, stable, "{criterion:?} {limit} {report:?}");
                verdicts[usize::from(stable)] += 1;
            }
        }
    }
    assert!(verdicts[0] > 10 && verdicts[1] > 10 && limited > 0, "{verdicts:?} {limited}");
}
