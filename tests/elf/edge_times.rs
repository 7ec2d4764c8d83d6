//! Tests the estimator `time-stamps` on the board that captures the encoder's edges. The velocities must equal the
//! core's bit for bit. Further tests check the edge of each count, the error at slow speed, and the cycles.

use host_sim::{
    scene::NamedScene,
    simulation::prepared::{Numeric, PreparedScene, WallHit},
};
use virtual_board::{
    board::{Board, DISCOVERY_F407, NUCLEO_F446RE},
    mcu::SAMPLE,
    session::Session,
    world::World,
};
use zwidth::{
    LoopParameters, Sampled, Settings, VelocitySettings, WallSettings,
    experiment::Verdict,
    telemetry::{Decoder, Record},
    velocity::{EstimatorName, Senses},
};

use crate::{
    edges,
    figure::figure,
    firmware::{Firmware, Replay, ok},
};

each_board!(an_image_without_the_estimator_does_not_know_it);

/// The board that captures edges.
const NUCLEO: Board = NUCLEO_F446RE;
/// A speed of one count per sample, converted to m/s for this scene.
const PER_SAMPLE_M_PER_S: f64 = 1e-6 * 1e4;
const SPAN: u32 = 8;
/// Number of simulated hits. `AWAY` is the distance between the first and the last start, in counts. A return move ends
/// within 50 counts of the start.
const STARTS: u8 = 200;
const AWAY: f64 = 100.0;

fn settings(velocity: VelocitySettings) -> Settings {
    let wall = WallSettings {
        position_m: 0.07,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        push_only: true,
    };
    Settings { velocity, wall }
}

/// A booted board with the estimator `time-stamps`, whose handle is moved by hand. Returns also the settings in the
/// order in which they took effect.
fn chosen(firmware: &Firmware) -> (World<'_>, Vec<LoopParameters>) {
    let mut world = firmware.boot_with_edge_times();
    world.lead(0.0);
    ok(&mut world, "estimator time-stamps");
    ok(&mut world, &format!("tuning {SPAN}"));
    let design =
        zwidth::Design { output: zwidth::Output::Dac { bits: 12 }, ..firmware.scene.design() };
    // The firmware's first settings count as a change.
    let first = firmware.first();
    let stamps = VelocitySettings::TimeStamps { span_samples: SPAN };
    let default = EstimatorName::TimeStamps.defaults();
    let taken = [first, first, default, stamps].map(|v| settings(v).build(&design).unwrap());
    (world, taken.to_vec())
}

fn records(world: &mut World<'_>) -> Vec<Record> {
    let mut decoder = Decoder::new();
    let telemetry = std::mem::take(&mut world.telemetry);
    let frames = telemetry.into_iter().filter_map(|byte| decoder.push(byte));
    let records = frames.map(|frame| frame.record).collect();
    assert_eq!((decoder.dropped, decoder.garbage), (0, 0));
    records
}

/// Speeds in counts per sample, each with its number of samples.
const MOTION: [(f64, u32); 24] = [
    (0.017, 400), // about 60 samples per count
    (0.31, 200),
    (-0.31, 150),
    (0.0, 150),
    (0.9, 100),
    (-0.02, 250),
    (1.7, 150),
    (-3.3, 150),
    (12.6, 150),
    (0.0, 40),
    (37.7, 150),
    (-61.3, 150),
    (119.9, 150), // one edge per 75 ticks: often between the readings of a sample
    (-211.7, 200),
    (83.1, 150),
    (2.3, 100),
    (0.6, 100),
    (-0.2, 200),
    (0.11, 250),
    (1.0, 100),
    (-1.0, 100),
    (0.05, 300),
    (7.77, 100),
    (0.0, 200),
];

#[test]
#[ignore = "an image of its own; CI runs it"]
fn velocities_are_the_cores_fed_with_the_edges_as_they_are_bit_for_bit() {
    let firmware = Firmware::variant(NUCLEO, &["time-stamps"]);
    bit_for_bit(&firmware, false);
    bit_for_bit(&firmware, true);
}

