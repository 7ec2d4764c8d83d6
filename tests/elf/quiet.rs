//! Runs hits with the criterion `quiet` on the release ELF. Each hit has several pushes. The tests compare these hits
//! with the simulator's hits from the same starts.

use host_sim::{
    scene::{Criterion, NamedScene, RmsOf, Scene},
    simulation::prepared::{HitReport, Numeric, PreparedScene, WallHit},
};
use rand::{RngExt, SeedableRng, rngs::Xoshiro256PlusPlus};
use virtual_board::{
    board::{BOARDS, Board},
    session::{BoardHit, Session},
};
use zwidth::experiment::{Verdict, quiet::PUSHES};

use crate::firmware::Firmware;

/// Distance of an RMS from its limit within which board and simulator may give different verdicts, as a fraction of the
/// limit. Even in windows of 2 s, an RMS near one count differs by a fifth between two windows.
const NEAR: f64 = 0.2;
/// Fractions of a count at which the simulator's hits start.
const STARTS: [f64; 4] = [0.0, 0.25, 0.5, 0.75];

/// A session of the board with its own scene. Its hits have these times, and its return moves are short.
fn session(board: Board, [settle_s, window_s]: [f64; 2]) -> Session {
    let Firmware { board, elf, table, .. } = Firmware::of(board);
    let mut scene = NamedScene::load(board.name).unwrap();
    let hit = &mut scene.scene.wall_hit;
    hit.judge(Criterion::Quiet, Some(RmsOf::Counts));
    (hit.settle_s, hit.window_s) = (settle_s, window_s);
    scene.scene.device.start_position_m = 0.066;
    scene.scene.check().unwrap();
    Session { board, scene, elf, table }
}

/// Distance of a push from the nearest limit, as a fraction of this limit. It is negative if a limit was exceeded.
fn margin(scene: &Scene, stiffness_n_per_m: f64, report: &HitReport) -> f64 {
    let count_n = stiffness_n_per_m * scene.encoder.resolution_m;
    let off = (count_n / report.wall_force_n.abs()).max(0.1);
    let ratio = report.penetration_ratio.unwrap_or(f64::INFINITY);
    let of_limits = [
        1.0 - report.rms_m / scene.rms_limit_m(),
        1.0 - report.force_rms_n / scene.wall_hit.force_rms_limit_n(),
        1.0 - (ratio - 1.0).abs() / off,
    ];
    of_limits.into_iter().fold(f64::INFINITY, f64::min)
}

/// Runs hits on random walls on the board and in the simulator. Returns the numbers of stable hits, of unstable hits,
/// and of hits that were left out.
fn hits(board: Board, seconds: [f64; 2], walls: u64, seed: u64) -> [usize; 3] {
    let session = session(board, seconds);
    let scene = &session.scene.scene;
    let prepared = PreparedScene::new(scene).unwrap();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut counts = [0; 3];
    for _ in 0..walls {
        let cutoff_hz = random.random_range(150.0..1500.0f64).round();
        let k = 10f64.powf(random.random_range(3.5..5.3)).round();
        let b = random.random_range(0.0..300.0f64).round();
        let from = |start_offset_counts: f64| {
            let hit = WallHit {
                velocity: scene.velocity.at(cutoff_hz),
                stiffness_n_per_m: k,
                damping_n_s_per_m: b,
                start_offset_counts,
            };
            prepared.reports(Numeric::Fixed, &hit, |_| ()).unwrap()
        };
        // The push with the smallest margin decides the result of a wall.
        let of_start = |pushes: &Vec<(f64, HitReport)>| {
            let margins = pushes.iter().map(|(_, report)| margin(scene, k, report));
            margins.fold(f64::INFINITY, f64::min)
        };
        let starts = STARTS.map(from);
        let margins = starts.each_ref().map(of_start);
        let [simulated, ..] = &starts;
        let (told, _) = session.hit([cutoff_hz, k, b]).unwrap();
        let held = told.verdict == Verdict::Stable;
        let case = format!("{}: {cutoff_hz} Hz, K {k}, B {b}", board.name);
        assert_eq!(told.pushes.len(), tried(&told), "{case}: {told:?}");
        let wanted = match margins {
            _ if margins.iter().all(|margin| *margin > NEAR) => true,
            _ if margins.iter().all(|margin| *margin < -NEAR) => false,
            _ => {
                counts[2] += 1;
                continue;
            }
        };
        counts[usize::from(!held)] += 1;
        assert_eq!(held, wanted, "{case}: {:#?}\n{simulated:#?}", told.pushes);
        for (push, (push_n, report)) in told.pushes.iter().zip(simulated) {
            assert!((push.push_n / push_n - 1.0).abs() < 1e-9, "{case}");
            if held {
                // The final amplitude of a limit cycle depends on its start.
                let off_n = (push.force_rms_n - report.force_rms_n).abs();
                let off = push.penetration_ratio.unwrap() - report.penetration_ratio.unwrap();
                let near = off_n < 0.25 * scene.wall_hit.force_rms_limit_n() && off.abs() < 0.01;
                assert!(near, "{case}: {push:?} {report:?}");
            }
        }
    }
    println!("{}: {counts:?} held, not held, near a limit", board.name);
    counts
}

/// Number of pushes that a hit must have tried.
fn tried(told: &BoardHit) -> usize {
    let first = told.pushes.iter().position(|push| push.verdict != Verdict::Stable);
    first.map_or(PUSHES.len(), |first| first + 1)
}

#[test]
#[ignore = "a minute; CI runs it"]
fn quiet_hits_on_the_boards_are_judged_as_in_the_simulator() {
    for board in BOARDS {
        let [held, not_held, _] = hits(board, [0.5, 0.3], 8, 5);
        assert!(held >= 1 && not_held >= 1);
    }
}

#[test]
#[ignore = "minutes: .ci/long walks"]
fn quiet_hits_on_the_boards_at_40_walls_each() {
    std::thread::scope(|scope| {
        for board in BOARDS {
            scope.spawn(move || {
                let [held, not_held, near] = hits(board, [0.5, 0.3], 40, 7);
                assert!(held >= 8 && not_held >= 8 && near <= 13);
            });
        }
    });
}
