//! The board when no host reads.

use virtual_board::{
    board::{Board, NUCLEO_F446RE},
    world::World,
};
use zwidth::console::Unread;

use crate::firmware::{Firmware, ok};

each_board!(
    nothing_changes_without_an_acknowledgement,
    disarm_is_answered_with_the_force_off,
    who_reads_replies_late_is_told_how_many_are_missing
);

/// The amplifier is off at the end of the sample in which the reply to `disarm` comes. This is tested at rest, in a
/// hit, with the amplifier already off, and after an earlier fault.
fn disarm_is_answered_with_the_force_off(board: Board) {
    let firmware = Firmware::of(board);
    for (case, phase) in [(0, 1), (1, 4), (2, 6), (3, 9)] {
        let mut world = firmware.armed();
        match case {
            1 => {
                ok(&mut world, "hit");
                world.run(3_000).unwrap();
            }
            2 => {
                ok(&mut world, "disarm");
            }
            _ => {}
        }
        world.run(phase).unwrap();
        world.replies.clear();
        if case == 3 {
            world.emergency_stop(true);
        }
        world.send("disarm\n").unwrap();
        let answered = (0..200).any(|_| {
            world.sample().unwrap();
            world.probe().unwrap();
            world.replies.contains("ok disarm")
        });
        assert!(answered, "{case}: {}", world.replies);
        assert!(!world.powered.amplifier.is_enabled(), "case {case}, phase {phase}");
    }
}

/// If no host reads, the channels become full. Then one more command may act, and its reply waits for room. Later
/// commands are ignored, except for commands that end something.
fn nothing_changes_without_an_acknowledgement(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
    let unread = |world: &mut World<'_>, line: &str| {
        world.send(&format!("{line}\n")).unwrap();
        // The wait is longer than the board's pause between two lines. So each line is obeyed or ignored before the
        // next line.
        for _ in 0..40 {
            world.sample().unwrap();
        }
    };
    for k in 1..=300 {
        unread(&mut world, &format!("k {k}"));
    }
    unread(&mut world, "disarm");
    world.replies.clear();
    world.lines.clear();
    world.run(2_000).unwrap();
    // The log has all lines in order, from the last line that had room to the line that waited.
    let acknowledged = |lines: &mut dyn Iterator<Item = &str>| {
        lines.filter_map(|line| line.split_once("ok k ")?.1.split(' ').next()?.parse().ok()).max()
    };
    let in_log: Option<u32> = acknowledged(&mut world.lines.iter().map(String::as_str));
    let replied: Option<u32> = acknowledged(&mut world.replies.lines());
    let last = in_log.max(replied).expect("no reply at all");
    let told = unread_of(&world.replies);
    println!("{}: up to k {last}, then {told:?}", board.name);
    assert_eq!(told[0], 300 - last);
    assert!((20..300).contains(&last), "{last}");
    let settings = ok(&mut world, "get");
    assert!(settings.contains(&format!("k {last} ")), "{settings}");
    let status = ok(&mut world, "status");
    assert!(status.contains("ok status off"), "{status}");
}

/// The log has room for more lines than the channel of replies. So some replies are in the log alone. Before its next
/// reply the board says how many.
fn who_reads_replies_late_is_told_how_many_are_missing(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.boot();
    world.probe().unwrap();
    world.replies.clear();
    world.lines.clear();
    for _ in 0..6 {
        world.send("get\n").unwrap();
        for _ in 0..100 {
            world.sample().unwrap();
        }
    }
    world.probe().unwrap();
    assert_eq!(world.lines.iter().filter(|line| line.contains("ok get ")).count(), 6);
    world.send("version\n").unwrap();
    world.run(200).unwrap();
    let replies = world.replies.lines().filter(|line| line.starts_with("ok get ")).count() as u32;
    assert!(replies < 6, "{}", world.replies);
    assert_eq!(unread_of(&world.replies), [0, 6 - replies], "{}", world.replies);
    assert!(world.replies.lines().last().unwrap().starts_with("ok version"), "{}", world.replies);
}

/// Sums of ignored commands and lost lines that the board has told.
fn unread_of(replies: &str) -> [u32; 2] {
    let told = replies.lines().filter_map(|line| line.parse().ok());
    told.fold([0, 0], |sums, told: Unread| [sums[0] + told.ignored, sums[1] + told.lost])
}

/// If no host reads the lines of a walk, the walk ends after its present hit, since further results would be lost. A
/// host that reads again gets a message about the end of the walk.
#[test]
fn a_walk_ends_when_nobody_reads() {
    let firmware = Firmware::of(NUCLEO_F446RE);
    let mut world = firmware.armed();
    for line in ["settle 0.7", "window 0.1", "start 0", "kstart 2000", "kstep 1000", "bstart 20"] {
        ok(&mut world, line);
    }
    let told = |world: &mut World<'_>, what: &str| {
        world.lines.iter().any(|line| line.contains(what)) && world.replies.contains(what)
    };
    ok(&mut world, "walk");
    world.run(25_000).unwrap();
    assert!(told(&mut world, "walk hit 1: "), "it walks: {}", world.replies);
    // During the walk's hits, replies that no host reads fill both channels.
    for _ in 0..300 {
        world.send("get\n").unwrap();
        (0..30).for_each(|_| world.sample().unwrap());
    }
    for _ in 0..12_000 {
        world.sample().unwrap();
    }
    let (before_m, pushed) = (world.position_m(), world.powered.amplifier.command());
    for _ in 0..5_000 {
        world.sample().unwrap();
    }
    assert!((world.position_m() - before_m).abs() < 1e-3, "no further hit");
    assert_eq!(world.powered.amplifier.command(), pushed);
    world.replies.clear();
    world.lines.clear();
    world.run(2_000).unwrap();
    assert!(told(&mut world, "error: walk: nobody read its results"), "{}", world.replies);
    let status = ok(&mut world, "status");
    assert!(status.contains("ok status armed, fault none, idle"), "{status}");
    let settings = ok(&mut world, "get");
    assert!(settings.contains("k 8000 N/m, b 30 N s/m"), "{settings}");
}
