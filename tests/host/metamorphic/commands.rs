//! Compares commands with other commands: `walk` with the walls of `grid`, `grid` with `hit`, and `sweep` with `walk`.

use std::{collections::BTreeMap, sync::atomic::AtomicBool};

use host_sim::{
    engine::{Depth, Engine, stream},
    scene::{Device, NamedScene, Scene, Walk},
    simulation::prepared::{Numeric, PreparedScene, WallHit},
    study::{
        boundary::Boundary,
        sweep::{Plan, start_offset_counts, sweep},
        walk::walk,
    },
};
use zwidth::{
    VelocitySettings,
    experiment::{Ended, Verdict},
};

use crate::dice::{Dice, cases};

static STOP: AtomicBool = AtomicBool::new(false);

/// The paper's loop with a device like the paper's. The walks of this scene rise, fall and end within a few dozen hits.
fn scene(dice: &mut Dice) -> Scene {
    let mut scene = dice.scene();
    let paper = NamedScene::load("paper-1um").unwrap().scene;
    scene.device = Device { mass_kg: dice.between(0.2, 0.6), ..paper.device };
    scene.wall = paper.wall;
    scene.control = paper.control;
    scene.sweep = paper.sweep;
    scene.actuator.period = dice.one_of(&[5, 10]);
    scene.actuator.latency = dice.between(5.0, 12.0);
    scene.encoder.resolution_m = dice.decades(1e-6, 2e-6);
    scene.wall_hit.push_n = dice.between(0.4, 0.6) * scene.full_scale_n();
    (scene.wall_hit.settle_s, scene.wall_hit.window_s) = (1.6, 0.4);
    scene.walk = Walk {
        stiffness_start_n_per_m: dice.between(1000.0, 3000.0),
        stiffness_step_n_per_m: dice.between(4000.0, 8000.0),
        stiffness_max_n_per_m: dice.one_of(&[30e3, 150e3]),
        damping_start_n_s_per_m: dice.between(5.0, 20.0),
        damping_step_n_s_per_m: dice.between(30.0, 60.0),
        damping_max_n_s_per_m: dice.one_of(&[200.0, 800.0]),
    };
    scene
}

fn filter(scene: &Scene, dice: &mut Dice) -> VelocitySettings {
    scene.velocity.at(dice.decades(100.0, 1500.0))
}

/// Walks as theory.md describes, with verdicts from the function `stable`. K rises to the first unstable wall. The last
/// stable K is the boundary. Then B rises by a step. If the same K is stable there, K rises again. Otherwise K falls to
/// the first stable value. The walk ends when no K is stable or B has its largest value.
fn walked(
    scene: &Scene,
    mut stable: impl FnMut(i32, i32) -> bool,
) -> (Vec<[f64; 2]>, u64, Option<Ended>) {
    let plan = &scene.walk;
    let k = |n: i32| plan.stiffness_start_n_per_m + f64::from(n) * plan.stiffness_step_n_per_m;
    let b = |n: i32| plan.damping_start_n_s_per_m + f64::from(n) * plan.damping_step_n_s_per_m;
    let (mut points, mut hits, mut capped) = (vec![], 0, false);
    let mut hit = |hits: &mut u64, n: i32, m: i32| {
        *hits += 1;
        stable(n, m)
    };
    if !hit(&mut hits, 0, 0) {
        return (points, hits, None);
    }
    let (mut n, mut m, mut is_stable) = (0, 0, true);
    loop {
        if is_stable {
            while k(n + 1) <= plan.stiffness_max_n_per_m && hit(&mut hits, n + 1, m) {
                n += 1;
            }
            capped |= k(n + 1) > plan.stiffness_max_n_per_m;
        } else {
            n -= 1;
            while k(n) > 0.0 && !hit(&mut hits, n, m) {
                n -= 1;
            }
            if k(n) <= 0.0 {
                let ended = if capped { Ended::StiffnessMax } else { Ended::Closed };
                return (points, hits, Some(ended));
            }
        }
        points.push([b(m), k(n)]);
        if b(m + 1) > plan.damping_max_n_s_per_m {
            let ended = if capped { Ended::BothMax } else { Ended::DampingMax };
            return (points, hits, Some(ended));
        }
        m += 1;
        is_stable = hit(&mut hits, n, m);
    }
}

fn pairs(boundary: &Boundary) -> Vec<[f64; 2]> {
    let pair = |point: &host_sim::study::boundary::BoundaryPoint| {
        [point.damping_n_s_per_m, point.stiffness_n_per_m]
    };
    boundary.points.iter().map(pair).collect()
}

