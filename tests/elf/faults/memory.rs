//! Flips bits in the memory of `render`, and in the data that `render` gives to `sample`. Data that decides a force is
//! stored twice.

use virtual_board::{
    board::Board,
    elf::SAMPLE_STATE,
    world::{Snapshot, World},
};

use crate::{
    figure::figure,
    firmware::{Firmware, arm, ok},
};

each_board!(
    a_number_that_decides_a_force_is_kept_twice, ignored: "half a minute; CI runs it"
);

/// Longest time until enable is inactive, in s.
const OFF_S: f64 = 3e-3;

/// Address and size of the static whose name contains `name`.
fn place(firmware: &Firmware, name: &str) -> (u32, u32) {
    let mut symbols = firmware.elf.symbols.iter();
    let (_, from, size) = symbols.find(|(symbol, ..)| symbol.contains(name)).unwrap();
    (*from, *size)
}

fn bytes(world: &World<'_>, (from, size): (u32, u32)) -> Vec<u8> {
    let mut bytes = vec![0; size as usize];
    world.powered.mcu.read(from, &mut bytes);
    bytes
}

fn words(world: &World<'_>, place: (u32, u32), value: i32) -> Vec<u32> {
    let bytes = bytes(world, place);
    let words = bytes.chunks_exact(4).zip((place.0..).step_by(4));
    words.filter(|(word, _)| **word == value.to_le_bytes()).map(|(_, at)| at).collect()
}

/// Addresses of the bytes that are 0 in each memory of `without` and 1 in each memory of `with`.
fn flags(place: (u32, u32), without: &[Vec<u8>], with: &[Vec<u8>]) -> Vec<u32> {
    let is = |all: &[Vec<u8>], at: usize, value| all.iter().all(|bytes| bytes[at] == value);
    (0..place.1 as usize)
        .filter(|&at| is(without, at, 0) && is(with, at, 1))
        .map(|at| place.0 + at as u32)
        .collect()
}

/// Flips a bit of the byte at `at`. Returns the time until enable is inactive, and the board's status.
fn flip(world: &mut World<'_>, before: &Snapshot, at: u32, bit: u8) -> (Option<f64>, String) {
    world.restore(before);
    let begun = world.powered.mcu.now();
    let mut byte = [0];
    world.powered.mcu.read(at, &mut byte);
    world.powered.mcu.write(at, &[byte[0] ^ 1 << bit]);
    for _ in 0..60 {
        world.sample().unwrap();
    }
    let off = world.powered.amplifier.changes().disabled_at.filter(|&at| at >= begun);
    let hz = world.powered.board.chip.core_hz as f64;
    (off.map(|at| (at - begun) as f64 / hz), ok(world, "status"))
}

fn a_number_that_decides_a_force_is_kept_twice(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.boot();
    let render = place(&firmware, "local_resource_render");
    let sample = place(&firmware, SAMPLE_STATE);
    // The motor's sign is a byte. The test finds this byte by a change of the sign with the force off.
    let mut seen = [Vec::new(), Vec::new()];
    for turned in [0, 1, 0, 1, 0] {
        ok(&mut world, ["motor +", "motor -"][turned]);
        world.run(37).unwrap();
        seen[turned].push(bytes(&world, render));
    }
    let signs = flags(render, &seen[0], &seen[1]);
    assert_eq!(signs.len(), 2, "the motor's sign and its copy: {signs:x?}");
    arm(&mut world);
    let zero_m = world.position_m();
    world.lead_to(zero_m + 5.3e-3).unwrap();
    world.run(54).unwrap();
    let before = world.snapshot();

    let surface = words(&world, render, 5_000);
    let travel = words(&world, render, -40_000);
    let sampled = words(&world, sample, 5_000);
    println!("{}: surface {surface:x?} {sampled:x?} travel {travel:x?}", board.name);
    assert!(!surface.is_empty() && travel.len() == 2 && !sampled.is_empty());
    let mut longest: f64 = 0.0;
    let mut found = [0; 4];
    let places = [(signs, 0..1), (travel, 0..32), (surface, 0..32), (sampled, 0..32)];
    for (kind, (places, bits)) in places.into_iter().enumerate() {
        for at in places {
            for bit in bits.clone().step_by(15) {
                let (off, status) = flip(&mut world, &before, at + bit / 8, (bit % 8) as u8);
                let said = status.contains("fault 44 (memory)");
                found[kind] += u32::from(said);
                if said {
                    let off = off.unwrap_or_else(|| panic!("{at:#x} {bit}: enable stays active"));
                    longest = longest.max(off);
                }
            }
        }
    }
    println!("{}: found {found:?}, off after {:.3} ms at most", board.name, longest * 1e3);
    figure(&format!("elf/faults/memory/{}", board.name), longest * 1e6);
    // Each value and its copy are found. The surface is in words of `render` and in one of the two buffers of `sample`,
    // the valid buffer.
    assert!(found[0] == 2 && found[1] == 2 * 3 && found[2] >= 3 && found[3] >= 3, "{found:?}");
    assert!(longest <= OFF_S, "{longest}");
}
