//! A board whose state was restored continues exactly like a board that was not interrupted.

use std::time::Instant;

use virtual_board::{
    board::Board,
    mcu::AfterHalt,
    world::{Snapshot, World},
};

use crate::firmware::{Firmware, arm, ok};

each_board!(a_board_goes_on_from_a_snapshot_as_it_went_on);

pub type Act = (&'static str, fn(&mut World<'_>));

pub const ACTS: [Act; 9] = [
    ("runs", |world| world.run(300).unwrap()),
    ("meets its wall", |world| {
        for _ in 0..600 {
            world.lead(0.05);
            world.sample().unwrap();
        }
        world.run(10).unwrap();
    }),
    ("is asked", |world| {
        ok(world, "status");
        ok(world, "k 3000");
    }),
    ("is let go", |world| {
        world.hold(world.position_m(), false);
        world.run(200).unwrap();
    }),
    ("halts", |world| {
        world.halt(400_000, AfterHalt::Kept);
        world.run(100).unwrap();
    }),
    ("is stopped", |world| {
        world.emergency_stop(true);
        world.run(77).unwrap();
    }),
    ("loses its supply", |world| {
        world.powered.mcu.set_supply_mv(2000);
        world.run(33).unwrap();
        world.powered.mcu.set_supply_mv(3300);
    }),
    ("is reset", |world| {
        world.reset();
        world.run(350).unwrap();
    }),
    ("saves", |world| {
        world.emergency_stop(false);
        world.send("disarm\nsave\nload\n").unwrap();
        world.run(600).unwrap();
    }),
];

/// Everything that is compared: memory, registers, devices, the handle and all output.
fn all_of(world: &mut World<'_>) -> (Vec<u8>, u64, u64, String) {
    let Snapshot { mcu, .. } = world.snapshot();
    let said = format!("{:?}{}{:?}", world.lines, world.replies, world.telemetry);
    let watch = format!("{:?}", world.powered.mcu.watch());
    (mcu.bytes().collect(), world.position_m().to_bits(), world.powered.mcu.now(), said + &watch)
}

/// After each action, the first board is restored and repeats the action. Then a second board, just switched on, is
/// restored and repeats the action.
fn a_board_goes_on_from_a_snapshot_as_it_went_on(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.boot();
    let mut other = firmware.boot();
    arm(&mut world);
    let mut before = world.snapshot();
    for (what, act) in ACTS {
        act(&mut world);
        let went_on = all_of(&mut world);
        let after = world.snapshot();
        world.restore(&before);
        act(&mut world);
        assert!(all_of(&mut world) == went_on, "{}: {what}, put back", board.name);
        other.restore(&before);
        act(&mut other);
        assert!(all_of(&mut other) == went_on, "{}: {what}, another one", board.name);
        before = after;
    }
    assert!(world.powered.mcu.resets() == 1 && world.lines.len() > 5);

    let begun = Instant::now();
    let rounds = 200;
    for _ in 0..rounds {
        before = world.snapshot();
    }
    let saved = begun.elapsed();
    for _ in 0..rounds {
        world.restore(&before);
    }
    println!(
        "{}: {} ns to save, {} ns to put back",
        board.name,
        saved.as_nanos() / rounds,
        (begun.elapsed() - saved).as_nanos() / rounds
    );
}
