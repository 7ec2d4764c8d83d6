//! What must switch the force off, done to the release ELF while it is armed: how long until
//! enable is inactive, which fault is latched, and that only `clear` and `arm` bring force back.
#![allow(clippy::unwrap_used, reason = "a test may stop")]
#![allow(clippy::cast_precision_loss, reason = "small numbers")]

mod elf;

use elf::{Firmware, arm, ok};
use virtual_board::{board::BOARDS, world::World};

/// One way to go wrong.
struct Trouble {
    name: &'static str,
    /// Expected code.
    code: u32,
    /// Longest time until enable is inactive, us: by the design one output and one sample, or one
    /// sample where the guard sees it.
    limit_us: f64,
    begin: fn(&mut World<'_>),
    end: fn(&mut World<'_>),
}

fn nothing(_: &mut World<'_>) {}

const SAMPLE_US: f64 = 100.0;
const RENDER_US: f64 = 1_100.0;
/// The world moves in samples: an event may be seen up to one sample late.
const GRID_US: f64 = 100.0;

const TROUBLES: [Trouble; 6] = [
    Trouble {
        name: "emergency stop",
        code: 30,
        limit_us: 1.0, // the break input needs no code
        begin: |world| {
            let stop = world.powered.board.wiring.stop;
            world.powered.mcu.set_break(stop, true);
        },
        end: |world| {
            let stop = world.powered.board.wiring.stop;
            world.powered.mcu.set_break(stop, false);
        },
    },
    Trouble {
        name: "brown-out",
        code: 31,
        limit_us: RENDER_US + GRID_US,
        begin: |world| world.powered.mcu.set_supply_low(true),
        end: |world| world.powered.mcu.set_supply_low(false),
    },
    Trouble {
        name: "count jump",
        code: 10,
        limit_us: SAMPLE_US + GRID_US,
        begin: |world| world.hold(world.position_m() + 700e-6, true),
        end: nothing,
    },
    Trouble {
        name: "over-speed",
        code: 11,
        limit_us: 20.0 * SAMPLE_US, // of which most is the filter's delay
        begin: |world| {
            let start_m = world.position_m();
            for n in 1..=20 {
                world.hold(start_m + 250e-6 * f64::from(n), true);
                world.sample().unwrap();
                if !world.powered.amplifier.is_enabled() {
                    break;
                }
            }
        },
        end: nothing,
    },
    Trouble {
        name: "debugger halt",
        code: 32,
        limit_us: 1.0, // TIM1 drops its outputs with the core halted
        begin: |world| {
            // Shorter than the watchdog's patience, and a whole number of samples.
            let cycles = 300 * world.powered.board.cycles_per_sample();
            world.halt(cycles);
        },
        end: nothing,
    },
    Trouble {
        name: "reset while armed",
        code: 23,
        limit_us: 1.0,
        begin: |world| world.reset(),
        end: nothing,
    },
];

#[test]
fn every_trouble_takes_the_force_away_in_time_and_says_why() {
    println!("board           trouble             off after       fault");
    for board in BOARDS {
        let firmware = Firmware::of(board);
        for trouble in &TROUBLES {
            let us = suffer(&firmware, trouble);
            println!("{:15} {:18} {us:8.1} us {:8}", board.name, trouble.name, trouble.code);
            assert!(us <= trouble.limit_us, "{}: {us} us", trouble.name);
        }
    }
}

/// Arms, makes trouble, checks what came of it and the way back; us until enable was inactive.
fn suffer(firmware: &Firmware, trouble: &Trouble) -> f64 {
    let name = trouble.name;
    let mut world = firmware.boot();
    arm(&mut world);
    assert!(world.powered.amplifier.is_enabled());
    let begun = world.powered.mcu.now();
    (trouble.begin)(&mut world);
    world.run(40).unwrap();
    let off = world.powered.amplifier.changes().disabled_at;
    assert!(off.is_some_and(|at| at >= begun), "{name}: enable never went inactive");
    assert!(!world.powered.amplifier.is_enabled(), "{name}");
    world.run(500).unwrap();
    world.replies.clear();
    let status = ok(&mut world, "status");
    assert!(status.contains(&format!("fault {} ", trouble.code)), "{name}: {status}");
    let refused = world.ask("arm").unwrap();
    assert!(refused.starts_with("error"), "{name}: {refused}");
    (trouble.end)(&mut world);
    let rest_m = world.position_m();
    world.hold(rest_m, true);
    world.run(500).unwrap();
    assert!(!world.powered.amplifier.is_enabled(), "{name}: force came back by itself");
    ok(&mut world, "clear");
    world.run(100).unwrap();
    assert!(!world.powered.amplifier.is_enabled(), "{name}: force came back with clear");
    let after = ok(&mut world, "status");
    assert!(after.contains("ok status off, fault none"), "{name}: {after}");
    let cycles = off.unwrap_or(begun).saturating_sub(begun);
    cycles as f64 / (world.powered.mcu.core_hz() as f64 / 1e6)
}

/// A host that stops reading and then floods, with every channel set to blocking.
#[test]
fn a_host_that_stalls_floods_or_blocks_changes_nothing_in_the_loop() {
    for board in BOARDS {
        let firmware = Firmware::of(board);
        let mut world = firmware.boot();
        arm(&mut world);
        world.powered.mcu.watch_mut().clear();
        for channel in 0..3 {
            let virtual_board::board::Powered { mcu, rtt, .. } = &mut world.powered;
            rtt.set_mode(mcu, channel, 2);
        }
        for n in 0..4_000 {
            let virtual_board::board::Powered { mcu, rtt, .. } = &mut world.powered;
            rtt.write(mcu, 0, if n % 2 == 0 { b"help\nget\n" } else { b"\xff\x00k 1e\n~~" });
            world.sample().unwrap();
        }
        let watch = world.powered.mcu.watch();
        assert!(watch.delay_spread() <= 64, "{:?}", watch.delays);
        assert_eq!(watch.primask, 0);
        assert!(world.powered.amplifier.is_enabled(), "the loop did not survive");
        assert_eq!(world.powered.mcu.resets(), 0);
    }
}
