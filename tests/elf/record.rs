//! Device records: an image accepts every valid record. With a wrong record the force stays off.

use std::{
    fs,
    path::Path,
    sync::atomic::{AtomicBool, AtomicUsize, Ordering},
};

use host_sim::{
    engine::Engine,
    scene::{
        NamedScene, Scene,
        record::{board_facts, words},
    },
    simulation::prepared::{Numeric, PreparedScene, WallHit},
    study::{
        How,
        board_envelope::{Found, Part, board_envelope, first_settings},
    },
};
use rayon::prelude::*;
use virtual_board::{
    board::{BOARDS, Board, DISCOVERY_F407, NUCLEO_F446RE},
    device::{built_in, record},
    elf::Elf,
    image,
    session::Session,
    world::World,
};
use zwidth::{
    device::{Device, record::WORDS_MAX},
    experiment::Verdict,
    store::{DeviceKey, RECORD_WORDS, Stored},
};

use crate::firmware::{Firmware, ok};

each_board!(
    an_image_stays_off_with_a_wrong_record_and_names_what_is_wrong,
    settings_of_another_record_are_not_taken
);
each_board!(
    a_record_with_a_wrong_byte_or_a_missing_word_is_refused,
    ignored: "many boots; CI runs it"
);
each_board!(
    every_byte_and_every_cut_of_a_record_is_refused,
    ignored: "thousands of boots; .ci/long runs it"
);

fn bytes_of(firmware: &Firmware) -> Vec<u8> {
    let (_, bytes) =
        firmware.elf.flash.iter().find(|(address, _)| *address == 0x0800_C000).unwrap();
    bytes.clone()
}

/// Boots with this record and runs some samples. Returns the board's first message. Then all commands but three are
/// refused.
///
/// A board with a refused record polls its link and does not sleep. So the emulation is twenty times slower.
fn refused(firmware: &Firmware, record: &[u8], samples: u64) -> String {
    let elf = firmware.elf.with_record(record).unwrap();
    let Firmware { board, table, scene, .. } = firmware;
    let mut world = World::new(*board, &elf, table, scene, scene.device.rest_position_m).unwrap();
    world.run(100).unwrap();
    let said = world.replies.lines().next().unwrap_or_default().to_owned();
    let why = said.strip_prefix("error: no device record: ").expect(&said);
    let why = why.strip_suffix("; nothing runs, see help").unwrap().to_owned();
    for line in ["zero", "unlock envelope", "arm", "hit", "save"] {
        let reply = world.ask(line).unwrap();
        assert!(reply.starts_with("error: no device record"), "{line}: {reply}");
    }
    assert_eq!(ok(&mut world, "help"), "ok help, version, status");
    assert_eq!(ok(&mut world, "status"), format!("ok status off, no device record: {why}"));
    assert!(ok(&mut world, "version").contains(&why));
    world.run(samples).unwrap();
    assert!(!world.powered.amplifier.is_enabled());
    assert!(!world.powered.mcu.pin(board.wiring.enable));
    assert_eq!(world.powered.amplifier.command(), 0);
    assert_eq!((world.powered.mcu.resets(), world.telemetry.len()), (0, 0));
    why
}

