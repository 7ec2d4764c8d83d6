//! Tests how the board checks its image's checksum, at boot and while it runs.

use board_trials::campaign::{
    image_flips::{End, Part},
    run::Ground,
};
use object::{Object as _, ObjectSection as _};
use rayon::prelude::*;
use virtual_board::{
    board::{Board, NUCLEO_F446RE, Powered},
    elf::Elf,
    session::Session,
    world::World,
};
use zwidth::{
    image::{LONGEST, RIGHT, UNSEALED},
    period::PERIODS,
};

use crate::firmware::{Firmware, arm, ok, word};

each_board!(
    everything_that_is_programmed_is_covered,
    an_image_without_its_seal_or_with_another_byte_is_refused,
    a_flip_ends_in_off_and_is_refused_from_then_on,
    no_flip_leaves_a_wrong_force_on
);
each_board!(a_pass_ends_in_time_whatever_the_host_does, ignored: "seconds of a flood at each period");

/// Sector 3, which holds the device record.
const RECORD: u32 = 0x0800_C000;
/// Vector of an interrupt that never comes.
const UNUSED_VECTOR: u32 = 0x0800_0000 + 4 * 60;
/// Longest time of one complete image check, in samples.
const PASS: u64 = 1_000;
/// Number of samples after which a board has booted. `RESET` is the number if the watchdog must reset it first.
const BOOT: u64 = 200;
const RESET: u64 = 1_200;

const REFUSED: &str = "ok status off, fault 46 (image): it is not what was built: flash it again";

fn world_of<'a>(firmware: &'a Firmware, elf: &Elf) -> World<'a> {
    let Firmware { board, table, scene, .. } = firmware;
    let mut world = World::new(*board, elf, table, scene, scene.device.rest_position_m).unwrap();
    world.run(BOOT).unwrap();
    world
}

fn byte_of(elf: &mut Elf, address: u32) -> &mut u8 {
    let mut pieces = elf.flash.iter_mut();
    let found = pieces.find_map(|(from, bytes)| {
        let at = address.checked_sub(*from)? as usize;
        bytes.get_mut(at)
    });
    found.unwrap()
}

fn everything_that_is_programmed_is_covered(board: Board) {
    let firmware = Firmware::of(board);
    let mut elf = firmware.elf.clone();
    let parts = seal::parts(&elf).unwrap();
    assert!(parts.iter().all(|[from, to]| from < to && from % 4 == 0 && to % 4 == 0), "{parts:x?}");
    let seal = elf.address_of(seal::SEAL).unwrap();
    for (from, bytes) in elf.flash.iter().filter(|(from, _)| *from != RECORD) {
        for address in *from..from + bytes.len() as u32 {
            let covered = parts.iter().any(|[from, to]| (*from..*to).contains(&address));
            assert!(covered || (seal..seal + 4).contains(&address), "{address:#x}");
        }
    }
    // The board computes the same checksum as the host.
    let sum = seal::seal_of(&elf).unwrap().1;
    let said = format!("crc {sum:08x}");
    let mut world = world_of(&firmware, &elf);
    world.send("selftest\n").unwrap();
    world.run(RESET).unwrap();
    assert!(world.replies.contains(&format!("selftest image: pass, {said}")), "{}", world.replies);
    // The file has the same checksum. Sealing it again changes nothing.
    let file = object::File::parse(&*elf.bytes).unwrap();
    let (place, _) = file.section_by_name(".text").unwrap().file_range().unwrap();
    drop(file);
    assert_eq!(seal::seal(&mut elf.bytes), Ok(None));
    elf.bytes[place as usize + 8] ^= 1;
    assert!(matches!(seal::seal(&mut elf.bytes), Ok(Some(_))));
    assert_eq!(seal::seal(&mut elf.bytes), Ok(None));
    let changed = Elf::parse(elf.bytes, "the image").unwrap();
    assert_ne!(seal::seal_of(&changed).unwrap().1, sum);
}

