//! Tests the telemetry of the release ELF. The core on the host computes every sample of a session again.

use host_sim::analysis::{recompute::Recomputed, telemetry::Capture};
use virtual_board::{board::Board, world::World};

use crate::firmware::{Firmware, ok};

each_board!(every_sample_of_a_session_is_the_cores);

/// Largest rate of telemetry in bytes/s, with samples at 10 kHz and an output each millisecond.
const BYTES_PER_S: f64 = 60e3;

/// A hand moves the handle to and fro. The handle enters and leaves the wall at 5 mm, and moves below zero.
fn swing(world: &mut World<'_>) {
    for (speed, samples) in [(0.06, 1_000), (-0.08, 1_200), (0.02, 300), (0.3, 150), (-0.2, 300)] {
        world.lead(speed);
        world.run(samples).unwrap();
    }
    let position_m = world.position_m();
    world.hold(position_m, false);
    world.run(30).unwrap();
}

/// Returns the telemetry, and the values that the core computes from it. Checks that these equal the board's values.
fn computed(world: &mut World<'_>) -> (Capture, Recomputed) {
    let capture = Capture::decode(&std::mem::take(&mut world.telemetry));
    assert_eq!((capture.dropped, capture.garbage_bytes), (0, 0));
    let all = Recomputed::of(&capture);
    println!(
        "{} samples, {} computed, {} velocities, {} forces, {} states, {} changes, unknown {:?}, stretches {:?}",
        all.rows.len(),
        all.computed,
        all.velocities,
        all.forces,
        all.states,
        all.changes,
        all.unknown,
        all.stretches
    );
    assert_eq!(all.first_difference(), None);
    (capture, all)
}

fn every_sample_of_a_session_is_the_cores(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.boot();
    crate::firmware::arm(&mut world);
    swing(&mut world);
    for line in [
        "cutoff 300",
        "estimator first-order",
        "cutoff 90",
        "estimator difference",
        "estimator butterworth",
    ] {
        ok(&mut world, line);
        swing(&mut world);
    }
    ok(&mut world, "hit");
    world.run(25_000).unwrap();
    println!("{:?}", world.lines.last());
    world.ask("disarm").unwrap();
    world.run(100).unwrap();
    ok(&mut world, "zero");
    world.run(500).unwrap();
    let bytes = world.telemetry.len() as f64;
    let (capture, all) = computed(&mut world);
    let rate = bytes / all.rows.len() as f64 * 1e4;
    println!("{}: {rate:.0} bytes/s, {} frames", board.name, capture.chunks.len());
    assert!(rate < BYTES_PER_S, "{rate}");
    assert_eq!(all.stretches.len(), 1);
    assert!(all.unknown.is_empty(), "{:?}", all.unknown);
    assert!(all.rows.len() > 20_000 && all.rows.len() as u64 - all.computed < 20);
    for period in [1, 2, 5] {
        ok(&mut world, &format!("period {period}"));
        world.run(100).unwrap();
        swing(&mut world);
        let (_, all) = computed(&mut world);
        assert_eq!(all.stretches.len(), 1, "{period}");
        assert!(all.rows.len() > 2_000);
    }
}
