//! Runs a rotary scene, and the linear scene of the same device at its handle, on the same image. The settings in force
//! are equal bit for bit. So the hit is the same, and the texts differ only in their units. Longer texts take more
//! cycles, and an interrupt waits for the running instruction. So a count that is about to change may be read a sample
//! later.

use std::{collections::BTreeMap, path::Path};

use host_sim::scene::NamedScene;
use virtual_board::{board::Board, device::record, session::Session};
use zwidth::telemetry::{Decoder, Flags, Frame, InForce, Record};

use crate::firmware::{Firmware, ok};

each_board!(a_rotary_device_hits_as_the_same_one_at_its_handle);

const RADIUS_M: f64 = 0.07;

/// The unit of a value at the handle, its unit about the axis, and a power. The value about the axis is the value at
/// the handle times the radius to this power.
const UNITS: [(&str, &str, i32); 5] = [
    (" N s/m", " N m s/rad", 2),
    (" N/m", " N m/rad", 2),
    (" N", " N m", 1),
    (" m", " rad", -1),
    (" J", " J", 0),
];

/// The file of a scene, and the lines that are typed.
type Typed = (&'static str, [&'static str; 6]);
const LINEAR: Typed =
    ("by-hand.toml", ["wall 0.035", "k 1000", "b 10", "push 0.7", "rms 2.8e-5", "start 0"]);
const ROTARY: Typed =
    ("rotary.toml", ["wall 0.5", "k 4.9", "b 0.049", "push 0.049", "rms 4e-4", "start 0"]);
/// Number of samples from one typed line to the next. It is fixed, so the length of the replies does not matter.
const SLOT: u64 = 500;

/// Runs one hit. Returns the replies, the telemetry from `arm` on, and the settings in the telemetry.
fn hit(board: Board, (file, typed): Typed) -> (Vec<String>, Vec<Frame>, Vec<InForce>) {
    let Firmware { elf, table, .. } = Firmware::of(board);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../host-sim/tests/program/paddle");
    let mut scene = NamedScene::load(folder.join(file).to_str().unwrap()).unwrap();
    scene.name = "paddle".into();
    let elf = elf.with_record(&record(&scene, board).unwrap().unwrap()).unwrap();
    let session = Session { board, scene, elf, table };
    let mut world = session.boot_at_zero().unwrap();
    let slot = SLOT * world.powered.board.cycles_per_sample();
    let mut said = vec![];
    for line in [&["unlock envelope", "settle 0.4", "window 0.2"][..], &typed, &["arm"]].concat() {
        let next = (world.powered.mcu.now() / slot + 1) * slot;
        world.run_to(next).unwrap();
        if line == "arm" {
            world.telemetry.clear();
        }
        said.push(ok(&mut world, line));
    }
    world.run(6_000).unwrap();
    let next = (world.powered.mcu.now() / slot + 1) * slot;
    world.run_to(next).unwrap();
    ok(&mut world, "hit");
    said.push(world.reply(60_000).unwrap());
    let mut decoder = Decoder::new();
    let bytes = std::mem::take(&mut world.telemetry);
    let (mut frames, mut in_force) = (vec![], vec![]);
    for byte in bytes {
        if let Some(frame) = decoder.push(byte) {
            frames.push(frame);
            in_force.extend(decoder.parts().settings().flatten());
        }
    }
    said.extend([ok(&mut world, "get"), world.ask("k 1e9").unwrap()]);
    (said, frames, in_force)
}

/// Compares the reply of the linear scene with the reply of the rotary scene. The relative tolerance of each number is
/// `part`.
#[track_caller]
fn is_told(at_handle: &str, rotary: &str, part: f64) {
    let (linear_parts, parts) = (at_handle.split(", "), rotary.split(", "));
    assert_eq!(linear_parts.clone().count(), parts.clone().count(), "{at_handle}: {rotary}");
    for (linear, said) in linear_parts.zip(parts) {
        let Some((unit, other, power)) = UNITS.iter().find(|(unit, ..)| linear.ends_with(unit))
        else {
            assert_eq!(linear, said);
            continue;
        };
        let said = said.strip_suffix(other).unwrap_or_else(|| panic!("{linear}: {said}"));
        let words = linear.strip_suffix(unit).unwrap().split(' ');
        assert_eq!(words.clone().count(), said.split(' ').count(), "{linear}: {said}");
        for (word, said) in words.zip(said.split(' ')) {
            match (word.parse::<f64>(), said.parse::<f64>()) {
                (Ok(number), Ok(told)) => {
                    let due = number * RADIUS_M.powi(*power);
                    assert!((told - due).abs() <= part * due.abs(), "{linear}: {said}");
                }
                _ => assert_eq!(word, said, "{linear}"),
            }
        }
    }
}

fn a_rotary_device_hits_as_the_same_one_at_its_handle(board: Board) {
    let (linear, linear_frames, linear_settings) = hit(board, LINEAR);
    let (rotary, frames, settings) = hit(board, ROTARY);
    assert!(
        frames.len() > 1000 && frames.iter().any(|one| one.record.flags.contains(Flags::CONTACT))
    );
    assert!(!settings.is_empty());
    assert_eq!(settings, linear_settings);
    // Texts of different lengths need different times. So the two recordings may begin or end at different outputs.
    let at: BTreeMap<u64, Record> =
        linear_frames.iter().map(|one| (one.record.sample, one.record)).collect();
    let pairs = || {
        let both = |one: &Frame| at.get(&one.record.sample).map(|&other| (one.record, other));
        frames.iter().filter_map(both)
    };
    let (most, paired) = (frames.len().max(at.len()), pairs().count());
    assert!(paired + 2 >= most, "{paired} of {most}");
    let same = pairs().filter(|(one, other)| one == other).count();
    println!("{}: {rotary:?}, {same} of {} records the same", board.name, frames.len());
    assert!(same >= frames.len() / 2, "{same}");
    for (one, other) in pairs() {
        let of = |record: &Record| (record.sample, record.settings, record.fault);
        assert_eq!(of(&one), of(&other));
        let apart = one.position.counts().abs_diff(other.position.counts());
        // If a count is read later, the impact differs by some thousandths of the path.
        assert!(apart <= 10, "{one:?}, at its handle {other:?}");
    }
    let ([linear @ .., refused], [rotary @ .., rotary_refused]) = (&linear[..], &rotary[..]) else {
        panic!("nothing was said")
    };
    assert_eq!(linear.len(), rotary.len());
    for (linear, said) in linear.iter().zip(rotary) {
        // The measured numbers are equal only if the hits are equal.
        let measured = said.starts_with("ok hit ") && same < frames.len();
        is_told(linear, said, if measured { 0.5 } else { 1e-9 });
    }
    assert!(rotary.iter().any(|line| line.starts_with("ok hit stable, rms ")), "{rotary:?}");
    assert_eq!(refused, "error: stiffness_n_per_m is 1000000000, allowed 0 to 10000000");
    assert_eq!(rotary_refused, "error: stiffness_n_m_per_rad is 1000000000, allowed 0 to 49000");
}
