//! Tests hardware that does not do what the program commands: a DAC with a wrong output, converters that stop, an
//! amplifier with a constant force while the handle does not move. Without a defect there is no false alarm at any
//! force.

use host_sim::scene::{MotorTable, NamedScene, Scene};
use virtual_board::{
    board::{Board, NUCLEO_F446RE},
    device,
    world::World,
};

use super::registers::pressed;
use crate::{
    figure::figure,
    firmware::{Firmware, ok},
};

each_board!(
    an_amplifier_that_is_stuck_is_found_by_its_current,
    a_force_that_hums_from_end_to_end_is_no_false_alarm
);

/// Current signal as a fraction of the supply. The first value is without current, the second at full command.
const SENSE: [Option<f64>; 2] = [Some(0.5), Some(0.2)];

/// The image for a device with this current signal, or without a current signal.
fn saying(board: Board, [current_sense_rest, current_sense_full]: [Option<f64>; 2]) -> Firmware {
    let mut named = NamedScene::load(board.name).unwrap();
    named.name = "sensing".into();
    let motor = named.scene.motor.unwrap_or_default();
    named.scene.motor = Some(MotorTable { current_sense_rest, current_sense_full, ..motor });
    let record = device::record(&named, board).unwrap().unwrap();
    let plain = Firmware::of(board);
    let elf = plain.elf.with_record(&record).unwrap();
    let scene = Scene { motor: named.scene.motor, ..plain.scene };
    Firmware { elf, scene, ..plain }
}

/// Runs until enable is inactive and returns the time in ms. Returns `None` if it takes longer than 0.1 s.
fn off_ms(world: &mut World<'_>) -> Option<f64> {
    let begun = world.powered.mcu.now();
    world.run(1000).unwrap();
    let off = world.powered.amplifier.changes().disabled_at.filter(|&at| at >= begun);
    off.map(|at| (at - begun) as f64 * 1e3 / world.powered.board.chip.core_hz as f64)
}

#[test]
fn a_dac_that_gives_something_else_is_off_within_3_ms() {
    let firmware = Firmware::of(NUCLEO_F446RE);
    let mut world = pressed(&firmware);
    let before = world.snapshot();
    let mut most = 0.0f64;
    for part in [-1.0, -0.05, 0.05, 0.1, 0.5] {
        world.restore(&before);
        world.defects.dac = part;
        let off = off_ms(&mut world).unwrap_or_else(|| panic!("{part}: enable stays active"));
        println!("DAC off by {part} of full scale: {off:.3} ms");
        assert!(off <= 3.0, "{part}: {off} ms");
        most = most.max(off);
        world.replies.clear();
        let status = ok(&mut world, "status");
        assert!(status.contains("fault 35 (force output)"), "{part}: {status}");
        world.defects.dac = 0.0;
        ok(&mut world, "clear");
    }
    figure("elf/faults/acts/dac", most * 1e3);
    // The tolerance is 2 % of the range, which is 4 % of full scale. An error within this tolerance causes no fault.
    world.restore(&before);
    world.defects.dac = 0.035;
    assert_eq!(off_ms(&mut world), None);
    // A converter that gives no result.
    world.restore(&before);
    world.defects.converters_stand = true;
    let off = off_ms(&mut world).expect("enable stays active");
    assert!(off <= 3.0, "{off} ms");
}

fn an_amplifier_that_is_stuck_is_found_by_its_current(board: Board) {
    let firmware = saying(board, SENSE);
    let mut world = pressed(&firmware);
    let before = world.snapshot();
    // The handle is held where the force is 40 % of full scale.
    for (part, most_ms) in [(1.0, 5.0), (-1.0, 9.0), (0.0, 14.5)] {
        world.restore(&before);
        world.defects.stuck = Some(part);
        let off = off_ms(&mut world).unwrap_or_else(|| panic!("{part}: enable stays active"));
        println!("{}: amplifier stuck at {part}: {off:.3} ms", board.name);
        assert!(off <= most_ms, "{part}: {off} ms");
        figure(&format!("elf/faults/acts/{}/stuck {part}", board.name), off * 1e3);
        world.replies.clear();
        let status = ok(&mut world, "status");
        assert!(status.contains("fault 36 (motor current)"), "{part}: {status}");
    }
    // A difference below one quarter is allowed. Without the current input nothing is checked.
    world.restore(&before);
    world.defects.stuck = Some(-0.2);
    assert_eq!(off_ms(&mut world), None);
    let plain = Firmware::of(board);
    let mut world = pressed(&plain);
    world.defects.stuck = Some(1.0);
    assert_eq!(off_ms(&mut world), None);
}

fn a_force_that_hums_from_end_to_end_is_no_false_alarm(board: Board) {
    let firmware = saying(board, SENSE);
    for (wall, verdict) in [("k 200000", "ok hit stable"), ("k 3000000", "ok hit unstable")] {
        let mut world = firmware.armed();
        for line in ["cutoff 1500", wall, "b 300", "settle 0.3", "window 0.2", "hit"] {
            ok(&mut world, line);
        }
        world.run(6_000).unwrap();
        assert!(world.replies.contains(verdict), "{wall}: {}", world.replies);
        let status = ok(&mut world, "status");
        assert!(status.starts_with("ok status armed, fault none"), "{wall}: {status}");
    }
}
