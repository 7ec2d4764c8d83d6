//! Compares the experiments of the release ELF with those of the simulator. The board's scene has the measured latency
//! of the board and the quantisation of its output.

use std::sync::atomic::AtomicBool;

use host_sim::{
    engine::Engine,
    scene::{NamedScene, Scene},
    simulation::prepared::{Numeric, PreparedScene},
    study::{sweep::start_offset_counts, walk},
};
use virtual_board::{
    board::{BOARDS, Board, NUCLEO_F446RE},
    session::{Session, WalkReport},
    world::World,
};
use zwidth::experiment::Ended;

use crate::{
    figure::figure,
    firmware::{Firmware, ok, until_armed},
};

each_board!(
    signs_turn_with_the_force_off_at_once_lose_the_zero_and_are_kept,
    a_wall_inside_the_envelope_needs_no_key_and_one_outside_is_refused_with_the_range
);

const CUTOFF_HZ: f64 = 1500.0;

/// Largest allowed relative difference between the areas of board and simulator. The boundary is chaotic at its edge:
/// if the start moves by a fraction of a count, the area changes by some 2 %. So the board's area is compared with the
/// mean of the simulator's areas.
const AREA_TOLERANCE: f64 = 0.05;
/// Number of the simulator's walks. The starts of these walks are spread over one count.
const REPEATS: u32 = 16;

/// A session of the board with its own scene, which `edit` has changed.
fn session(board: Board, edit: impl Fn(&mut Scene)) -> Session {
    let Firmware { board, elf, table, .. } = Firmware::of(board);
    let mut scene = NamedScene::load(board.name).unwrap();
    edit(&mut scene.scene);
    scene.scene.check().unwrap();
    Session { board, scene, elf, table }
}

/// Walks on the virtual board and compares with the simulator. Returns the board's walk, and the mean and spread of the
/// simulator's areas.
fn both(board: Board, edit: impl Fn(&mut Scene)) -> (WalkReport, [f64; 2]) {
    let session = session(board, edit);
    let prepared = PreparedScene::new(&session.scene.scene).unwrap();
    let stop = AtomicBool::new(false);
    let filter = prepared.scene().velocity.at(CUTOFF_HZ);
    let simulated = (0..REPEATS).map(|repeat| {
        let offset = start_offset_counts(repeat, REPEATS);
        walk::walk(Engine::lanes(), &prepared, Numeric::Fixed, filter, offset, &stop).unwrap()
    });
    let simulated: Vec<_> = simulated.collect();
    let mean = simulated.iter().map(|boundary| boundary.area).sum::<f64>() / f64::from(REPEATS);
    let squares = simulated.iter().map(|boundary| (boundary.area - mean).powi(2)).sum::<f64>();
    let spread = (squares / f64::from(REPEATS - 1)).sqrt() / mean;
    let walked = session.walk(CUTOFF_HZ, |_| {}).unwrap();
    let difference = walked.area / mean - 1.0;
    println!(
        "{}: {} cells, {} points, area {:.4e} (simulated {mean:.4e}, one walk +-{:.1} %; {:+.2} %), {:.0} s on the board",
        board.name,
        walked.hits,
        walked.points.len(),
        walked.area,
        100.0 * spread,
        100.0 * difference,
        walked.virtual_s
    );
    let simulated = &simulated[0];
    assert!(difference.abs() <= AREA_TOLERANCE, "{difference}");
    // `cargo sim walk` gives a single walk. A single walk differs from the mean by the spread.
    let of_one = walked.area / simulated.area - 1.0;
    assert!(of_one.abs() <= AREA_TOLERANCE + 2.0 * spread, "{of_one}");
    assert_eq!(walked.ended_by, simulated.ended.map(Ended::name).unwrap());
    assert_eq!(walked.points.len(), simulated.points.len());
    let sum: f64 = walked.points.iter().map(|[_, k]| k).sum();
    let step = session.scene.scene.walk.damping_step_n_s_per_m;
    assert!((sum * step / walked.area - 1.0).abs() < 1e-9, "{sum} {walked:?}");
    (walked, [mean, spread])
}

/// Sets another grid, with hits that are shorter than the paper's.
fn grid(
    scene: &mut Scene,
    [k_start, k_step]: [f64; 2],
    b: [f64; 3],
    [settle_s, window_s]: [f64; 2],
) {
    let [b_start, b_step, b_max] = b;
    scene.walk.stiffness_start_n_per_m = k_start;
    scene.walk.stiffness_step_n_per_m = k_step;
    scene.walk.damping_start_n_s_per_m = b_start;
    scene.walk.damping_step_n_s_per_m = b_step;
    scene.walk.damping_max_n_s_per_m = b_max;
    scene.wall_hit.settle_s = settle_s;
    scene.wall_hit.window_s = window_s;
}

