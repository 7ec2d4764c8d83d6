//! Compares quiet walls with an independent program in `f64`. Also tests the recommended cutoff for quiet walls.

use std::sync::atomic::AtomicBool;

use host_sim::{
    engine::{Depth, Engine, stream},
    scene::{Criterion, NamedScene, Units, Walk},
    simulation::prepared::{Numeric, PreparedScene, WallHit},
    study::{How, recommended::recommended, walk::walk},
};
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use zwidth::experiment::Verdict;

/// A scene with the criterion `quiet`, with its own grid and another output period.
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

/// Results of the independent program: the cutoff in Hz, the area in 10^6 N^2 s/m^2, and the largest K in kN/m.
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
        let study = recommended(how, &scene, &list, true, |_| ()).unwrap();
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

/// A light handle rings on soft walls. So at one cutoff the walk continues, but at a neighbouring cutoff it ends at its
/// first wall.
#[test]
fn a_walk_that_breaks_off_hides_no_better_cutoff() {
    let stop = AtomicBool::new(false);
    let how = How { engine: Engine::lanes(), numeric: Numeric::Fixed, stop: &stop };
    let paddle = NamedScene::load("rice-paddle").unwrap();
    let (mut at_once, mut every_sample) = (paddle.clone(), paddle);
    at_once.scene.actuator.latency = 0.0;
    every_sample.scene.actuator.period = 1;
    for scene in [at_once, every_sample] {
        let study = recommended(how, &scene, &scene.scene.sweep.cutoffs_hz, true, |_| ()).unwrap();
        let found = study.recommended.unwrap();
        assert!((33.0..46.0).contains(&found.cutoff_hz), "{found:?}"); // 94 and 100 Hz have 40 % of the area
    }
}

/// A walk counts each column up to the K of its crossing. If all walls are counted one by one, the area is the same.
#[test]
fn the_area_of_a_walk_is_that_of_its_quiet_walls() {
    let stop = AtomicBool::new(false);
    for (name, cutoff_hz, [k, b], [k_max, b_max]) in [
        ("paper-1um", 470.0, [2000.0, 10.0], [33, 60]),
        ("nucleo-f446re", 360.0, [5000.0, 10.0], [50, 48]),
    ] {
        let scene = scene(name, 10, [k, b]).scene;
        let prepared = PreparedScene::new(&scene).unwrap();
        let filter = scene.velocity.at(cutoff_hz);
        let walked = walk(Engine::lanes(), &prepared, Numeric::Fixed, filter, 0.0, &stop).unwrap();
        let wall = |number: u64| WallHit {
            velocity: filter,
            stiffness_n_per_m: k * (1 + number % k_max) as f64,
            damping_n_s_per_m: b * (1 + number / k_max) as f64,
            start_offset_counts: 0.0,
        };
        let (mut quiet, total) = (0, k_max * b_max);
        let depth = Depth::Verdict;
        stream(
            Engine::lanes(),
            &prepared,
            Numeric::Fixed,
            depth,
            total,
            wall,
            &stop,
            |_, outcome| {
                quiet += u32::from(outcome.unwrap().verdict == Verdict::Stable);
                Ok(())
            },
        )
        .unwrap();
        let share = walked.area / (f64::from(quiet) * k * b);
        println!("{name} at {cutoff_hz} Hz: the walk's area is {share:.3} of its walls'");
        assert!((share - 1.0).abs() < 0.05, "{name}: {share}");
    }
}

/// One push is not enough. A wall far above all others is stable at the scene's push, but not at a push that is 3 %
/// larger.
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