/// Checks that the board replies, but obeys no command and gives no output.
fn is_refused(world: &mut World<'_>, status: &str) {
    let (reason, why) = (world.replies.clone(), status.strip_prefix("ok status off, ").unwrap());
    assert_eq!(reason.trim_end(), format!("error: {why}; nothing runs, see help"));
    assert_eq!(world.ask("status").unwrap(), status);
    for line in ["zero", "arm", "clear", "save", "selftest"] {
        let reply = world.ask(line).unwrap();
        assert!(reply.starts_with("error: fault 46 (image): "), "{line}: {reply}");
    }
    world.run(RESET).unwrap();
    assert_eq!(world.powered.mcu.resets(), 0, "the watchdog is fed");
    assert!(!world.powered.amplifier.is_enabled() && world.powered.mcu.hard_faults().is_empty());
}

fn an_image_without_its_seal_or_with_another_byte_is_refused(board: Board) {
    let firmware = Firmware::of(board);
    let seal = firmware.elf.address_of(seal::SEAL).unwrap();
    let mut elf = firmware.elf.clone();
    for n in 0..4 {
        *byte_of(&mut elf, seal + n) = UNSEALED.to_le_bytes()[n as usize];
    }
    let unsealed =
        "ok status off, fault 46 (image): it is not sealed: cargo seal ELF, then flash that";
    is_refused(&mut world_of(&firmware, &elf), unsealed);
    elf.seal().unwrap();
    assert!(ok(&mut world_of(&firmware, &elf), "status").contains("fault none"));
    let [.., [_, constants_end], _] = seal::parts(&elf).unwrap();
    for address in [UNUSED_VECTOR, constants_end - 1, seal, seal + 3] {
        let mut elf = firmware.elf.clone();
        *byte_of(&mut elf, address) ^= 0x10;
        is_refused(&mut world_of(&firmware, &elf), REFUSED);
    }
}

fn flip(world: &mut World<'_>, address: u32) {
    let flipped = world.powered.mcu.peek(address) ^ 1 << 7;
    world.powered.mcu.program(address, &flipped.to_le_bytes());
}

/// Runs until enable is inactive. Returns the number of samples.
fn until_off(world: &mut World<'_>) -> u64 {
    let mut samples = 0;
    while world.powered.amplifier.is_enabled() {
        world.sample().unwrap();
        samples += 1;
        assert!(samples < 30_000, "it stays on");
    }
    samples
}

fn a_flip_ends_in_off_and_is_refused_from_then_on(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.armed();
    let kept = world.snapshot();
    // A bit in the image is flipped in code that the program does not reach. A bit in the record is flipped in a number
    // that was read at boot.
    let (panics, _) = firmware.elf.place_of("rust_begin_unwind").unwrap();
    let seal = firmware.elf.address_of(seal::SEAL).unwrap();
    for address in [UNUSED_VECTOR, panics.next_multiple_of(4), seal, RECORD + 4 * 30] {
        world.restore(&kept);
        flip(&mut world, address);
        let samples = until_off(&mut world);
        assert!(samples <= 2 * PASS, "{address:#x}: {samples}");
        world.replies.clear();
        world.run(RESET).unwrap();
        let said = world.replies.clone();
        assert_eq!(world.powered.mcu.resets(), 1, "{said}");
        let reason = if (RECORD..0x0801_0000).contains(&address) {
            "error: no device record: it is damaged: its checksum is wrong; nothing runs, see help"
        } else {
            "error: fault 46 (image): it is not what was built: flash it again; nothing runs, see help"
        };
        assert!(said.starts_with(reason), "{address:#x}: {said}");
        assert!(world.ask("arm").unwrap().starts_with("error: "));
        // After the bit is restored, the fault is still latched. `clear` ends the fault.
        flip(&mut world, address);
        world.reset();
        world.run(BOOT).unwrap();
        let status = ok(&mut world, "status");
        assert!(status.contains("ok status fault, fault 46 (image)"), "{address:#x}: {status}");
        assert!(world.ask("arm").unwrap().starts_with("error: a fault is latched"));
        ok(&mut world, "clear");
        world.hold(firmware.scene.device.rest_position_m, false);
        arm(&mut world);
    }
}

