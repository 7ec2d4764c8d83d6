//! Quiet walls against an independent program in `f64`, and the cutoff that is recommended by them.

use std::sync::atomic::AtomicBool;

use host_sim::{
    engine::Engine,
    scene::{Criterion, NamedScene, Walk},
    simulation::prepared::{Numeric, PreparedScene, WallHit},
    study::{probability::How, recommended::recommended, walk::walk},
};
use zwidth::experiment::Verdict;

/// A scene judged by quiet walls on a grid of its own, with another output period.
fn scene(name: &str, period: u32, [k, b]: [f64; 2]) -> NamedScene {
    let mut named = NamedScene::load(name).unwrap();
    let scene = &mut named.scene;
    scene.wall_hit.judge(Criterion::Quiet, None);
    scene.actuator.period = period;
    scene.walk = Walk {
        stiffness_start_n_per_m: k,
        stiffness_step_n_per_m: k,
        damping_start_n_s_per_m: b,
        damping_step_n_s_per_m: b,
        ..scene.walk
    };
    named
}

/// Cutoff, Hz, area, 10^6 N^2 s/m^2, and largest K, kN/m, by the other program.
type Row = (f64, f64, f64);

const LOOPS: [(&str, u32, [f64; 2], [Row; 3]); 5] = [
    (
        "paper-1um",
        10,
        [500.0, 5.0],
        [(300.0, 8.90, 47.0), (500.0, 10.9, 55.0), (1000.0, 1.93, 25.0)],
    ),
    (
        "paper-2um",
        10,
        [500.0, 5.0],
        [(200.0, 5.66, 36.0), (400.0, 7.95, 51.0), (700.0, 5.20, 46.0)],
    ),
    (
        "nucleo-f446re",
        10,
        [2000.0, 8.0],
        [(150.0, 15.7, 72.0), (300.0, 40.5, 144.0), (1000.0, 15.5, 114.0)],
    ),
    (
        "nucleo-f446re",
        5,
        [3000.0, 12.0],
        [(200.0, 44.1, 162.0), (300.0, 57.3, 201.0), (700.0, 32.8, 234.0)],
    ),
    (
        "nucleo-f446re",
        1,
        [5000.0, 20.0],
        [(150.0, 49.2, 200.0), (200.0, 83.0, 250.0), (700.0, 32.2, 345.0)],
    ),
];

#[test]
fn areas_of_quiet_walls_are_those_of_an_independent_program() {
    let stop = AtomicBool::new(false);
    for (name, period, steps, rows) in LOOPS {
        let scene = scene(name, period, steps).scene;
        let prepared = PreparedScene::new(&scene).unwrap();
        for (cutoff_hz, millions, peak) in rows {
            let filter = scene.velocity.at(cutoff_hz);
            let found =
                walk(Engine::lanes(), &prepared, Numeric::Fixed, filter, 0.0, &stop).unwrap();
            let share = found.area / (1e6 * millions);
            assert!((share - 1.0).abs() < 0.04, "{name} {period} {cutoff_hz}: {share}");
            let off = (found.stiffness_peak_n_per_m() - 1e3 * peak).abs();
            let allowed = f64::max(steps[0], 0.04 * 1e3 * peak);
            assert!(off <= allowed, "{name} {period} {cutoff_hz}: off by {off} N/m");
        }
    }
}

#[test]
fn the_recommended_cutoff_is_near_the_best_of_the_independent_program() {
    let stop = AtomicBool::new(false);
    let how = How { engine: Engine::lanes(), numeric: Numeric::Fixed, stop: &stop };
    for ((name, period, steps, _), best_hz) in LOOPS.iter().zip([500.0, 400.0, 350.0, 300.0, 200.0])
    {
        let scene = scene(name, *period, *steps);
        let list = [100.0, 200.0, 500.0, 1000.0, 2000.0];
        let study = recommended(how, &scene, &list, true, || ()).unwrap();
        let found = study.recommended.unwrap();
        let [low, high] = found.range_hz;
        assert!(low <= found.cutoff_hz && found.cutoff_hz <= high);
        let away = (found.cutoff_hz / best_hz).max(best_hz / found.cutoff_hz);
        assert!(away < 1.2, "{name} {period}: {found:?}");
        let all = study.cutoffs.iter().map(|result| result.boundaries.area());
        assert_eq!(all.fold(0.0, f64::max), found.area);
        assert!(found.is_open == [false; 2] && !found.is_cut);
    }
}

/// One push alone says less: a wall far above all others that holds at the scene's push, and not at 3 % more.
#[test]
fn a_wall_is_quiet_at_all_four_pushes_or_not_at_all() {
    let scene = scene("nucleo-f446re", 1, [5000.0, 20.0]).scene;
    let prepared = PreparedScene::new(&scene).unwrap();
    let (mut some, mut all) = (0, 0);
    for step in 0..40 {
        let hit = WallHit {
            velocity: scene.velocity.at(500.0),
            stiffness_n_per_m: 20_000.0 + 10_000.0 * f64::from(step),
            damping_n_s_per_m: 160.0,
            start_offset_counts: 0.0,
        };
        let pushes = prepared.reports(Numeric::Fixed, &hit, |_| ()).unwrap();
        assert_eq!(pushes.len(), 4);
        let held = pushes.iter().filter(|(_, report)| report.is_stable()).count();
        let verdict = prepared.verdict(Numeric::Fixed, &hit).unwrap();
        assert_eq!(verdict == Verdict::Stable, held == 4, "{hit:?}");
        some += u32::from(held > 0 && held < 4);
        all += u32::from(held == 4);
        for (push_n, report) in pushes {
            assert!(report.force_rms_n >= 0.0 && push_n > 0.0);
        }
    }
    assert!(some > 0 && all > 0, "{some} {all}");
}
