//! Every estimator of each board on the release ELF: selected, tuned and used in contact over RTT. The velocities equal
//! the core's on the host, bit for bit.

use virtual_board::{
    board::{Board, Force as Wired},
    mcu::{Cycles, SAMPLE},
};
use zwidth::{
    Design, LoopParameters, Sampled, Settings, VelocitySettings, WallSettings,
    telemetry::{Decoder, Record},
    units::Force,
    velocity::{Edge, EstimatorName, PARAMETERS, Sense, Senses},
};

use crate::{
    edges,
    firmware::{Firmware, Replay, ok},
};

each_board!(
    every_estimator_runs_on_the_board_and_is_the_cores,
    ignored: "images of their own; CI runs it"
);

/// Number of samples with each estimator. In this time the handle moves in and out of the wall twice.
const SAMPLES: u32 = 1_000;

fn with(velocity: VelocitySettings) -> Settings {
    Settings {
        velocity,
        wall: WallSettings {
            position_m: 0.005,
            stiffness_n_per_m: 8000.0,
            damping_n_s_per_m: 30.0,
            push_only: true,
        },
    }
}

fn every_estimator_runs_on_the_board_and_is_the_cores(board: Board) {
    let firmware = Firmware::variant(board, &["estimators"]);
    let output = match board.wiring.force {
        Wired::Dac { .. } => zwidth::Output::Dac { bits: 12 },
        Wired::Pwm { .. } => zwidth::Output::Pwm { steps: 4200 },
    };
    let design = Design { output, ..firmware.scene.design() };
    let captured = board.wiring.captured.is_some();
    let mut world = firmware.armed();
    let middle_m = world.position_m();
    world.hold(middle_m, true);
    world.run(300).unwrap();
    let mut velocity = firmware.first();
    // The firmware's first settings count as a change. `arm` sets wall, K and B.
    let mut settings = vec![with(velocity); 5];
    for early in &mut settings[..4] {
        early.wall.damping_n_s_per_m = 0.0; // the velocity does not depend on it
    }
    let mut table: Vec<(&str, Cycles)> = vec![];
    for &name in EstimatorName::ALL {
        // The NUCLEO also has edge times. Without edge times, `time-stamps` is refused.
        let senses = &[Sense::Force, Sense::Edge][..1 + usize::from(captured)];
        if let Some(sense) = name.missing(senses) {
            let refused = world.ask(&format!("estimator {}", name.text())).unwrap();
            assert!(refused.contains(sense.text()), "{refused}");
            continue;
        }
        // Outside the wall: selects the estimator, then sets parameters that differ from the defaults.
        ok(&mut world, &format!("estimator {}", name.text()));
        velocity = name.following(&velocity);
        settings.push(with(velocity));
        if let Some((_, value)) = velocity.tuning() {
            velocity = velocity.with_tuning((value * 0.75).round());
            let (parameter, value) = velocity.tuning().unwrap();
            let reply = ok(&mut world, &format!("tuning {value}"));
            assert!(reply.contains(parameter.name), "{reply}");
            settings.push(with(velocity));
        }
        for place in 1..PARAMETERS {
            let Some((_, value)) = velocity.parameter(place) else { continue };
            velocity = velocity.with_parameter(place, value * 1.5);
            let (parameter, value) = velocity.parameter(place).unwrap();
            let reply = ok(&mut world, &format!("tuning{} {value}", place + 1));
            assert!(reply.contains(parameter.name), "{reply}");
            settings.push(with(velocity));
        }
        world.powered.mcu.watch_mut().clear();
        for n in 0..SAMPLES {
            let phase = f64::from(n) / f64::from(SAMPLES) * 2.0 * std::f64::consts::TAU;
            world.hold(middle_m + 0.0053 * 0.5 * (1.0 - phase.cos()), true);
            world.sample().unwrap();
            if n % 50 == 49 {
                world.probe().unwrap();
            }
        }
        table.push((name.text(), world.powered.mcu.watch().tasks[&SAMPLE]));
        let status = ok(&mut world, "status");
        assert!(status.contains("armed, fault none"), "{}: {status}", name.text());
    }
    world.run(20).unwrap();
    let mut decoder = Decoder::new();
    let telemetry = std::mem::take(&mut world.telemetry);
    let frames = telemetry.into_iter().filter_map(|byte| decoder.push(byte));
    let records: Vec<Record> = frames.map(|frame| frame.record).collect();
    assert_eq!(decoder.dropped, 0);
    let taken: Vec<LoopParameters> =
        settings.iter().map(|settings| settings.build(&design).unwrap()).collect();
    let edges = if captured {
        edges::latest(board, &world.powered.mcu.take_edge_notes(), 0, false).0
    } else {
        vec![]
    };
    let readings = world.powered.mcu.counter_readings();
    let compared = compare(&readings, &edges, &records, &taken);
    println!("{}: {compared} velocities equal, {} estimators", board.name, table.len());
    for (name, cycles) in table {
        println!("  {name:24} sample {}..{} cycles", cycles.least, cycles.most);
        assert!(cycles.most <= board.cycles_per_sample() / 4, "{name}: {cycles:?}");
    }
    assert!(compared > 2_000, "{compared}");
}

/// Runs the core on the board's counts, with edge times if the board has them. For each record, the core uses the
/// settings of this record and the force of the previous record. Returns the number of compared velocities, all of them
/// equal.
fn compare(
    readings: &[u32],
    edges: &[Option<Edge>],
    records: &[Record],
    taken: &[LoopParameters],
) -> u64 {
    let [first, readings @ ..] = readings else { panic!("no counts") };
    let mut replay = Replay::new(*first, taken);
    let mut records = records.iter().peekable();
    let mut force = Force::ZERO;
    let skipped = records.peek().unwrap().sample;
    let mut compared = 0;
    let mut edges = edges.iter();
    for (n, &reading) in (0u64..).zip(readings) {
        let senses = Senses { force, edge: edges.next().copied().flatten(), ..Senses::NONE };
        let (_, Sampled { motion, due }) =
            replay.sample(n, reading, records.peek().copied(), &senses);
        if !due || n < skipped {
            continue;
        }
        let Some(record) = records.next() else { break };
        assert_eq!(record.sample, n);
        assert_eq!(record.position, motion.position, "{n}");
        assert_eq!(record.velocity, motion.velocity, "{n}: settings {}", record.settings);
        force = record.force;
        compared += 1;
    }
    compared
}