/// Compares the velocities bit for bit during the whole motion. With `turned` the encoder's sign is changed, so the
/// encoder counts in the opposite direction.
fn bit_for_bit(firmware: &Firmware, turned: bool) {
    let (mut world, taken) = chosen(firmware);
    if turned {
        ok(&mut world, "encoder -");
    }
    world.powered.mcu.watch_mut().clear();
    let mut samples = 0;
    for (speed, length) in MOTION {
        world.lead(speed * PER_SAMPLE_M_PER_S);
        for n in 0..length {
            world.sample().unwrap();
            if n % 50 == 49 {
                world.probe().unwrap();
            }
            // Log lines and replies are sent all the time.
            if n % 50 == 20 {
                world.send(["status\n", "get\n", "help\n"][n as usize / 50 % 3]).unwrap();
            }
        }
        samples += length;
    }
    // The handle first reverses at an edge, and then swings over thousands of counts.
    for n in 0..1_200u32 {
        let phase = f64::from(n) * 0.037;
        let amplitude = if n < 600 { 0.05 } else { 90.0 };
        world.lead(amplitude * phase.cos() * PER_SAMPLE_M_PER_S);
        world.sample().unwrap();
        if n % 50 == 49 {
            world.probe().unwrap();
        }
        samples += 1;
    }
    world.lead(0.0);
    world.run(20).unwrap();

    let watch = world.powered.mcu.watch();
    let sample = watch.tasks[&SAMPLE];
    if !turned {
        for (key, value) in [
            ("sample_least", sample.least),
            ("sample_most", sample.most),
            ("delay_least", *watch.delays.keys().next().unwrap()),
            ("delay_most", *watch.delays.keys().last().unwrap()),
        ] {
            figure(&format!("elf/edge_times/{key}"), value);
        }
    }
    println!("sample {}..{} cycles, delays {:?}", sample.least, sample.most, watch.delays);
    assert!(sample.most <= NUCLEO.cycles_per_sample() / 4, "{sample:?}");
    assert!(watch.delay_spread() <= 64, "{:?}", watch.delays);
    assert_eq!((watch.primask, watch.forbidden_basepri), (0, 0));
    let notes = world.powered.mcu.take_edge_notes();
    let (ages, near) = edges::latest(NUCLEO, &notes, 16, turned);
    let readings = world.powered.mcu.counter_readings();
    let [first, readings @ ..] = &readings[..] else { panic!("no counts") };
    let records = records(&mut world);
    let mut replay = Replay::new(*first, &taken);
    let mut records = records.iter().peekable();
    let skipped = records.peek().unwrap().sample;
    let mut compared = 0;
    for ((n, &reading), edge) in (0u64..).zip(readings).zip(&ages) {
        let senses = Senses { edge: *edge, ..Senses::NONE };
        let (_, Sampled { motion, due }) =
            replay.sample(n, reading, records.peek().copied(), &senses);
        if !due || n < skipped {
            continue;
        }
        let Some(record) = records.next() else { break };
        assert_eq!((record.sample, record.position), (n, motion.position));
        assert_eq!(record.velocity, motion.velocity, "{n}: {edge:?}");
        compared += 1;
    }
    println!("{samples} samples, {compared} velocities equal, {near} edges near a reading");
    assert!(samples >= 4_000 && compared >= 400, "{samples} {compared}");
    assert!(near > 100, "{near}");
}

/// Largest shift of a sample's time, in core cycles. `TICK` is a tick of the capturing timer.
const JITTER: f64 = 8.0;
const TICK: f64 = 2.0;

/// The error that docs/estimators.md allows at this speed.
fn allowed(speed: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "18000")]
    let age = (JITTER + TICK) / NUCLEO.cycles_per_sample() as f64 + 1.0 / 65_536.0;
    let per_age = speed * speed.max(1.0 / (f64::from(SPAN) - 0.5));
    per_age * age + 1.0 / 131_072.0
}

