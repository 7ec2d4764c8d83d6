//! Settings in flash: bytes that flip, power that is cut while the ELF saves.

use rayon::prelude::*;
use virtual_board::{board::Powered, device::built_in, world::World};
use zwidth::{
    Settings, VelocitySettings, WallSettings,
    experiment::WalkSettings,
    store::{RECORD_WORDS, Signs, Stored},
};

use crate::firmware::{Firmware, ok};

/// Sectors 1 and 2, 16 KiB each.
const SECTOR_A: u32 = 0x0800_4000;
const SECTOR_B: u32 = 0x0800_8000;
const SECTOR_WORDS: usize = 4096;

/// A record of that board's device with that stiffness.
fn record(firmware: &Firmware, sequence: u32, stiffness_n_per_m: f64) -> [u32; RECORD_WORDS] {
    let stored = Stored {
        device: built_in(firmware.board).key,
        settings: Settings {
            velocity: VelocitySettings::Butterworth { cutoff_hz: 1200.0 },
            wall: WallSettings {
                position_m: 0.003,
                stiffness_n_per_m,
                damping_n_s_per_m: 5.0,
                push_only: true,
            },
        },
        period: 10,
        push_n: 1.5,
        signs: Signs::default(),
        start_m: 0.0,
        settle_s: 4.0,
        window_s: 2.0,
        rms_limit_m: 1.5e-5,
        full_scale_n: 5.906,
        grid: WalkSettings {
            stiffness_start_n_per_m: 2000.0,
            stiffness_step_n_per_m: 2000.0,
            stiffness_max_n_per_m: 1e5,
            damping_start_n_s_per_m: 10.0,
            damping_step_n_s_per_m: 10.0,
            damping_max_n_s_per_m: 1000.0,
        },
    };
    stored.to_words(sequence)
}

/// Boots with those words in the settings sectors; what `load` said and the stiffness in force.
/// The output is off and there is no fault.
fn boot(firmware: &Firmware, pieces: &[(u32, &[u32])]) -> (String, String) {
    boot_to(firmware, pieces, "ok status off, fault none")
}

/// The same with the status to which it comes.
fn boot_to(firmware: &Firmware, pieces: &[(u32, &[u32])], expected: &str) -> (String, String) {
    let mut elf = firmware.elf.clone();
    for (address, words) in pieces {
        elf.flash.push((*address, words.iter().flat_map(|word| word.to_le_bytes()).collect()));
    }
    let rest_m = firmware.scene.device.rest_position_m;
    let mut world =
        World::new(firmware.board, &elf, &firmware.table, &firmware.scene, rest_m).unwrap();
    world.run(60).unwrap();
    let loaded = world.replies.lines().find(|line| line.contains("load")).unwrap().to_owned();
    let stiffness = stiffness(&mut world);
    let status = ok(&mut world, "status");
    assert!(status.contains(expected), "{status}");
    assert!(!world.powered.amplifier.is_enabled());
    assert_eq!(world.powered.amplifier.changes().disabled_at, None);
    (loaded, stiffness)
}

fn stiffness(world: &mut World<'_>) -> String {
    let get = ok(world, "get");
    get.strip_prefix("ok get ").unwrap().split(',').next().unwrap().to_owned()
}

/// A whole record with a number that is not allowed: the defaults, and the fault that says so.
pub fn take_what_is_not_allowed(firmware: &Firmware) {
    let words = record(firmware, 1, -1.0);
    let status = "ok status fault, fault 40 (settings)";
    let (loaded, stiffness) = boot_to(firmware, &[(SECTOR_A, &words)], status);
    assert_eq!(loaded, "ok load: defaults: this firmware cannot take what was saved");
    assert_eq!(stiffness, "k 0 N/m");
}

/// Each byte of the newest of two records, every bit of it turned, or of the only one.
pub fn flip_every_byte(firmware: &Firmware, step: usize) -> usize {
    let (older, newest) = (record(firmware, 1, 1000.0), record(firmware, 2, 2000.0));
    let both = |newest: &[u32]| {
        let words: Vec<u32> = older.iter().chain(newest).copied().collect();
        boot(firmware, &[(SECTOR_A, &words)])
    };
    assert_eq!(both(&newest), ("ok load: newest settings".into(), "k 2000 N/m".into()));
    let bytes: Vec<usize> = (0..4 * RECORD_WORDS).step_by(step).collect();
    bytes.par_iter().for_each(|byte| {
        let mut bad = newest;
        bad[byte / 4] ^= 0xFF << (8 * (byte % 4));
        let (loaded, stiffness) = both(&bad);
        assert!(loaded.starts_with("ok load: older settings"), "byte {byte}: {loaded}");
        assert_eq!(stiffness, "k 1000 N/m", "byte {byte}");
        if byte % 8 == 0 {
            let (loaded, stiffness) = boot(firmware, &[(SECTOR_A, &bad)]);
            assert!(loaded.starts_with("ok load: defaults"), "byte {byte}: {loaded}");
            assert_eq!(stiffness, "k 0 N/m", "byte {byte}");
        }
    });
    bytes.len()
}