#[test]
#[ignore = "20 s; CI runs it"]
fn a_short_walk_on_the_board_finds_the_boundary_of_the_simulator() {
    let (walked, _) = both(NUCLEO_F446RE, |scene| {
        grid(scene, [32_000.0, 8_000.0], [20.0, 5.0, 35.0], [0.5, 0.2]);
        scene.device.start_position_m = 0.066; // a short return move
    });
    assert!(walked.hits >= 10, "{walked:?}");
}

#[test]
#[ignore = "minutes: .ci/long walks"]
fn a_walk_of_60_points_on_each_board_has_the_area_of_the_simulator() {
    std::thread::scope(|scope| {
        for board in BOARDS {
            scope.spawn(move || {
                let (walked, [mean, spread]) = both(board, |scene| {
                    grid(scene, [20_000.0, 100_000.0], [16.0, 16.0, 1000.0], [0.5, 0.3]);
                    scene.device.start_position_m = 0.06; // a shorter return move
                });
                let leave = |key: &str, value: f64| {
                    figure(&format!("elf/walk/{}/{key}", board.name), value);
                };
                leave("hits", f64::from(walked.hits));
                leave("points", walked.points.len() as f64);
                leave("area", walked.area);
                leave("simulated", mean);
                leave("spread", spread);
                leave("virtual_s", walked.virtual_s);
                assert!(walked.hits >= 60 && walked.points.len() >= 60, "{walked:?}");
                assert!(walked.points.iter().all(|[b, _]| *b <= 1000.0));
            });
        }
    });
}

/// An armed board. The handle was released at the device's rest, the zero was set there, and the wall is 18 mm away.
fn armed(session: &Session) -> World<'_> {
    let mut world = session.boot().unwrap();
    for line in ["zero", "unlock envelope", "wall 0.0183", "k 8000", "b 30", "push 2.835", "arm"] {
        ok(&mut world, line);
    }
    until_armed(&mut world);
    world
}

/// Runs until a line contains `what`, for `samples` samples at most. Returns the lines up to this one.
fn lines_until(world: &mut World<'_>, what: &str, samples: u64) -> Vec<String> {
    for _ in 0..samples / 500 {
        world.run(500).unwrap();
        if world.replies.lines().any(|line| line.contains(what)) {
            break;
        }
    }
    std::mem::take(&mut world.replies).lines().map(str::to_owned).collect()
}

fn lines_after(world: &mut World<'_>, samples: u64) -> Vec<String> {
    world.run(samples).unwrap();
    std::mem::take(&mut world.replies).lines().map(str::to_owned).collect()
}

/// Runs `samples` samples and returns the largest force, as a fraction of full scale.
fn largest_force(world: &mut World<'_>, samples: u64) -> f64 {
    let units = match world.powered.board.wiring.force {
        virtual_board::board::Force::Dac { .. } => 2047.0,
        virtual_board::board::Force::Pwm { .. } => 1.0,
    };
    let mut largest = 0f64;
    for _ in 0..samples {
        world.sample().unwrap();
        #[expect(clippy::cast_precision_loss, reason = "a code")]
        let part = world.powered.amplifier.command() as f64 / units;
        largest = largest.max(part.abs());
    }
    largest
}

#[test]
fn stop_ends_the_way_back_a_hit_a_walk_and_a_calibration_without_a_fault() {
    let session = session(NUCLEO_F446RE, |_| {});
    let mut world = armed(&session);
    ok(&mut world, "start -0.01");
    for (command, samples, activity) in [
        ("hit", 500, "hit"),    // in the return move
        ("hit", 15_000, "hit"), // in the wall
        ("walk", 12_000, "walk"),
        ("calibrate 9", 300, "calibration"),
    ] {
        if command.starts_with("calibrate") {
            world.hold(world.position_m(), true); // the handle rests
            world.run(2_000).unwrap();
        }
        ok(&mut world, command);
        world.run(samples).unwrap();
        let status = ok(&mut world, "status");
        assert!(status.contains(&format!("fault none, {activity},")), "{command}: {status}");
        let refused = world.ask("hit").unwrap();
        assert!(refused.starts_with("error"), "{command}: {refused}");
        let line = world.ask("stop").unwrap();
        let line = if command == "walk" {
            assert!(line.starts_with("error: walk: stopped"), "{line}");
            world.reply(1_000).unwrap()
        } else {
            line
        };
        assert_eq!(line, "ok stop");
        // The push fades by 5 % of full scale per output.
        world.run(300).unwrap();
        let status = ok(&mut world, "status");
        assert!(status.contains("ok status armed, fault none, idle"), "{command}: {status}");
        world.run(3_000).unwrap();
        let left = largest_force(&mut world, 200);
        assert!(left < 0.02, "{command}: {left}");
    }
    // The walk has restored the wall.
    let get = ok(&mut world, "get");
    assert!(get.contains("k 8000 N/m, b 30 N s/m"), "{get}");
}

