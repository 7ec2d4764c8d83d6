//! Tests the library in closed loop, with the commands of a real board.

use super::*;
use crate::{
    board::NUCLEO_F446RE,
    link::{COMMANDS, Link as _},
};
use zwidth::telemetry::Decoder;

struct Bench {
    board: CoreBoard,
    link: crate::link::WiredLink,
    heard: Vec<u8>,
}

impl Bench {
    fn new(scene: &str) -> Self {
        let scene = NamedScene::load(scene).unwrap();
        let board = CoreBoard::start(&scene, NUCLEO_F446RE).unwrap();
        let link = board.wires.link();
        Self { board, link, heard: vec![] }
    }

    /// Types a line. Returns the first reply that starts with `begins` within `ms` milliseconds.
    fn ask(&mut self, line: &str, begins: &str, ms: u32) -> String {
        self.link.write(COMMANDS, format!("{line}\n").as_bytes());
        for _ in 0..ms {
            self.board.millisecond(1.0);
            self.link.read(REPLIES, &mut self.heard);
            let heard = String::from_utf8(self.heard.clone()).unwrap();
            if let Some(found) = heard.lines().find(|line| line.starts_with(begins)) {
                self.heard.clear();
                return found.to_owned();
            }
        }
        panic!("{line}: nothing like {begins:?} in {:?}", String::from_utf8_lossy(&self.heard));
    }
}

/// The library's own hit gives the verdict and the position of the simulator's hit, and every frame is complete.
#[test]
fn a_hit_is_the_simulators() {
    let mut bench = Bench::new("nucleo-f446re");
    for line in ["k 2000", "b 10", "push 1", "settle 1", "window 0.5", "cutoff 1500"] {
        let name = line.split(' ').next().unwrap();
        bench.ask(line, &format!("ok {name}"), 20);
    }
    bench.ask("arm", "ok arm", 20);
    for _ in 0..500 {
        bench.board.millisecond(1.0);
    }
    let line = bench.ask("hit", "ok hit ", 10_000);
    assert!(line.starts_with("ok hit stable, rms "), "{line}");
    let mean = line.split("mean ").nth(1).unwrap().split(' ').next().unwrap();
    // At rest, the wall is compressed by the push of 1 N minus the force of the device's spring.
    let mean_m: f64 = mean.parse().unwrap();
    assert!((0.0701..0.0706).contains(&mean_m), "{line}");
    assert!(bench.ask("hit", "ok hit ", 10_000).starts_with("ok hit stable"), "again");
    let mut bytes = vec![];
    bench.link.read(TELEMETRY, &mut bytes);
    let mut decoder = Decoder::new();
    let frames = bytes.iter().filter(|byte| decoder.push(**byte).is_some()).count();
    assert!(frames > 100 && decoder.garbage == 0, "{frames} {}", decoder.garbage);
}

/// An open stop removes the force and remains a fault. A finger can press the handle against the wall.
#[test]
fn stop_and_finger_are_as_on_a_board() {
    let mut bench = Bench::new("nucleo-f446re");
    bench.ask("k 2000", "ok k", 20);
    bench.ask("b 10", "ok b", 20);
    bench.ask("arm", "ok arm", 20);
    for _ in 0..500 {
        bench.board.millisecond(1.0); // the sign test moves the handle without a hand
    }
    let wires = Arc::clone(&bench.board.wires);
    let target_m = 0.08;
    wires.touch(Some(Finger {
        target_m,
        stiffness_n_per_m: 400.0,
        damping_n_s_per_m: 3.0,
        limit_n: 12.0,
    }));
    for _ in 0..2000 {
        bench.board.millisecond(1.0);
    }
    let seen = wires.seen();
    assert!(seen.enabled && seen.finger_n > 1.0, "{seen:?}");
    assert!((0.0705..0.075).contains(&seen.position_m), "{seen:?}");
    wires.emergency_stop(true);
    bench.board.millisecond(1.0);
    assert!(!wires.seen().enabled);
    let status = bench.ask("status", "ok status", 20);
    assert!(status.contains("fault 30") && status.contains("stop open"), "{status}");
    assert!(bench.ask("selftest", "error: selftest", 20).contains("without a board"));
}

/// For another device the record is made from its scene, without an envelope.
#[test]
fn another_device_runs() {
    for scene in ["paper-2um", "rice-paddle", "hapkit"] {
        let mut bench = Bench::new(scene);
        let get = bench.ask("get", "ok get", 20);
        assert!(get.starts_with("ok get k "), "{get}");
    }
}
