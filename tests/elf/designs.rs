//! Tests the designs of a record, which are selected on the console. With each design, every frame of a hit equals the
//! frame that the core computes on the host.

use host_sim::scene::{
    NamedScene,
    record::{board_facts, words},
};
use virtual_board::board::{BOARDS, Board};
use zwidth::{
    device::Device,
    period::{PERIODS, leaves_time},
    safety::envelope::{Boundary, Key, Point},
};

use crate::{
    firmware::{Firmware, ok},
    period::hit_at,
};

each_board!(
    every_design_is_the_cores_at_every_period,
    ignored: "images of their own, with every estimator; low-passes run by default"
);

/// Designs for every image. `DESIGNED` are designs that need the feature `estimators`.
const LOW_PASSES: &str = "\n[designs.paper]\nestimator = \"butterworth\"\ncutoff_hz = 1500\n\
    [designs.quiet]\nestimator = \"first-order\"\ncutoff_hz = 456.7\n";
const DESIGNED: &str = "\n[designs.stiff]\nestimator = \"biquad\"\ncutoff_hz = 555\ndamping = 0.561\n\
    lead_s = 0.0002099\nzero = -0.6651\n\
    [designs.two]\nestimator = \"biquad-2\"\ncutoff_hz = 430.5\ndamping = 0.4\nlead_s = 1e-4\nzero = -0.3\n\
    second_ratio = 2.5\nsecond_damping = 0.9\nsecond_lead_s = 2e-5\nsecond_zero = 0.1\n\
    [designs.kalman]\nestimator = \"kalman-3\"\njerk_rms_m_per_s3 = 27691\n";

/// The firmware with a record of these designs, and the record's device. Each design has rows at periods 10 and 5.
fn with_designs(firmware: Firmware, designs: &str) -> (Firmware, Device<'static>) {
    let board = firmware.board;
    let own = NamedScene::load(board.name).unwrap();
    let text = format!("{}{designs}", own.text);
    let scene = NamedScene::parse("designs".into(), text, "designs.toml").unwrap();
    let facts = board_facts(board.name).unwrap();
    let first = scene.scene.velocity.at(1200.0);
    let prepared = scene.prepared(&facts, first).unwrap();
    let points = [0.0, 100.0].map(|damping_n_s_per_m| Point {
        damping_n_s_per_m,
        stiffness_low_n_per_m: 0.0,
        stiffness_high_n_per_m: 1000.0,
    });
    let boundaries: Vec<Boundary<'_>> = (1..)
        .zip(&prepared.designs)
        .flat_map(|(design, filter)| [(design, filter, 10), (design, filter, 5)])
        .map(|(design, filter, period)| {
            let estimator = filter.velocity.name();
            let cutoff_hz = filter.velocity.tuning().map_or(0.0, |(_, value)| value);
            Boundary { key: Key { estimator, cutoff_hz, period, design }, points: &points }
        })
        .collect();
    let record = prepared.record(&boundaries, &facts).unwrap();
    let elf = firmware.elf.with_record(&record).unwrap();
    let device = Device::from_record(words(&record).leak(), &facts).unwrap();
    (Firmware { elf, ..firmware }, device)
}

#[test]
fn low_passes_of_a_record_are_chosen_by_name_and_the_cores() {
    let (firmware, device) = with_designs(Firmware::of(BOARDS[0]), LOW_PASSES);
    for design in device.designs.iter() {
        hit_at(&firmware, &device, Some(design), 10);
    }
}

/// The rows of a design decide which walls are allowed. A filter that is tuned by hand needs an unlocked envelope. A
/// design can be changed only with the force off.
#[test]
fn an_image_keeps_to_the_rows_of_a_design() {
    let (firmware, _) = with_designs(Firmware::of(BOARDS[0]), &format!("{LOW_PASSES}{DESIGNED}"));
    let mut world = firmware.boot();
    // This image has no biquad and no Kalman filter.
    assert_eq!(ok(&mut world, "designs"), "ok designs paper quiet");
    assert_eq!(world.ask("design stiff").unwrap(), "error: unknown design, allowed paper quiet");
    for line in ["design quiet", "wall 0.1", "k 1000", "b 50", "zero"] {
        ok(&mut world, line);
    }
    assert!(ok(&mut world, "get").ends_with(", design quiet"));
    let unknown = "error: no envelope for this device";
    for (line, arms) in [
        ("design quiet", true),
        ("tuning 456.8", false),
        ("tuning 456.7", true),
        ("period 5", true),
        ("period 2", false),
        ("period 10", true),
        ("k 1001", false),
    ] {
        ok(&mut world, line);
        world.run(50).unwrap();
        let reply = world.ask("arm").unwrap();
        if arms {
            assert_eq!(reply, "ok arm", "{line}");
            world.run(4_000).unwrap();
            for line in ["design paper", "load"] {
                assert_eq!(world.ask(line).unwrap(), "error: the force is on: disarm first");
            }
            assert!(world.ask("tuning 500").unwrap().starts_with(unknown));
            ok(&mut world, "disarm");
        } else {
            assert!(
                reply.starts_with("error: ") && reply.ends_with("or unlock envelope"),
                "{reply}"
            );
        }
    }
    for line in ["k 1000", "tuning 500", "unlock envelope", "arm"] {
        ok(&mut world, line);
    }
}

fn every_design_is_the_cores_at_every_period(board: Board) {
    let firmware = Firmware::variant(board, &["estimators"]);
    let (firmware, device) = with_designs(firmware, &format!("{LOW_PASSES}{DESIGNED}"));
    let mut run = 0;
    // The core is the same on both boards.
    let periods: &[u32] = if board == BOARDS[0] { &PERIODS } else { &[1, 10] };
    for &period in periods {
        for (number, design) in device.designs.iter() {
            if leaves_time(design.velocity.name(), period).is_err() {
                println!("{}: {} not at period {period}", board.name, design.name.text());
                continue;
            }
            let (watch, _) = hit_at(&firmware, &device, Some((number, design)), period);
            let cycles = watch.tasks[&virtual_board::mcu::SAMPLE];
            println!(
                "{}: {} at period {period}, sample {cycles:?}",
                board.name,
                design.name.text()
            );
            run += 1;
        }
    }
    assert!(run >= 4 * periods.len(), "{run}");
}