#[test]
fn what_goes_wrong_ends_an_experiment_safely_and_is_named() {
    let session = session(NUCLEO_F446RE, |_| {});
    // The force is switched off during a walk.
    let mut world = armed(&session);
    ok(&mut world, "walk");
    world.run(8_000).unwrap();
    world.emergency_stop(true);
    let lines = lines_after(&mut world, 300);
    assert!(lines.iter().any(|l| l.starts_with("error: walk: the force went off")), "{lines:?}");
    let status = ok(&mut world, "status");
    assert!(status.contains("fault 30 (emergency stop), idle"), "{status}");
    // Without a push there is no contact.
    let mut world = armed(&session);
    for line in ["push 0", "settle 0.1", "window 0.1", "walk"] {
        ok(&mut world, line);
    }
    let what = "does not bring the handle to the wall";
    let lines = lines_until(&mut world, what, 40_000);
    assert!(lines.iter().any(|l| l.contains(what)), "{lines:?}");
    // The first wall of this walk cannot be stable.
    for line in ["push 2.835", "settle 1", "kstart 9000000", "walk"] {
        ok(&mut world, line);
    }
    let what = "the first point is unstable";
    let lines = lines_until(&mut world, what, 60_000);
    assert!(lines.iter().any(|l| l.contains(what)), "{lines:?}");
    // A start inside the wall may be set, since the wall may be moved later. But no experiment begins there.
    ok(&mut world, "start 0.02");
    for command in ["hit", "walk"] {
        let refused = world.ask(command).unwrap();
        assert!(refused.contains("start_m is 0.02, allowed"), "{command}: {refused}");
    }
    // A walk needs an unlocked envelope.
    let mut world = session.boot().unwrap();
    for line in ["zero", "arm"] {
        ok(&mut world, line);
    }
    until_armed(&mut world);
    let refused = world.ask("walk").unwrap();
    assert!(refused.contains("unlock envelope first"), "{refused}");
}

#[test]
fn a_handle_that_is_held_back_ends_the_way_back() {
    let session = session(NUCLEO_F446RE, |_| {});
    let mut world = armed(&session);
    ok(&mut world, "start -0.01");
    ok(&mut world, "hit");
    world.run(500).unwrap();
    world.hold(world.position_m(), true);
    // A rigid hand looks like a failed encoder. This fault is found at once.
    let lines = lines_after(&mut world, 2_000);
    assert!(lines.iter().any(|l| l.starts_with("error: hit: the force went off")), "{lines:?}");
    let status = ok(&mut world, "status");
    assert!(status.contains("fault 13 (push without motion)"), "{status}");
    assert!(!world.powered.amplifier.is_enabled());
}

#[test]
#[ignore = "a return gives up after 10 s; the library's tests have that as well"]
fn a_hand_that_moves_to_and_fro_lets_the_way_back_give_up_by_itself() {
    let session = session(NUCLEO_F446RE, |_| {});
    let mut world = armed(&session);
    ok(&mut world, "start -0.01");
    ok(&mut world, "hit");
    let held_m = world.position_m();
    let mut lines = vec![];
    // The handle moves by 0.5 mm in 25 ms. The push of a return move would move even the heaviest handle less.
    for n in 0..12_000u32 {
        let place = f64::from(((n + 25) % 50).abs_diff(25));
        world.hold(held_m + 20e-6 * place, true);
        lines.extend(lines_after(&mut world, 10));
    }
    assert!(lines.iter().any(|l| l.contains("did not come back to the start")), "{lines:?}");
    let status = ok(&mut world, "status");
    assert!(status.contains("armed, fault none, idle"), "{status}");
}