/// A record with a right checksum, as the host's own encoder writes it.
fn signed(board: Board, edit: impl Fn(&mut Device<'static>)) -> Vec<u8> {
    let mut device = *built_in(board);
    edit(&mut device);
    let mut sector = [0; WORDS_MAX];
    let words = device.to_record(&[], &[], &mut sector).unwrap();
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn an_image_stays_off_with_a_wrong_record_and_names_what_is_wrong(board: Board) {
    let firmware = &Firmware::of(board);
    let whole = bytes_of(firmware);
    let mut later = whole.clone();
    later[3] += 1;
    let mut foreign = whole.clone();
    foreign[0] = b'x';
    let mut damaged = whole.clone();
    damaged[100] ^= 1;
    let other = BOARDS.into_iter().find(|other| *other != board).unwrap();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let others = fs::read(scenes.join(format!("{}.device", other.name))).unwrap();
    for (record, why) in [
        (vec![], "there is none"),
        (foreign, "what is in its place is none"),
        (later, "its layout is 5, this firmware takes 4"),
        (whole[..whole.len() - 4].to_vec(), "it is damaged: its checksum is wrong"),
        (damaged, "it is damaged: its checksum is wrong"),
        (others, &format!("it is for the board {}", other.name)),
        (
            signed(board, |device| device.safety.ramp_in_s = 0.0),
            "ramp_in_s is 0, allowed 0.02 to 10",
        ),
        (
            signed(board, |device| device.duty.continuous_force_n = 6.0),
            "duty_continuous_force_n is 6, allowed 0.304809871324 to 5.906",
        ),
        (
            signed(board, |device| device.design.rate_hz = 5000.0),
            "rate_hz is 5000, allowed 10000 to 10000",
        ),
    ] {
        // One run is longer than the watchdog's time.
        let samples = if record.is_empty() { 1_000 } else { 20 };
        assert_eq!(refused(firmware, &record, samples), why);
    }
}

/// Tests one byte of every 128. The library's tests check each byte.
fn a_record_with_a_wrong_byte_or_a_missing_word_is_refused(board: Board) {
    wrong_bytes_and_cuts(board, 128);
}

fn every_byte_and_every_cut_of_a_record_is_refused(board: Board) {
    wrong_bytes_and_cuts(board, 1);
}

/// Divides the record into groups of `stride` bytes. For each group, flips a bit of one byte, and also cuts the record
/// off at the group's first byte.
fn wrong_bytes_and_cuts(board: Board, stride: usize) {
    let firmware = &Firmware::of(board);
    let whole = &bytes_of(firmware);
    let cuts = AtomicUsize::new(0);
    (0..whole.len()).into_par_iter().step_by(stride).for_each(|byte| {
        let mut bad = whole.clone();
        let of_stride = byte / stride % stride;
        bad[(byte + of_stride).min(whole.len() - 1)] ^= 1 << (byte / stride % 8);
        refused(firmware, &bad, 20);
        // The power was cut while the record was programmed, so the rest is erased.
        if byte.is_multiple_of(4) {
            refused(firmware, &whole[..byte], 20);
            cuts.fetch_add(1, Ordering::Relaxed);
        }
    });
    let bytes = whole.len().div_ceil(stride);
    println!("{}: {bytes} wrong bytes and {} cuts", board.name, cuts.into_inner());
}

/// A record that is made from an example is built into the image. The image is then for this device. A record of
/// another board is refused.
#[test]
#[ignore = "an image more; CI runs it"]
fn an_image_is_built_for_the_record_that_is_named() {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/known.toml");
    let named = NamedScene::load(example.to_str().unwrap()).unwrap();
    let facts = board_facts(NUCLEO_F446RE.name).unwrap();
    // as in `cargo sim prepare`
    let first = first_settings(&named.scene, None).unwrap();
    let parts = Part::all(&named.scene, &first).unwrap();
    let stop = AtomicBool::new(false);
    let found = board_envelope(
        How { engine: Engine::lanes(), numeric: Numeric::Fixed, stop: &stop },
        parts,
        || (),
    )
    .unwrap();
    let prepared = named.prepared(&facts, first).unwrap();
    let boundaries: Vec<_> = found.iter().flat_map(Found::boundaries).collect();
    let bytes = prepared.record(&boundaries, &facts).unwrap();
    let record = Path::new(env!("CARGO_TARGET_TMPDIR")).join("known.device");
    fs::write(&record, &bytes).unwrap();

    let path = image::build_with_record(NUCLEO_F446RE.name, &record).unwrap();
    let mut firmware = Firmware::of(NUCLEO_F446RE);
    firmware.elf = Elf::load(&path).unwrap();
    firmware.table = virtual_board::log::table(&firmware.elf.bytes).unwrap();
    firmware.scene = named.scene.clone();
    let version = ok(&mut firmware.boot(), "version");
    let in_record = words(&bytes);
    let device = Device::from_record(&in_record, &facts).unwrap();
    let (scene, envelope) = (device.scene_hash, device.envelope.hash());
    for part in [format!("scene known {scene:08x}"), format!("envelope {envelope:08x}")] {
        assert!(version.contains(&part), "{part}: {version}");
    }
    assert!(
        device.envelope.boundaries().count() > 1 && bytes == bytes_of(&firmware)[..bytes.len()]
    );

    let other = image::build_with_record(DISCOVERY_F407.name, &record).unwrap_err();
    let lines: Vec<&str> = other.lines().filter(|line| line.starts_with("error: zwidth")).collect();
    let [line] = lines[..] else { panic!("{other}") };
    let wanted =
        "known.device is the record of a device on nucleo-f446re, this image is for discovery-f407";
    assert!(line.contains("ZWIDTH_DEVICE: ") && line.contains(wanted), "{other}");
}

/// Stored settings are valid only with the record that they were stored with. Its contents count, not its name.
fn settings_of_another_record_are_not_taken(board: Board) {
    let firmware = &Firmware::of(board);
    let own = built_in(board).defaults();
    let load = |key: DeviceKey| {
        let stored = Stored { device: key, push_n: 1.5, ..own };
        let words: [u32; RECORD_WORDS] = stored.to_words(1);
        let mut elf = firmware.elf.clone();
        let bytes = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        elf.flash.push((0x0800_4000, bytes));
        let Firmware { board, table, scene, .. } = firmware;
        let mut world =
            World::new(*board, &elf, table, scene, scene.device.rest_position_m).unwrap();
        world.run(200).unwrap();
        let loaded = world.replies.lines().find(|line| line.contains("load")).unwrap().to_owned();
        (loaded, ok(&mut world, "get").contains("push 1.5 N"))
    };
    assert_eq!(load(own.device), ("ok load: newest settings".into(), true));
    for key in [
        DeviceKey { hash: own.device.hash ^ 1, ..own.device },
        DeviceKey { hash: 0, ..own.device },
        DeviceKey { name: DeviceKey::of("another").name, ..own.device },
    ] {
        let other = "ok load: defaults: what was saved is for another device";
        assert_eq!(load(key), (other.into(), false));
    }
}

/// Five devices that differ in mass, length of a count, force, start and wall.
fn devices() -> [NamedScene; 5] {
    let of = |name: &str, mass_kg: f64, count_m: f64, gain_n_per_v: f64, wall_m: f64| {
        let mut named = NamedScene::load(NUCLEO_F446RE.name).unwrap();
        named.name = name.into();
        let scene = &mut named.scene;
        scene.device.mass_kg = mass_kg;
        scene.encoder.resolution_m = count_m;
        scene.actuator.gain_n_per_v = gain_n_per_v;
        scene.wall.position_m = wall_m;
        scene.device.rest_position_m = 0.5 * wall_m;
        scene.wall_hit.push_n = zwidth::shorten(0.4 * scene.full_scale_n());
        scene.wall_hit.settle_s = 1.0;
        scene.wall_hit.window_s = 0.5;
        (scene.safety, scene.motor, scene.back) = (None, None, None);
        scene.check().unwrap();
        named
    };
    [
        of("own", 0.416, 1e-6, 0.5906, 0.07),
        of("light", 0.1, 1e-6, 0.3, 0.03),
        of("coarse", 0.416, 8e-6, 0.5906, 0.05),
        of("strong", 2.0, 2e-6, 4.0, 0.04),
        of("fine", 0.6, 2.5e-7, 0.8, 0.02),
    ]
}

/// K and B of a wall. Relative to the device's full force and count, they are the same for each device.
fn as_stiff(scene: &Scene) -> [f64; 2] {
    let unit = scene.full_scale_n() / scene.encoder.resolution_m;
    [(2e-3 * unit).round(), (8e-6 * unit).round()]
}

/// Compares hits of the simulator and of the board. They differ only in their start time, so RMS and mean must agree.
fn hits_are_the_simulators(board: Board, devices: &[(NamedScene, [f64; 3])]) {
    let Firmware { board, elf, .. } = Firmware::of(board);
    let facts = board_facts(board.name).unwrap();
    devices.par_iter().cloned().for_each(|(scene, wall)| {
        let record = record(&scene, board).unwrap();
        if let Some(record) = &record {
            let words = words(record);
            let device = Device::from_record(&words, &facts).unwrap();
            assert_eq!(device.key.name.text(), scene.name);
        }
        let table = virtual_board::log::table(&elf.bytes).unwrap();
        let elf = record.map_or_else(|| elf.clone(), |record| elf.with_record(&record).unwrap());
        let session = Session { board, scene, elf, table };
        let scene = &session.scene.scene;
        let (board_hit, mut world) = session.hit(wall).unwrap();
        let version = ok(&mut world, "version");
        assert!(version.contains(&format!("scene {} ", session.scene.name)), "{version}");
        let prepared = PreparedScene::new(scene).unwrap();
        let [cutoff_hz, stiffness_n_per_m, damping_n_s_per_m] = wall;
        let velocity = scene.velocity.at(cutoff_hz);
        let hit =
            WallHit { velocity, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts: 0.0 };
        let simulated = prepared.report(Numeric::Fixed, &hit).unwrap();
        let counts = |metres: f64| metres / scene.encoder.resolution_m;
        let [mean, rms] = [board_hit.mean_m - simulated.mean_m, board_hit.rms_m - simulated.rms_m];
        println!(
            "{}: {:?}, mean {:.1} counts behind the surface ({:+.2}), RMS {:.2} counts ({:+.2})",
            session.scene.name,
            board_hit.verdict,
            counts(board_hit.mean_m - scene.wall.position_m),
            counts(mean),
            counts(board_hit.rms_m),
            counts(rms),
        );
        assert_eq!((board_hit.verdict, simulated.verdict), (Verdict::Stable, Verdict::Stable));
        // The position where friction holds the handle depends on the start time.
        let near = if scene.friction.is_some() { 3.0 } else { 1.0 };
        assert!(counts(mean).abs() < near && counts(rms).abs() < 1.0);
    });
}

/// Each device, with the position, K and B of its wall.
fn walls(devices: &[NamedScene]) -> Vec<(NamedScene, [f64; 3])> {
    let of = |named: &NamedScene| {
        let [k, b] = as_stiff(&named.scene);
        (named.clone(), [1500.0, k, b])
    };
    devices.iter().map(of).collect()
}

#[test]
fn one_image_takes_records_and_hits_as_the_simulator_says() {
    hits_are_the_simulators(NUCLEO_F446RE, &walls(&devices()[..2]));
}

#[test]
#[ignore = "three devices more; CI runs it"]
fn one_image_takes_five_records() {
    hits_are_the_simulators(NUCLEO_F446RE, &walls(&devices()[2..]));
}

/// The walls are those of `host-sim/tests/program/ready.rs`, in the scene's units.
#[test]
#[ignore = "two images; CI runs it"]
fn ready_devices_hit_as_the_simulator_says() {
    for board in BOARDS {
        let ready = [
            ("epfl-paddle", [500.0, 20.0, 0.1]),
            ("rice-paddle", [500.0, 20.0, 0.1]),
            ("hapkit", [500.0, 10.0, 0.05]),
            ("smartknob", [500.0, 0.2, 0.001]),
        ];
        let scenes = ready.into_iter().filter_map(|(name, [cutoff_hz, k, b])| {
            let named = NamedScene::load(name).unwrap();
            let units = named.scene.units;
            let wall = [cutoff_hz, units.stiffness_n_per_m(k), units.damping_n_s_per_m(b)];
            let is_its = named.scene.board.as_ref().unwrap().name == board.name;
            is_its.then_some((named, wall))
        });
        hits_are_the_simulators(board, &scenes.collect::<Vec<_>>());
    }
}