#[test]
fn a_walk_is_the_walls_of_a_grid_which_are_hits() {
    let mut bent = 0;
    cases(5, |dice| {
        let scene = scene(dice);
        let prepared = PreparedScene::new(&scene).unwrap();
        let velocity = filter(&scene, dice);
        let start_offset_counts = dice.one_of(&[0.0, 0.25, 0.5]);
        let plan = &scene.walk;
        let rows = |first: f64, step: f64, max: f64| ((max - first) / step) as i32 + 1;
        let ks = rows(
            plan.stiffness_start_n_per_m,
            plan.stiffness_step_n_per_m,
            plan.stiffness_max_n_per_m,
        );
        let bs = rows(
            plan.damping_start_n_s_per_m,
            plan.damping_step_n_s_per_m,
            plan.damping_max_n_s_per_m,
        );
        let wall = |number: u64| {
            let (n, m) = (number as i32 % ks, number as i32 / ks);
            WallHit {
                velocity,
                stiffness_n_per_m: plan.stiffness_start_n_per_m
                    + f64::from(n) * plan.stiffness_step_n_per_m,
                damping_n_s_per_m: plan.damping_start_n_s_per_m
                    + f64::from(m) * plan.damping_step_n_s_per_m,
                start_offset_counts,
            }
        };
        let numeric = dice.one_of(&[Numeric::Fixed, Numeric::F64]);
        let mut table = BTreeMap::new();
        let total = (ks * bs) as u64;
        stream(
            Engine::lanes(),
            &prepared,
            numeric,
            Depth::Whole,
            total,
            wall,
            &STOP,
            |number, outcome| {
                let outcome = outcome.map_or((Verdict::Unstable, None), |o| (o.verdict, o.rms_m));
                table.insert((number as i32 % ks, number as i32 / ks), outcome);
                Ok(())
            },
        )
        .unwrap();
        for number in (0..total).step_by(7) {
            let hit = prepared.hit(numeric, &wall(number), |_| ());
            let (verdict, rms_m) = table[&(number as i32 % ks, number as i32 / ks)];
            assert_eq!(hit.map(|hit| (hit.verdict, Some(hit.rms_m))), Ok((verdict, rms_m)));
        }
        let (points, hits, ended) = walked(&scene, |n, m| table[&(n, m)].0 == Verdict::Stable);
        for engine in [Engine::lanes(), Engine::Core] {
            let found =
                walk(engine, &prepared, numeric, velocity, start_offset_counts, &STOP).unwrap();
            assert_eq!(
                (pairs(&found), found.hits, found.ended),
                (points.clone(), hits, ended),
                "{}: {scene:?}",
                dice.name
            );
            let area = points.iter().map(|[_, k]| k * plan.damping_step_n_s_per_m).sum::<f64>();
            assert!((found.area - area).abs() <= 1e-12 * area);
        }
        let [first, .., last] = &points[..] else { return };
        bent += u32::from(points.iter().any(|[_, k]| *k != first[1] && *k != last[1]));
    });
    assert!(bent >= 2, "{bent} walks whose boundary rises or falls");
}

#[test]
fn a_sweep_of_one_cutoff_is_its_walks() {
    cases(4, |dice| {
        let scene = scene(dice);
        let prepared = PreparedScene::new(&scene).unwrap();
        let velocity = filter(&scene, dice);
        let repeats = 1 + dice.below(4);
        let plan = Plan { name: "one", prepared: &prepared, filters: &[velocity] };
        let engine = Engine::lanes();
        let swept = sweep(engine, &[plan], Numeric::Fixed, repeats, &STOP, |_| ()).unwrap();
        let [result] = &swept[0].cutoffs[..] else { panic!("one cutoff") };
        let walks = (0..repeats).map(|n| {
            let start = f64::from(n) / f64::from(repeats);
            assert_eq!(start, start_offset_counts(n, repeats));
            walk(Engine::Core, &prepared, Numeric::Fixed, velocity, start, &STOP).unwrap()
        });
        let walks: Vec<Boundary> = walks.collect();
        assert_eq!(*result.boundaries, walks, "{}: {scene:?}", dice.name);
        let areas = walks.iter().map(|walk| walk.area);
        let mean = areas.clone().sum::<f64>() / f64::from(repeats);
        assert!((result.boundaries.area() - mean).abs() <= 1e-12 * mean);
        let (low, high) = (areas.clone().fold(f64::INFINITY, f64::min), areas.fold(0.0, f64::max));
        assert_eq!(result.boundaries.area_range(), [low, high]);
    });
}
