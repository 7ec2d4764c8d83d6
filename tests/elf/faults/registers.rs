//! Flips bits of registers: the force must be off within 3 ms, and the board must report the fault. A further test
//! gives the sample timer a wrong rate.

use board_trials::campaign::registers::{RegisterRow, register_rows};
use virtual_board::{board::Board, world::World};

use crate::{
    figure::figure,
    firmware::{Firmware, ok},
};

each_board!(
    a_register_that_changes_takes_the_force_away_within_3_ms,
    any_bit_of_the_output_watchdog_ends_in_off_or_leaves_it_at_work,
    a_rate_that_is_off_by_more_than_2_percent_is_found_from_both_sides
);

const TIM1: u32 = 0x4001_0000;
const TIM8: u32 = 0x4001_0400;
const DMA2: u32 = 0x4002_6400;
const TIM5: u32 = 0x4000_0C00;

/// Longest time until enable is inactive, in s.
const OFF_S: f64 = 3e-3;

/// An armed board whose handle is pressed into the wall, in the middle between two outputs.
pub fn pressed(firmware: &Firmware) -> World<'_> {
    let mut world = firmware.armed();
    let zero_m = world.position_m();
    world.lead_to(zero_m + 5.3e-3).unwrap();
    world.run(50).unwrap();
    while world.powered.mcu.events() % 10 != 4 {
        world.sample().unwrap();
    }
    world
}

fn a_register_that_changes_takes_the_force_away_within_3_ms(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = pressed(&firmware);
    world.powered.mcu.outlive_lock_up();
    let before = world.snapshot();
    let mut longest = (0.0, "");
    for row in register_rows(board) {
        let RegisterRow { name, says, .. } = row;
        world.restore(&before);
        let begun = world.powered.mcu.now();
        row.apply(&mut world);
        for _ in 0..40 {
            world.sample().unwrap();
        }
        let off = world.powered.amplifier.changes().disabled_at.filter(|&at| at >= begun);
        let off = off.unwrap_or_else(|| panic!("{name}: enable stays active"));
        let off_s = (off - begun) as f64 / board.chip.core_hz as f64;
        println!("{:14} {name:32} {:.3} ms", board.name, off_s * 1e3);
        assert!(off_s <= OFF_S && !world.powered.amplifier.is_enabled(), "{name}: {off_s} s");
        if off_s > longest.0 {
            longest = (off_s, name);
        }
        if says {
            world.replies.clear();
            let status = ok(&mut world, "status");
            assert!(status.contains("fault 43 (registers)"), "{name}: {status}");
            let refused = world.ask("clear").unwrap();
            assert!(refused.contains("cause of the fault is still there"), "{name}: {refused}");
        }
    }
    println!("{}: {} after {:.3} ms", board.name, longest.1, longest.0 * 1e3);
    figure(&format!("elf/faults/registers/{}/most", board.name), longest.0 * 1e6);
    figure(&format!("elf/faults/registers/{}/rows", board.name), register_rows(board).len());
    // Locked registers do not change.
    world.restore(&before);
    for (offset, locked) in [(0x04, 0x7F00), (0x18, 0x7878), (0x1C, 0x7878), (0x20, 0x2AAA)] {
        let was = world.powered.mcu.peek(TIM1 + offset);
        world.powered.mcu.poke(TIM1 + offset, was ^ locked);
        assert_eq!(world.powered.mcu.peek(TIM1 + offset), was, "{offset:#x}");
    }
    let bdtr = world.powered.mcu.peek(TIM1 + 0x44);
    world.powered.mcu.poke(TIM1 + 0x44, 1 << 15);
    assert_eq!(world.powered.mcu.peek(TIM1 + 0x44), bdtr);
    world.run(100).unwrap();
    assert!(world.powered.amplifier.is_enabled());
}

/// Registers of the output watchdog and of enable. They belong to TIM8, to DMA2 (its first flags and stream 1) and to
/// TIM1.
const CHAIN: [(u32, &[u32]); 3] = [
    (TIM8, &[0x00, 0x04, 0x08, 0x0C, 0x10, 0x24, 0x28, 0x2C, 0x30]),
    (DMA2, &[0x00, 0x28, 0x2C, 0x30, 0x34, 0x3C]),
    (
        TIM1,
        &[
            0x00, 0x04, 0x08, 0x0C, 0x10, 0x18, 0x1C, 0x20, 0x24, 0x28, 0x2C, 0x30, 0x34, 0x38,
            0x3C, 0x40, 0x44,
        ],
    ),
];

