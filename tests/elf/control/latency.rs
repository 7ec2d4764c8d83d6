//! The force acts within the latency of the simulator.

use host_sim::scene::NamedScene;
use virtual_board::board::{Board, Force};

use crate::{
    figure::figure,
    firmware::{Firmware, ok},
};

each_board!(commands_reach_their_register_within_the_latency_that_the_simulator_is_given);

/// Settling time of the DAC by its data sheet, in s. This time is the last part of the latency, after the write of the
/// register.
const DAC_SETTLES_S: f64 = 3e-6;

/// Time after a sample at which the PWM takes over a command, in s (`LEAD_CYCLES` of the board). A command that comes
/// after this time acts 25 us later.
const TAKEN_OVER_S: f64 = 14e-6;

/// Fraction of [`TAKEN_OVER_S`] that must remain unused. The emulator has no wait states, but the chip has.
const RESERVE: f64 = 0.2;

fn commands_reach_their_register_within_the_latency_that_the_simulator_is_given(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
    world.powered.mcu.watch_mut().clear();
    for line in ["settle 0.1", "window 0.1", "kstart 2000", "kstep 4000", "bstart 20"] {
        ok(&mut world, line);
    }
    // All work that an output may have: return moves, hits, changes that fade, walls of a walk, a calibration, reading
    // the black box, and arming again. The write of `disarm` between two outputs is left out.
    let mut most = 0;
    for (line, samples) in [
        ("hit", 12_000),
        ("k 30000", 100),
        ("b 200", 100),
        ("stop", 500),
        ("cutoff 400", 100),
        ("walk", 25_000),
        ("stop", 2_000),
        ("start -0.01", 100),
        ("hit", 3_000),
        ("stop", 2_000),
        ("calibrate 9", 2_000),
        ("stop", 2_000),
        ("faults", 1_000),
        ("disarm", 100),
        ("unlock envelope", 100),
        ("arm", 4_000),
    ] {
        if line == "disarm" {
            most = world.powered.mcu.watch().commands.most;
        }
        if line == "calibrate 9" {
            world.hold(world.position_m(), true); // the move begins only at rest
            world.run(2_000).unwrap();
        }
        if line == "faults" {
            world.hold(world.position_m(), false);
        }
        world.send(&format!("{line}\n")).unwrap();
        world.run(samples).unwrap();
        if line == "disarm" {
            world.powered.mcu.watch_mut().clear();
        }
    }
    let anew = world.powered.mcu.watch().commands;
    let most = most.max(anew.most);
    // A hit in contact without changes of settings. The simulator's latency is for this case.
    ok(&mut world, "start 0");
    ok(&mut world, "settle 3");
    ok(&mut world, "hit");
    world.run(20_000).unwrap();
    world.powered.mcu.watch_mut().clear();
    world.run(10_000).unwrap();
    let status = ok(&mut world, "status");
    assert!(status.contains("hit, ") && status.contains("in contact"), "{status}");
    let steady = world.powered.mcu.watch().commands;

    let cycles = |seconds: f64| seconds * board.chip.core_hz as f64;
    let latency = NamedScene::load(board.name).unwrap().scene.actuator.latency;
    let settles = match board.wiring.force {
        Force::Dac { .. } => cycles(DAC_SETTLES_S),
        Force::Pwm { .. } => 0.0,
    };
    let stated = latency * board.cycles_per_sample() as f64 - settles;
    println!(
        "{}: event to register {}..{} cycles in a hit, of {stated:.0}; {most} at most in all",
        board.name, steady.least, steady.most
    );
    figure(&format!("elf/control/{}/register_in_a_hit", board.name), steady.most);
    figure(&format!("elf/control/{}/register_of_all", board.name), most);
    assert!(steady.runs >= 1_000 && anew.runs > 300, "{steady:?} {anew:?}");
    assert!(steady.most as f64 <= stated, "{steady:?} of {stated}");
    let reserved = cycles(TAKEN_OVER_S) * (1.0 - RESERVE);
    assert!(most as f64 <= reserved, "{most} of {reserved}");
}