/// `link` supervises the image check of `idle`. `link` finds a wrong result of the check, and a check that does not
/// end.
#[test]
fn passes_that_are_wrong_or_do_not_end_are_found_without_idle() {
    let firmware = Firmware::of(NUCLEO_F446RE);
    let mut world = firmware.armed();
    let kept = world.snapshot();
    let passes = counter(&firmware, &mut world);
    world.restore(&kept);
    add(&mut world, passes, 5);
    assert!(until_off(&mut world) <= 11);
    // The state of `idle` is restored again and again, so that the check by `idle` does not end.
    world.restore(&kept);
    let (from, size) = firmware.elf.place_of("local_resource_idle").unwrap();
    let mut state = vec![0; size as usize];
    world.powered.mcu.read(from, &mut state);
    let mut samples = 0;
    while world.powered.amplifier.is_enabled() {
        world.powered.mcu.write(from, &state);
        world.run(400).unwrap();
        samples += 400;
        assert!(samples <= u64::from(LONGEST) + 400, "it stays on");
    }
    assert!(samples + 3 * PASS > u64::from(LONGEST), "{samples}");
    world.run(RESET).unwrap();
    let status = ok(&mut world, "status");
    assert!(status.contains("ok status fault, fault 46 (image)"), "{status}");
}

fn add(world: &mut World<'_>, address: u32, much: u32) {
    let more = word(world, address).wrapping_add(much);
    world.powered.mcu.write(address, &more.to_le_bytes());
}

/// Address of the counter of image checks. Several words have a counter's symbol. The counter of image checks is the
/// word that grows by [`RIGHT`] in each check.
fn counter(firmware: &Firmware, world: &mut World<'_>) -> u32 {
    let symbols = firmware.elf.symbols.iter().filter(|(name, ..)| name.contains("task5FLAGS"));
    let words: Vec<u32> = symbols.flat_map(|(_, at, size)| (*at..at + size).step_by(4)).collect();
    let before: Vec<u32> = words.iter().map(|&at| word(world, at)).collect();
    world.run(2 * PASS).unwrap();
    let grown = words.iter().zip(before).find(|&(&at, before)| {
        let grown = word(world, at).wrapping_sub(before);
        (1..=8).any(|passes| grown == RIGHT.wrapping_mul(passes))
    });
    *grown.unwrap().0
}

fn a_pass_ends_in_time_whatever_the_host_does(board: Board) {
    let firmware = Firmware::of(board);
    let passes = counter(&firmware, &mut firmware.boot());
    PERIODS.par_iter().for_each(|&period| {
        let mut world = firmware.boot();
        for line in ["zero", "unlock envelope", &format!("period {period}"), "arm"] {
            ok(&mut world, line);
        }
        world.run(4_000).unwrap();
        let kept = world.snapshot();
        for flood in ["", "get\n", "k 1e9\n", "status\nhelp\nget\nrubbish\n\n"] {
            world.restore(&kept);
            let (mut ended, mut longest, mut seen) = (None, 0, word(&world, passes));
            let mut rest = flood.as_bytes();
            for n in 0..12_000_u64 {
                let Powered { mcu, rtt, .. } = &mut world.powered;
                while !flood.is_empty() {
                    let sent = rtt.write(mcu, 0, rest);
                    rest = &rest[sent..];
                    if sent == 0 {
                        break;
                    }
                    rest = if rest.is_empty() { flood.as_bytes() } else { rest };
                }
                world.sample().unwrap();
                if n.is_multiple_of(20) {
                    world.probe().unwrap();
                }
                let now = word(&world, passes);
                if now != seen {
                    assert_eq!(now, seen.wrapping_add(RIGHT));
                    longest = longest.max(ended.map_or(0, |ended| n - ended));
                    (ended, seen) = (Some(n), now);
                }
            }
            let what = format!("{} period {period}, {flood:?}", board.name);
            println!("{what}: a pass within {:.1} ms", longest as f64 / 10.0);
            assert!(world.powered.amplifier.is_enabled(), "{what}");
            assert!(longest > 0 && longest <= PASS, "{what}: {longest}");
        }
    });
}

/// Some flips of `cargo board campaign --image`.
fn no_flip_leaves_a_wrong_force_on(board: Board) {
    let Firmware { elf, table, .. } = Firmware::of(board);
    let scene = host_sim::scene::NamedScene::load(board.name).unwrap();
    let session = Session { board, scene, elf, table };
    let ground = Ground::new(&session, &[]).unwrap();
    let flips = ground.image_flips((1, 0), 40, 2).unwrap();
    for flip in &flips {
        assert!(!flip.end.is_bad() && !flip.verdict.on_in_fault, "{}: {:?}", flip.what, flip.end);
    }
    let harmless = flips.iter().filter(|flip| flip.end == End::Harmless).count();
    assert!(harmless > 20 && flips.iter().any(|flip| flip.part == Part::Code), "{harmless}");
}