/// Error flags of the stream (DMEIF1, TEIF1). After an error the stream may store nothing, so each must end in off.
const ERROR_FLAGS: [(u32, u8); 2] = [(DMA2, 8), (DMA2, 9)];

/// Time from `begun` until enable became inactive, in s. `None` if it is still active.
fn off_after(world: &World<'_>, begun: u64) -> Option<f64> {
    let off = world.powered.amplifier.changes().disabled_at.filter(|&at| at >= begun)?;
    let is_off = !world.powered.amplifier.is_enabled();
    is_off.then(|| (off - begun) as f64 / world.powered.board.chip.core_hz as f64)
}

/// Checks that enable is off within `limit_s`, in s, after the core has stopped. This limit is the timeout of the
/// output watchdog.
fn dead_core_is_off_within(world: &mut World<'_>, limit_s: f64, what: &str) {
    let begun = world.powered.mcu.now();
    world.powered.mcu.set_registers(|registers| registers.primask = true);
    world.run(60).unwrap();
    let off_s = off_after(world, begun).unwrap_or_else(|| panic!("{what}: a dead core stays on"));
    assert!(off_s <= limit_s, "{what}: a dead core is off after {off_s} s");
}

fn any_bit_of_the_output_watchdog_ends_in_off_or_leaves_it_at_work(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = pressed(&firmware);
    world.powered.mcu.outlive_lock_up();
    let before = world.snapshot();
    let mut counts = [0; 2];
    for (base, offsets) in CHAIN {
        for (address, bit) in offsets.iter().flat_map(|at| (0..32).map(move |bit| (base + at, bit)))
        {
            let what = format!("{address:#x} bit {bit}");
            world.restore(&before);
            let begun = world.powered.mcu.now();
            world.powered.mcu.flip_behind_the_bus(address, bit);
            world.run(30).unwrap();
            let off_s = off_after(&world, begun);
            counts[usize::from(off_s.is_some())] += 1;
            match off_s {
                Some(off_s) => assert!(off_s <= OFF_S, "{what}: off after {off_s} s"),
                None => {
                    assert!(!ERROR_FLAGS.contains(&(address, bit)), "{what}: stays on");
                    dead_core_is_off_within(&mut world, OFF_S, &what);
                }
            }
        }
    }
    println!("{}: {} bits end in off, {} do nothing", board.name, counts[1], counts[0]);
    assert!(counts[1] > 150, "{counts:?}");
    // The word that waits in the stream cannot be read. A wrong word is stored once, and the next word is right.
    for bit in 0..32 {
        world.restore(&before);
        world.powered.mcu.flip_fetched(bit);
        dead_core_is_off_within(&mut world, 2.0 * OFF_S, &format!("fetched word, bit {bit}"));
    }
}

/// The test changes the counter of the sample timer at each sample. So the rate is wrong, but all registers have their
/// set-up values.
fn a_rate_that_is_off_by_more_than_2_percent_is_found_from_both_sides(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = pressed(&firmware);
    let before = world.snapshot();
    let ticks = board.cycles_per_sample() as f64 / 2.0;
    for (percent, found) in [(-2.6, true), (2.6, true), (-1.4, false), (1.4, false)] {
        world.restore(&before);
        let begun = world.powered.mcu.now();
        let moved = (ticks * percent / 100.0) as i32;
        // Two rounds of 64 outputs of 10 samples, since a comparison may already run.
        for _ in 0..1_400 {
            let events = world.powered.mcu.events();
            while world.powered.mcu.events() == events {
                world.run_to(world.powered.mcu.now() + 1_000).unwrap();
            }
            let event = world.powered.mcu.last_event().unwrap();
            world.run_to(event + board.cycles_per_sample() / 2).unwrap();
            let now = world.powered.mcu.peek(TIM5 + 0x24);
            world.powered.mcu.poke(TIM5 + 0x24, now.wrapping_add_signed(moved));
        }
        let off = world.powered.amplifier.changes().disabled_at.filter(|&at| at >= begun);
        assert_eq!(off.is_some(), found, "{percent} %");
        let status = ok(&mut world, "status");
        assert_eq!(status.contains("fault 24 (sample rate)"), found, "{percent} %: {status}");
    }
}
