//! Tests the unmodified release ELF of each board: its layout in flash, its boot, and that two runs are equal.

use std::{ops::Range, path::Path};

use host_sim::scene::{
    Criterion, Protocol, PushBy, RmsOf, Scene,
    element::{EncoderError, EncoderNoise, Jitter},
};
use virtual_board::{
    board::{Board, Force, NUCLEO_F446RE},
    elf::Elf,
    world::World,
};
use zwidth::telemetry::Decoder;

use crate::firmware::{Firmware, ok};

#[allow(dead_code, reason = "the rest of it makes files")]
#[path = "../../build.rs"]
mod build_script;

each_board!(
    no_byte_of_the_image_lies_in_the_settings_sectors,
    a_board_boots_with_the_output_off_and_answers,
    a_handle_that_moves_at_a_boot_has_not_jumped,
    two_runs_are_the_same_bit_for_bit,
    force_reaches_the_plant_and_disarm_takes_it_away
);

/// Sectors 1 and 2 of the flash, which store the settings.
const SETTINGS: Range<u32> = 0x0800_4000..0x0800_C000;

fn has_its_vectors(elf: &Elf) {
    let (address, size) = elf.section(".vector_table").unwrap();
    assert_eq!(address, 0x0800_0000);
    assert!(size >= 16 * 4 + 82 * 4, "{size}");
    assert!(address + size <= SETTINGS.start);
}

fn no_byte_of_the_image_lies_in_the_settings_sectors(board: Board) {
    let firmware = &Firmware::of(board);
    has_its_vectors(&firmware.elf);
    for (address, bytes) in &firmware.elf.flash {
        let end = address + u32::try_from(bytes.len()).unwrap();
        assert!(end <= SETTINGS.start || *address >= SETTINGS.end, "{address:#x}..{end:#x}");
        assert!(end <= 0x0808_0000, "beyond 512 KiB: {end:#x}");
    }
}