#[test]
#[ignore = "an image of its own; CI runs it"]
fn a_slow_handle_has_its_speed_where_the_finite_difference_has_nothing() {
    let firmware = Firmware::variant(NUCLEO, &["time-stamps"]);
    let (mut world, _) = chosen(&firmware);
    for (speed, settle, length) in [(0.05, 60, 800), (0.7, 30, 800), (-0.347, 30, 500)] {
        world.lead(speed * PER_SAMPLE_M_PER_S);
        world.run(settle).unwrap();
        world.telemetry.clear();
        let before = world.powered.mcu.counter_readings().len();
        world.run(length).unwrap();
        let readings = world.powered.mcu.counter_readings();
        let found = records(&mut world);
        let mut worst: f64 = 0.0;
        for record in &found {
            worst = worst.max((f64::from(record.velocity.bits()) / 65_536.0 - speed).abs());
        }
        let differences = readings[before - 1..].windows(2);
        let differences = differences.map(|pair| pair[1].wrapping_sub(pair[0]).cast_signed());
        let rough = differences.map(|d| (f64::from(d) - speed).abs()).fold(0.0, f64::max);
        let limit = allowed(speed.abs());
        println!("{speed}: off by {worst:.2e} of {limit:.2e}, the finite difference by {rough:.2}");
        for (key, value) in [("off", worst), ("stated", limit), ("difference", rough)] {
            figure(&format!("elf/edge_times/speed_{speed}/{key}"), value);
        }
        assert!(found.len() as u64 >= length / 10 - 1, "{}", found.len());
        assert!(worst <= limit, "{worst} {limit}");
        assert!(rough > 0.6 && rough > 1_000.0 * limit, "{rough}");
    }
}

fn an_image_without_the_estimator_does_not_know_it(board: Board) {
    let unknown = Firmware::of(board).boot().ask("estimator time-stamps").unwrap();
    println!("{unknown}");
    assert!(unknown.starts_with("error") && !unknown.contains("time-stamps"), "{unknown}");
}

#[test]
#[ignore = "an image of its own; CI runs it"]
fn a_board_without_edge_times_says_so() {
    let firmware = Firmware::variant(DISCOVERY_F407, &["time-stamps"]);
    let sense = firmware.boot().ask("estimator time-stamps").unwrap();
    println!("{sense}");
    assert!(sense.starts_with("error") && sense.contains("needs edge times"), "{sense}");
}

/// In closed loop with the velocity from edges, hits end as in the simulator. The simulator takes its edges directly
/// from the motion.
#[test]
#[ignore = "an image of its own; CI runs it"]
fn hits_end_as_in_the_simulator() {
    let Firmware { board, elf, table, .. } = Firmware::variant(NUCLEO, &["time-stamps"]);
    let mut text = NamedScene::load(board.name).unwrap().text;
    for (from, to) in [
        (
            "estimator = \"butterworth\"\nprewarp = false",
            "estimator = \"time-stamps\"\nspan_samples = 8",
        ),
        ("settle_s = 4.0", "settle_s = 0.8"),
        ("window_s = 2.0", "window_s = 0.3"),
        ("start_position_m = 0.0", "start_position_m = 0.06"),
    ] {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let scene = NamedScene::parse("stamps".to_owned(), text, "test").unwrap();
    let prepared = PreparedScene::new(&scene.scene).unwrap();
    let session = Session { board, scene, elf, table };
    for (k, b, stable) in
        [(20_000.0, 30.0, true), (20_000.0, 900.0, true), (300_000.0, 30.0, false)]
    {
        // Limit cycles of a few counts depend on the start. Therefore the test has many starts, to find the spread of
        // the results.
        let simulated = |start: u8| {
            let wall = WallHit {
                velocity: prepared.scene().velocity.at(1500.0),
                stiffness_n_per_m: k,
                damping_n_s_per_m: b,
                start_offset_counts: AWAY * (f64::from(start) / f64::from(STARTS) - 0.5),
            };
            prepared.hit(Numeric::Fixed, &wall, |_| ()).unwrap()
        };
        let simulated: Vec<_> = (0..STARTS).map(simulated).collect();
        let (report, _) = session.hit([1500.0, k, b]).unwrap();
        assert!(simulated.iter().all(|hit| hit.is_stable() == stable));
        assert_eq!(report.verdict == Verdict::Stable, stable, "{report:?}");
        let range = |of: Vec<f64>| {
            of.iter().fold((f64::MAX, f64::MIN), |(low, high), &x| (low.min(x), high.max(x)))
        };
        let mean_m = range(simulated.iter().map(|hit| hit.mean_m).collect());
        let rms_m = range(simulated.iter().map(|hit| hit.rms_m).collect());
        println!("K {k} B {b}: {}; simulated mean {mean_m:?}, RMS {rms_m:?}", report.line);
        if stable {
            let wider = |(low, high): (f64, f64)| low - 1e-6..high + 1e-6;
            assert!(wider(mean_m).contains(&report.mean_m), "{report:?}");
            assert!(wider(rms_m).contains(&report.rms_m), "{report:?}");
        }
    }
}