#[test]
fn calibrate_rises_holds_and_stops_on_motion() {
    let session = session(NUCLEO_F446RE, |_| {});
    let mut world = armed(&session);
    let at_m = world.position_m();
    world.hold(at_m, true); // a force gauge holds the handle
    world.run(2_000).unwrap();
    ok(&mut world, "calibrate 8");
    let mut lines = lines_until(&mut world, "calibrate holds", 42_000);
    lines.extend(lines_after(&mut world, 500));
    let holds = |line: &String| {
        line.starts_with("calibrate holds 8 %") || line.starts_with("calibrate holds 7.99")
    };
    assert!(lines.iter().any(holds), "{lines:?}");
    assert!(lines.iter().any(|l| l.contains("code 2212")), "{lines:?}"); // 2048 + 0.08 * 2047
    assert!((world.powered.amplifier.command() - 164).abs() <= 1);
    assert!(ok(&mut world, "status").contains("fault none, calibration"));
    ok(&mut world, "calibrate 6");
    world.run(12_000).unwrap();
    assert!((world.powered.amplifier.command() - 123).abs() <= 1);
    world.hold(at_m, false); // the gauge releases the handle
    let lines = lines_after(&mut world, 5_000);
    assert!(
        lines.iter().any(|l| l.starts_with("ok calibrate over: the handle moved")),
        "{lines:?}"
    );
    assert!(largest_force(&mut world, 100) < 0.01);
    let refused = world.ask("calibrate 31").unwrap();
    assert!(refused.contains("allowed -30 to 30"), "{refused}");
    // The result is entered, checked against its range, and stored.
    let refused = world.ask("fullscale 6").unwrap();
    assert!(refused.contains("disarm first"), "{refused}");
    ok(&mut world, "disarm");
    assert!(world.ask("fullscale 60").unwrap().contains("full_scale_n is 60, allowed"));
    ok(&mut world, "fullscale 6");
    ok(&mut world, "save");
    world.run(500).unwrap();
    world.reset();
    world.run(2_000).unwrap();
    assert!(ok(&mut world, "get").contains("full scale 6 N"));
}

fn signs_turn_with_the_force_off_at_once_lose_the_zero_and_are_kept(board: Board) {
    let session = session(board, |_| {});
    let mut world = armed(&session);
    for line in ["motor -", "encoder -"] {
        let refused = world.ask(line).unwrap();
        assert!(refused.contains("disarm first"), "{line}: {refused}");
    }
    ok(&mut world, "disarm");
    world.run(8_000).unwrap();
    ok(&mut world, "encoder -");
    assert!(ok(&mut world, "status").contains("not zeroed"));
    assert!(world.ask("arm").unwrap().contains("zero first"));
    // The count now falls in the direction in which it rose before.
    let position = |world: &mut World<'_>| -> i32 {
        let status = ok(world, "status");
        let word = status.split("position ").nth(1).unwrap().split(' ').next().unwrap();
        word.parse().unwrap()
    };
    let at_m = world.position_m();
    world.hold(at_m, true);
    ok(&mut world, "zero");
    world.run(100).unwrap();
    for n in 1..=100 {
        world.hold(at_m + 1e-5 * f64::from(n), true);
        world.run(1).unwrap();
    }
    world.run(50).unwrap();
    let counts = position(&mut world);
    assert!((-1_002..=-998).contains(&counts), "{counts}");
    world.hold(world.position_m(), false);
    world.run(5_000).unwrap();
    // With only the encoder reversed, the sign test fails. With encoder and motor reversed, the sign test passes.
    ok(&mut world, "zero");
    ok(&mut world, "arm");
    world.run(2_000).unwrap();
    assert!(ok(&mut world, "status").contains("fault 14"));
    ok(&mut world, "clear");
    ok(&mut world, "motor -");
    for line in ["zero", "unlock envelope", "arm"] {
        ok(&mut world, line);
    }
    until_armed(&mut world);
    assert!(ok(&mut world, "status").contains("armed, fault none"));
    ok(&mut world, "disarm");
    ok(&mut world, "save");
    world.run(500).unwrap();
    world.reset();
    world.run(2_000).unwrap();
    let get = ok(&mut world, "get");
    assert!(get.contains("motor -, encoder -"), "{get}");
    world.run(6_000).unwrap();
    for line in ["zero", "unlock envelope", "arm"] {
        ok(&mut world, line);
    }
    until_armed(&mut world);
    assert!(ok(&mut world, "status").contains("armed, fault none"), "{}", board.name);
}

fn a_wall_inside_the_envelope_needs_no_key_and_one_outside_is_refused_with_the_range(board: Board) {
    let session = session(board, |_| {});
    let mut world = session.boot().unwrap();
    for line in ["zero", "wall 0.0183", "b 10", "k 5000", "arm"] {
        ok(&mut world, line);
    }
    until_armed(&mut world);
    ok(&mut world, "k 20000");
    let refused = world.ask("k 60000").unwrap();
    assert!(refused.contains("k at this b is allowed from 0 to"), "{refused}");
    assert!(world.ask("cutoff 1234").unwrap().contains("no envelope for this device"));
    let status = ok(&mut world, "status");
    assert!(status.contains("armed, fault none") && status.contains("settings valid"));
    assert!(ok(&mut world, "get").contains("k 20000 N/m"));
    ok(&mut world, "unlock envelope");
    ok(&mut world, "k 60000");
    ok(&mut world, "disarm");
    assert!(
        world.ask("arm").unwrap().contains("beyond the envelope: k at this b is allowed from 0 to")
    );
}
