//! Throughput of the lanes on one core, for each backend that this machine has, beside a plain scalar `f64`
//! loop of the same maths. Rounds of all of them are interleaved, and the best round of each counts: other
//! work on the machine only ever slows a round down.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "a benchmark fails loudly"
)]

mod plain;

use std::{hint::black_box, time::Instant};

use host_sim::{
    batch::{Backend, Depth, Outcome, Work, run},
    rig::{HitError, Numeric, Rig, WallHit},
    scene::NamedScene,
};
use plain::{SAMPLES, plain};

const ROUNDS: usize = 25;
/// Hits of a round; a multiple of every number of lanes.
const HITS: u32 = 16;

/// Hits around the boundary, all whole: limit cycles, so no state ever gets subnormal.
struct Hits {
    left: u32,
    unstable: u32,
}

impl Work for Hits {
    fn next(&mut self, _: usize) -> Option<WallHit> {
        self.left = self.left.checked_sub(1)?;
        Some(WallHit {
            cutoff_hz: 1500.0,
            stiffness_n_per_m: 60_000.0 + 50.0 * f64::from(self.left),
            damping_n_s_per_m: 300.0,
            start_offset_counts: 0.0,
        })
    }

    fn done(&mut self, _: usize, outcome: Result<Outcome, HitError>) {
        self.unstable += u32::from(outcome.unwrap().rms_m.unwrap() > 1.5e-5);
    }
}

/// Samples per second of one run.
fn throughput(rig: &Rig, backend: Backend, numeric: Numeric) -> f64 {
    // the scalar loop is slow, and needs fewer hits for the same precision
    let hits = if backend == Backend::Scalar { HITS / 4 } else { HITS };
    let mut work = Hits { left: hits, unstable: 0 };
    let began = Instant::now();
    run(backend, rig, numeric, Depth::Whole, &mut work);
    black_box(work.unstable);
    f64::from(hits) * SAMPLES as f64 / began.elapsed().as_secs_f64()
}

fn plain_throughput() -> f64 {
    let began = Instant::now();
    for n in 0..8 {
        black_box(plain(black_box(60_000.0 + 50.0 * f64::from(n)), black_box(300.0)));
    }
    8.0 * SAMPLES as f64 / began.elapsed().as_secs_f64()
}

/// The undisturbed one: other work on the machine only ever slows a round down.
fn best(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn main() {
    if std::env::args().any(|argument| argument == "--test") {
        return; // `cargo test --benches` only wants to know that it starts
    }
    let rig = Rig::new(&NamedScene::load("paper-1um").unwrap().scene).unwrap();
    let mut rows = vec![];
    for backend in Backend::ALL.into_iter().filter(|backend| backend.is_available()) {
        for (name, numeric) in [("fixed", Numeric::Fixed), ("f64", Numeric::F64)] {
            rows.push((backend, name, numeric, vec![]));
        }
    }
    let mut yardstick = vec![];
    for _ in 0..ROUNDS {
        for (backend, _, numeric, speeds) in &mut rows {
            yardstick.push(plain_throughput() / 1e6);
            speeds.push(throughput(&rig, *backend, *numeric) / 1e6);
        }
    }
    println!("plain f64 loop: {:.1} Msamples/s, one core", best(&yardstick));
    println!(
        "{:8} {:6} {:>5} {:>12} {:>16}",
        "backend", "", "lanes", "Msamples/s", "times the loop"
    );
    for (backend, name, _, speeds) in rows {
        println!(
            "{:8} {name:6} {:5} {:12.1} {:16.2}",
            backend.name(),
            backend.lanes(),
            best(&speeds),
            best(&speeds) / best(&yardstick)
        );
    }
}
