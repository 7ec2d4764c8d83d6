//! Random sessions compared with the firmware's own library. A further test tries emergency stop, supply drop and reset
//! at the instants of an output period. `cargo board fuzz` runs any number of sessions.

use board_trials::fuzz;
use host_sim::scene::NamedScene;
use virtual_board::{
    board::{BOARDS, Board, NUCLEO_F446RE},
    elf::Elf,
    image, log,
    session::Session,
};

/// A board with its own device.
fn session(board: Board) -> Session {
    let elf = Elf::load(&image::build(board.name).unwrap()).unwrap();
    let table = log::table(&elf.bytes).unwrap();
    let scene = NamedScene::load(board.name).unwrap();
    Session { board, scene, elf, table }
}

fn sessions(board: Board, seed: u64, commands: u64) {
    let outcome = fuzz::sessions(&session(board), seed, commands, 2).unwrap();
    if let Some(failure) = &outcome.failure {
        let script: Vec<String> = failure.actions.iter().map(ToString::to_string).collect();
        panic!("{}: {}\n{}", board.name, failure.what, script.join("\n"));
    }
    let counts = outcome.counts;
    println!("{}: {counts:?}", board.name);
    assert!(counts.commands >= commands && counts.replies > commands / 2);
    assert!(counts.obeyed > commands / 3 && counts.refused > commands / 20);
    assert!(counts.armed > commands / 5 && counts.forces > commands / 5);
    assert!(counts.frames > commands && counts.outputs > commands);
}

#[test]
fn random_sessions_go_as_in_the_library() {
    sessions(NUCLEO_F446RE, 2, 120);
}

#[test]
#[ignore = "the other board's image; CI runs it"]
fn more_random_sessions_go_as_in_the_library() {
    for board in BOARDS {
        sessions(board, 3, 400);
    }
}

/// `cargo board fuzz --bursts N` sends any number of bursts.
#[test]
#[ignore = "seconds of bursts; CI runs it"]
fn bursts_of_lines_change_no_output_and_are_all_answered() {
    for board in BOARDS {
        let rows = fuzz::bursts(&session(board), 5, 5).unwrap().unwrap();
        for row in &rows {
            println!("{}: {row:?}", board.name);
            assert!(row.bursts == 5 && row.lines > 20 && row.obeyed > 10 && row.refused > 2);
            assert!(row.outputs > 100 && row.fed_ms <= 20.0 && row.link <= 0.3);
        }
    }
}

/// Tries every 100th instruction. `cargo board fuzz --instants` tries every instruction.
#[test]
#[ignore = "the other board's image; CI runs it"]
fn stop_supply_and_reset_end_in_their_own_fault_whenever_they_come() {
    for board in BOARDS {
        let fuzz::Sweep { instants, cycles, wrong, wall_s, .. } =
            fuzz::sweep(&session(board), 100, 2).unwrap();
        println!("{}: {instants} instants, {cycles} cycles of code, {wall_s:.0} s", board.name);
        assert!(wrong.is_empty(), "{}: {wrong:?}", board.name);
        assert!(instants > 100 && cycles > 1_000);
    }
}
