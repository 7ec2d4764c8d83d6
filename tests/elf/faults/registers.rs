//! Bits of registers that flip: force has to be off within 3 ms, and the board says what it found. And a sample timer
//! that runs at another rate.

use virtual_board::{
    board::{Board, Force},
    world::World,
};

use super::run_case::lead;
use crate::{
    figure::figure,
    firmware::{Firmware, arm, ok},
};

each_board!(
    a_register_that_changes_takes_the_force_away_within_3_ms,
    a_rate_that_is_off_by_more_than_2_percent_is_found_from_both_sides
);

const RCC: u32 = 0x4002_3800;
const GPIOA: u32 = 0x4002_0000;
const GPIOE: u32 = 0x4002_1000;
const TIM1: u32 = 0x4001_0000;
const TIM2: u32 = 0x4000_0000;
const TIM5: u32 = 0x4000_0C00;
const TIM6: u32 = 0x4000_1000;
const TIM8: u32 = 0x4001_0400;
const DMA2_STREAM1: u32 = 0x4002_6428;
const NVIC_PRIORITIES: u32 = 0xE000_E400;

/// Longest time until enable is inactive, s.
const OFF_S: f64 = 3e-3;

/// What happens to a register.
#[derive(Clone, Copy)]
enum Change {
    /// Bits flip.
    Flip(u32),
    /// It is this.
    Be(u32),
}
use Change::{Be, Flip};

/// Name, register, change, and whether the program lives to say 43.
type Row = (&'static str, u32, Change, bool);

fn rows(board: Board) -> Vec<Row> {
    let mut rows: Vec<Row> = vec![
        ("TIM5 at half the rate", TIM5 + 0x2C, Be(board.cycles_per_sample() as u32 - 1), true),
        (
            "TIM5 at 6.9 kHz",
            TIM5 + 0x2C,
            Be((board.cycles_per_sample() as f64 * 0.725) as u32),
            true,
        ),
        ("TIM5 ARR bit 16", TIM5 + 0x2C, Flip(1 << 16), false),
        ("TIM5 PSC 15", TIM5 + 0x28, Be(15), false),
        ("TIM5 CEN", TIM5, Flip(1), false),
        ("TIM5 UIE", TIM5 + 0x0C, Flip(1), false),
        ("TIM6 CEN", TIM6, Flip(1), true),
        ("TIM6 PSC", TIM6 + 0x28, Flip(1 << 4), true),
        ("TIM2 CEN", TIM2, Flip(1), true),
        ("TIM2 SMS", TIM2 + 0x08, Flip(1), true),
        ("TIM2 direction", TIM2 + 0x20, Flip(1 << 1), true),
        ("TIM2 filter", TIM2 + 0x18, Flip(1 << 4), true),
        ("TIM2 ARR", TIM2 + 0x2C, Flip(1 << 20), true),
        ("TIM1 CC3E", TIM1 + 0x20, Flip(1 << 8), true),
        ("TIM8 CEN", TIM8, Flip(1), true),
        ("TIM8 UDE", TIM8 + 0x0C, Flip(1 << 8), true),
        ("TIM8 ARR", TIM8 + 0x2C, Flip(1 << 15), true),
        ("TIM8 PSC", TIM8 + 0x28, Flip(1 << 14), true),
        ("DMA2 stream off", DMA2_STREAM1, Flip(1), true),
        ("TIM8 without clock", RCC + 0x44, Flip(1 << 1), true),
        ("DMA2 without clock", RCC + 0x30, Flip(1 << 22), true),
        ("TIM6 without clock", RCC + 0x40, Flip(1 << 4), false), // a halt as well
        ("TIM5 without clock asleep", RCC + 0x60, Flip(1 << 3), true),
        ("clock divider of APB1", RCC + 0x08, Flip(1 << 10), true),
        ("clock security system", RCC, Flip(1 << 19), true),
        ("encoder's pin", GPIOA, Flip(1 << 2), true),
        ("voltage detector", 0x4000_7000, Flip(1 << 4), true),
        ("`sample` at the lowest priority", NVIC_PRIORITIES + 48, Flip(0x00E0_0000), true),
        ("`render` above `sample`", NVIC_PRIORITIES + 48, Flip(0x2000_0000), true),
        ("priority groups", 0xE000_ED0C, Be(0x05FA_0500), true),
        ("a second interrupt", 0xE000_E104, Be(1 << 23), true),
    ];
    match board.wiring.force {
        Force::Dac { .. } => rows.extend([
            ("enable's pin a GPIO", GPIOA, Flip(0b11 << 20), true),
            ("DAC off", 0x4000_7400, Flip(1), true),
            ("DAC's pin", GPIOA, Flip(0b11 << 8), true),
        ]),
        Force::Pwm { .. } => rows.extend([
            ("enable's pin a GPIO", GPIOE, Flip(0b11 << 26), true),
            ("TIM1 ARR", TIM1 + 0x2C, Flip(1 << 11), true),
            ("PWM's pin", GPIOE, Flip(0b11 << 18), true),
        ]),
    }
    rows
}

/// Armed, pressed into the wall, in the middle between two outputs.
fn pressed(firmware: &Firmware) -> World<'_> {
    let mut world = firmware.boot();
    arm(&mut world);
    let zero_m = world.position_m();
    lead(&mut world, zero_m + 5.3e-3);
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
    for (name, address, change, says) in rows(board) {
        world.restore(&before);
        let begun = world.powered.mcu.now();
        let was = world.powered.mcu.peek(address);
        let value = match change {
            Flip(bits) => was ^ bits,
            Be(value) => value,
        };
        world.powered.mcu.poke(address, value);
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
    figure(&format!("elf/faults/registers/{}/rows", board.name), rows(board).len());
    // What is locked stays as it is.
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

/// The sample timer's counter is moved at each sample, so that no register is other than it was set up.
fn a_rate_that_is_off_by_more_than_2_percent_is_found_from_both_sides(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = pressed(&firmware);
    let before = world.snapshot();
    let ticks = board.cycles_per_sample() as f64 / 2.0;
    for (percent, found) in [(-2.6, true), (2.6, true), (-1.4, false), (1.4, false)] {
        world.restore(&before);
        let begun = world.powered.mcu.now();
        let moved = (ticks * percent / 100.0) as i32;
        // Two rounds of 64 outputs of 10 samples: a comparison may have begun before.
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