/// The ELF saves, and the power goes before, in and after each word that it writes.
pub fn cut_every_word(firmware: &Firmware, step: usize) -> usize {
    let older = record(firmware, 1, 1000.0);
    let states = save(firmware, &older);
    assert_eq!(states.len(), RECORD_WORDS + 1, "one state more than words");
    let newest = *states.last().unwrap();
    let mut cuts: Vec<(usize, [u32; RECORD_WORDS])> = Vec::new();
    for (n, state) in states.iter().enumerate().step_by(step) {
        cuts.push((n, *state));
        if n < RECORD_WORDS {
            // The word that was being programmed: some of its bits are 0 already.
            for bits in [0xFFFF_0000, 0x0F0F_5A5A] {
                let mut half = *state;
                half[n] &= newest[n] | bits;
                cuts.push((n, half));
            }
        }
    }
    cuts.par_iter().for_each(|(n, state)| {
        let words: Vec<u32> = older.iter().chain(state).copied().collect();
        let (loaded, stiffness) = boot(firmware, &[(SECTOR_A, &words)]);
        if state == &newest {
            assert_eq!((&*loaded, &*stiffness), ("ok load: newest settings", "k 2500 N/m"));
        } else {
            assert_eq!(stiffness, "k 1000 N/m", "cut at word {n}: {loaded}");
        }
    });
    cuts.len()
}

/// Lets the ELF save; the words of the record's place before, between and after all stores.
fn save(firmware: &Firmware, older: &[u32; RECORD_WORDS]) -> Vec<[u32; RECORD_WORDS]> {
    let mut elf = firmware.elf.clone();
    elf.flash.push((SECTOR_A, older.iter().flat_map(|word| word.to_le_bytes()).collect()));
    let rest_m = firmware.scene.device.rest_position_m;
    let mut world =
        World::new(firmware.board, &elf, &firmware.table, &firmware.scene, rest_m).unwrap();
    world.run(60).unwrap();
    ok(&mut world, "unlock envelope");
    ok(&mut world, "k 2500");
    world.send("save\n").unwrap();
    let Powered { mcu, .. } = &mut world.powered;
    let place = (SECTOR_A - 0x0800_0000) as usize + 4 * RECORD_WORDS;
    let look = |mcu: &virtual_board::mcu::Mcu| {
        let flash = mcu.flash();
        let words = flash[place..place + 4 * RECORD_WORDS].as_chunks::<4>().0;
        std::array::from_fn(|n| u32::from_le_bytes(words[n]))
    };
    let mut states: Vec<[u32; RECORD_WORDS]> = vec![look(mcu)];
    let limit = mcu.now() + mcu.core_hz() / 20;
    while states.len() <= RECORD_WORDS && mcu.now() < limit {
        mcu.run_until(mcu.now() + 1000).unwrap();
        let state = look(mcu);
        if states.last() != Some(&state) {
            states.push(state);
        }
    }
    states
}

/// The next record goes to the other sector, which is erased for it: what a cut leaves there is
/// worth nothing, and the newest record is not in it.
pub fn cut_an_erase(firmware: &Firmware) -> usize {
    let records = (SECTOR_WORDS / RECORD_WORDS) as u32;
    let full: Vec<u32> = (0..records)
        .flat_map(|n| record(firmware, 200 + n, if n + 1 < records { 700.0 } else { 1000.0 }))
        .collect();
    let old: Vec<u32> = (0..records).flat_map(|n| record(firmware, 1 + n, 500.0)).collect();
    let cuts: [fn(usize, u32) -> u32; 4] = [
        |_, word| word,
        |n, word| if n < 2000 { u32::MAX } else { word },
        |n, word| word | (0x9E37_79B9u32.wrapping_mul(n as u32)),
        |_, _| u32::MAX,
    ];
    for cut in &cuts {
        let rest: Vec<u32> = old.iter().enumerate().map(|(n, &word)| cut(n, word)).collect();
        let (loaded, stiffness) = boot(firmware, &[(SECTOR_A, &full), (SECTOR_B, &rest)]);
        assert_eq!(stiffness, "k 1000 N/m", "{loaded}");
    }
    cuts.len()
}
