//! The board has output period 1. The core on the host computes every sample again.

use host_sim::{
    analysis::{recompute::Recomputed, replay::Replayed, telemetry::Capture},
    scene::NamedScene,
};
use virtual_board::board::Board;
use zwidth::{Settings, WallSettings};

use crate::firmware::{Firmware, ok};

each_board!(every_velocity_is_the_boards_to_the_last_bit);

/// A hand moves the handle to and fro, starting from rest. The board's value in each sample equals the core's.
fn every_velocity_is_the_boards_to_the_last_bit(board: Board) {
    let firmware = Firmware::of(board);
    let mut world = firmware.boot();
    ok(&mut world, "period 1");
    world.run(500).unwrap();
    world.telemetry.clear();
    for speed in [0.05, -0.2, 0.01, 0.0] {
        world.lead(speed);
        world.run(2_500).unwrap();
    }
    let capture = Capture::decode(&world.telemetry);
    assert_eq!((capture.dropped, capture.garbage_bytes), (0, 0));
    let scene = NamedScene::load(board.name).unwrap().scene;
    let wall = WallSettings {
        position_m: 0.07,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        push_only: true,
    };
    let velocity = firmware.first();
    let control = Settings { velocity, wall }.build(&scene.design()).unwrap();
    let replayed = Replayed::of(&Recomputed::of(&capture), &control).unwrap();
    assert!(replayed.len() > 9_900, "{}", replayed.len());
    assert_eq!(replayed.same_from(), Some(replayed.first));
    let fastest = replayed.velocities.iter().map(|v| v.bits().abs()).max().unwrap();
    assert!(fastest > 15 << 16, "{fastest}");
}