fn a_board_boots_with_the_output_off_and_answers(board: Board) {
    let firmware = &Firmware::of(board);
    let mut world = firmware.boot();
    let version = ok(&mut world, "version");
    let name = firmware.board.name;
    assert!(version.contains(&format!(", board {name}, scene {name} ")), "{version}");
    let (commit, _) = build_script::commit(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")));
    assert!(version.contains(&format!(", commit {commit}, board ")), "{version}: not {commit}");
    let status = ok(&mut world, "status");
    assert!(status.contains("ok status off, fault none"), "{status}");
    assert!(status.contains("stop closed, supply good"), "{status}");
    let mcu = &world.powered.mcu;
    assert!(!world.powered.amplifier.is_enabled());
    assert!(!mcu.pin(firmware.board.wiring.enable));
    assert_eq!(world.powered.amplifier.command(), 0);
    assert_eq!((mcu.resets(), mcu.hard_faults()), (0, &[][..]));
}

fn a_handle_that_moves_at_a_boot_has_not_jumped(board: Board) {
    let firmware = &Firmware::of(board);
    for speed_m_per_s in [0.5, -0.5, 2.0] {
        let mut world = firmware.boot();
        world.lead(speed_m_per_s);
        world.reset();
        world.run(2_000).unwrap();
        let status = ok(&mut world, "status");
        assert!(status.contains("ok status off, fault none"), "{speed_m_per_s}: {status}");
    }
}

/// Runs a hit. Returns the lines of the log, the telemetry, the handle's last position, and the number of instructions.
fn session(firmware: &Firmware) -> (Vec<String>, Vec<u8>, u64, u64) {
    let mut world = firmware.armed();
    ok(&mut world, "hit");
    world.run(3_000).unwrap();
    let state = (world.position_m().to_bits(), world.powered.mcu.instructions());
    (world.lines, world.telemetry, state.0, state.1)
}

fn two_runs_are_the_same_bit_for_bit(board: Board) {
    let firmware = &Firmware::of(board);
    let (first, second) = (session(firmware), session(firmware));
    assert!(first.1.len() > 20_000, "{}", first.1.len());
    assert_eq!(first, second);
}

fn force_reaches_the_plant_and_disarm_takes_it_away(board: Board) {
    let firmware = &Firmware::of(board);
    let mut world = firmware.armed();
    let free_m = world.position_m();
    ok(&mut world, "hit");
    let mut deepest_m = free_m;
    for _ in 0..500 {
        world.run(10).unwrap();
        deepest_m = deepest_m.max(world.position_m());
    }
    let surface_m = firmware.scene.device.rest_position_m + 0.005;
    assert!(free_m < surface_m, "{free_m}");
    assert!(deepest_m > surface_m, "the push does not reach the wall: {deepest_m}");
    assert!(world.powered.amplifier.is_enabled());
    ok(&mut world, "disarm");
    world.run(10).unwrap(); // takes effect with the next output
    assert!(!world.powered.amplifier.is_enabled());
    if matches!(firmware.board.wiring.force, Force::Dac { .. }) {
        assert_eq!(world.powered.amplifier.command(), 0);
    }
}

#[test]
fn an_unknown_board_has_no_name() {
    assert_eq!(Board::named("nucleo-f446re"), Some(NUCLEO_F446RE));
    assert_eq!(Board::named("nucleo"), None);
}

/// The encoder's signals include the errors of the scene's encoder. Elements that the board lacks are refused.
#[test]
fn the_encoders_error_and_noise_reach_the_board_and_what_it_has_not_is_refused() {
    let mut firmware = Firmware::of(NUCLEO_F446RE);
    let at_m = firmware.scene.device.rest_position_m;
    let counts = |firmware: &Firmware, moved_m: f64| {
        let mut world = firmware.boot();
        world.hold(at_m, true);
        world.run(20).unwrap();
        ok(&mut world, "zero");
        world.hold(at_m + moved_m, true);
        world.telemetry.clear();
        world.run(1_000).unwrap();
        let mut decoder = Decoder::new();
        let frames = std::mem::take(&mut world.telemetry);
        let records = frames.into_iter().filter_map(|byte| decoder.push(byte));
        records.map(|frame| frame.record.position.counts()).skip(50).collect::<Vec<_>>()
    };
    let still = counts(&firmware, 100e-6);
    assert!(still.len() > 30 && still.iter().all(|&count| count == 100), "{still:?}");

    let error = EncoderError { cycle_m: 4e-4, first_m: 2e-5, second_m: 0.0, phase_rad: 0.0 };
    firmware.scene.encoder_error = Some(error);
    let wrong = counts(&firmware, 100e-6);
    let expected = 100.0 + (error.error_m(at_m + 100e-6) - error.error_m(at_m)) / 1e-6;
    assert!((expected - 100.0).abs() > 5.0, "{expected}");
    assert!(wrong.iter().all(|&count| (f64::from(count) - expected).abs() <= 1.0), "{wrong:?}");

    firmware.scene.encoder_error = None;
    firmware.scene.encoder_noise = Some(EncoderNoise { rms_m: 2e-6, seed: 1 });
    let noisy = counts(&firmware, 100e-6);
    let square = |count: &i32| f64::from(count - 100).powi(2);
    #[expect(clippy::cast_precision_loss, reason = "a hundred")]
    let rms = (noisy.iter().map(square).sum::<f64>() / noisy.len() as f64).sqrt();
    assert!((1.0..6.0).contains(&rms), "{rms}"); // the zero has an error too

    let Firmware { board, elf, table, scene } = &firmware;
    let refused = |edit: fn(&mut Scene), what: &str| {
        let mut scene = scene.clone();
        edit(&mut scene);
        let refused = World::new(*board, elf, table, &scene, 0.0).err().unwrap();
        assert!(refused.contains(what), "{refused}");
    };
    refused(|scene| scene.jitter = Some(Jitter { peak_s: 1e-6, seed: 1 }), "[jitter]");
    refused(|scene| scene.wall_hit.push_by = PushBy::Hand, "wall_hit");
    refused(|scene| scene.wall_hit.protocol = Protocol::Taps, "wall_hit");
    refused(|scene| scene.wall_hit.rms_of = Some(RmsOf::Motion), "wall_hit");
    refused(|scene| scene.wall_hit.criterion = Criterion::Felt, "wall_hit");
}