/// A random device. Each number is uniform between its limits, on a logarithmic scale.
fn device(rng: &mut Xoshiro256PlusPlus) -> NamedScene {
    let mut named = NamedScene::load("paper-1um").unwrap();
    let mut draw = |low: f64, high: f64| low * (high / low).powf(rng.random::<f64>());
    let scene = &mut named.scene;
    scene.device.mass_kg = draw(0.03, 3.0);
    scene.device.damping_n_s_per_m = draw(0.1, 20.0);
    scene.device.stiffness_n_per_m = 0.0;
    scene.encoder.resolution_m = draw(1e-7, 2e-5);
    let full_n = draw(1.0, 40.0);
    scene.actuator.gain_n_per_v = full_n / scene.actuator.limit_v;
    scene.actuator.latency = draw(0.1, 10.0);
    scene.actuator.period = draw(1.0, 10.99) as u32;
    scene.wall_hit.push_n = 0.48 * full_n;
    // The wall is so near that a heavy handle reaches the wall in time.
    scene.wall.position_m = scene.device.start_position_m + 0.01;
    scene.wall_hit.judge(Criterion::Quiet, None);
    if rng.random::<bool>() {
        scene.units = Units::Rotary { radius_m: 0.05 };
    }
    let (k, b) = (
        scene.wall_hit.push_n / scene.encoder.resolution_m,
        full_n / (scene.encoder.resolution_m * 1e4),
    );
    scene.walk = Walk {
        stiffness_start_n_per_m: k / 100.0,
        stiffness_step_n_per_m: k / 100.0,
        stiffness_max_n_per_m: 1e7,
        damping_start_n_s_per_m: b / 100.0,
        damping_step_n_s_per_m: b / 100.0,
        damping_max_n_s_per_m: 1e4,
    };
    scene.check().unwrap();
    named
}

/// Searches the best cutoff in steps of 3 %, with other pushes. Returns the area at the recommended cutoff as a
/// fraction of the best area, and both cutoffs.
fn share_of_the_best(scene: &NamedScene) -> Option<[f64; 3]> {
    let stop = AtomicBool::new(false);
    let how = How { engine: Engine::lanes(), numeric: Numeric::Fixed, stop: &stop };
    let study =
        recommended(how, scene, &[30.0, 100.0, 300.0, 1000.0, 3000.0], true, |_| ()).unwrap();
    let found = study.recommended.inspect_err(|why| println!("  {why}")).ok()?;
    let mut other = scene.scene.clone();
    other.wall_hit.force_rms_limit_n = Some(other.wall_hit.force_rms_limit_n());
    other.wall_hit.push_n *= 1.013;
    other.walk = Walk {
        stiffness_start_n_per_m: 2.0 * study.walk.stiffness_start_n_per_m,
        stiffness_step_n_per_m: 2.0 * study.walk.stiffness_step_n_per_m,
        damping_start_n_s_per_m: 2.0 * study.walk.damping_start_n_s_per_m,
        damping_step_n_s_per_m: 2.0 * study.walk.damping_step_n_s_per_m,
        ..study.walk
    };
    let prepared = PreparedScene::new(&other).unwrap();
    let area = |hz: f64| {
        let filter = other.velocity.at(hz);
        walk(Engine::lanes(), &prepared, Numeric::Fixed, filter, 0.0, &stop)
            .map_or(0.0, |made| made.area)
    };
    let own = area(found.cutoff_hz);
    let near = (-25..=25).map(|step| 1.03f64.powi(step));
    let far = (3..=10).flat_map(|step| [1.3f64.powi(step), 1.3f64.powi(-step)]);
    let list = near.chain(far).map(|times| times * found.cutoff_hz).filter(|hz| *hz < 4500.0);
    let all = list.map(|hz| [area(hz), hz]);
    let best =
        all.fold([own, found.cutoff_hz], |best, one| if one[0] > best[0] { one } else { best });
    Some([own / best[0], found.cutoff_hz, best[1]])
}

#[test]
#[ignore = "twenty devices take minutes; .ci/long runs it"]
fn the_recommended_cutoff_is_near_the_best_of_a_dense_list_on_random_devices() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(20_261_127);
    let mut shares = vec![];
    for number in 0..20 {
        let scene = device(&mut rng);
        let began = std::time::Instant::now();
        let found = share_of_the_best(&scene);
        let scene = scene.scene;
        println!(
            "{number}: {:.3} kg, {:.2} N s/m, {:.2} um, {:.1} N, {:.1} samples, every {}: {found:.3?} {:.1} s",
            scene.device.mass_kg,
            scene.device.damping_n_s_per_m,
            1e6 * scene.encoder.resolution_m,
            scene.full_scale_n(),
            scene.actuator.latency,
            scene.actuator.period,
            began.elapsed().as_secs_f64()
        );
        shares.extend(found.map(|[share, ..]| share));
    }
    assert!(shares.len() >= 18, "{} of 20 have a quiet wall", shares.len());
    assert!(shares.iter().all(|share| *share >= 0.93), "{shares:?}");
    assert!(
        shares.iter().filter(|share| **share >= 0.97).count() + 2 >= shares.len(),
        "{shares:?}"
    );
}
