//! Measures the throughput of every estimator that has lanes, on one core and for each backend of this machine. The
//! benchmark also measures a plain scalar `f64` loop with the same equations. The result is
//! docs/data/batch-estimators.csv. The rounds of all backends are interleaved. Only the best round of a backend counts,
//! because other work on the machine can only slow a round down.
//!
//! With `-- --core`, only the scalar loop is measured, for all estimators.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "a benchmark fails loudly"
)]

mod plain;
mod plain_filters;

use std::{hint::black_box, time::Instant};

use host_sim::{
    engine::{Backend, Depth, Engine, Outcome, Tally, Work, run},
    scene::{NamedScene, Scene},
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};
use plain::SAMPLES;
use plain_filters::{ACCELEROMETER, plain_hit};
use zwidth::{
    VelocitySettings,
    velocity::{EstimatorName, Sense},
};

const ROUNDS: usize = 15;
/// Number of hits in a round. It is a multiple of every backend's number of lanes.
const HITS: u32 = 16;

/// Hits beyond the stability boundary, none of which ends early. The limit cycles there keep the states away from
/// subnormal numbers.
struct Hits(u32, VelocitySettings);

impl Work for Hits {
    fn next(&mut self, _: usize) -> Option<WallHit> {
        self.0 = self.0.checked_sub(1)?;
        Some(WallHit {
            velocity: self.1,
            stiffness_n_per_m: 60_000.0 + 50.0 * f64::from(self.0),
            damping_n_s_per_m: 300.0,
            start_offset_counts: 0.0,
        })
    }

    fn done(&mut self, _: usize, outcome: Result<Outcome, HitError>) {
        black_box(outcome.unwrap());
    }
}

/// Throughput of one run, in million samples per second.
fn throughput(
    settings: VelocitySettings,
    prepared: &PreparedScene,
    engine: Engine,
    hits: u32,
) -> f64 {
    let began = Instant::now();
    let mut work = Hits(hits, settings);
    let tally = run(engine, prepared, Numeric::Fixed, Depth::Whole, &mut work);
    let scalar = engine == Engine::Core;
    let (in_lanes, scalar) = if scalar { (0, hits) } else { (hits, 0) };
    assert_eq!(tally, Tally { in_lanes: in_lanes.into(), scalar: scalar.into() });
    f64::from(hits) * SAMPLES as f64 / began.elapsed().as_secs_f64() / 1e6
}

/// Throughput of the plain `f64` loop, in million samples per second.
fn plain_throughput(settings: &VelocitySettings, prepared: &PreparedScene) -> f64 {
    let began = Instant::now();
    let runs = 4;
    for n in 0..runs {
        let wall = [black_box(60_000.0 + 50.0 * f64::from(n)), black_box(300.0)];
        black_box(plain_hit(settings, prepared.design(), wall));
    }
    f64::from(runs) * SAMPLES as f64 / began.elapsed().as_secs_f64() / 1e6
}

/// The largest rate. It is from the run that other work on the machine has disturbed least.
fn best(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn main() {
    if std::env::args().any(|argument| argument == "--test") {
        return; // `cargo test --benches` only checks that the benchmark starts
    }
    let scalar = std::env::args().any(|argument| argument == "--core");
    let only: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let available = Backend::ALL.into_iter().filter(|backend| backend.is_available() && !scalar);
    let engines: Vec<Engine> = available.map(Engine::Lanes).chain([Engine::Core]).collect();
    let of = |engine: &Engine| match engine {
        Engine::Core => engine.name(),
        Engine::Lanes(backend) => backend.name(),
    };
    let heads: Vec<String> =
        engines.iter().map(|e| format!("{0},\"{0}, times the plain loop\"", of(e))).collect();
    println!("estimator,\"plain loop, million samples/s\",{}", heads.join(","));
    for &name in EstimatorName::ALL {
        let settings = name.defaults();
        let chosen = only.is_empty() || only.iter().any(|only| only == name.text());
        if !chosen {
            continue;
        }
        let sensor = (name.sense() == Some(Sense::Acceleration)).then_some(ACCELEROMETER);
        let scene = Scene { velocity: settings.into(), accelerometer: sensor, ..scene.clone() };
        let Ok(prepared) = PreparedScene::new(&scene) else {
            continue; // the scene lacks a signal that the estimator needs
        };
        if !scalar && !host_sim::engine::lanes_for(&prepared, Numeric::Fixed) {
            continue;
        }
        let filter = scene.velocity.at(1500.0);
        let mut speeds = vec![vec![]; engines.len()];
        let mut yardstick = vec![];
        for _ in 0..ROUNDS {
            yardstick.push(plain_throughput(&settings, &prepared));
            for (engine, speeds) in engines.iter().zip(&mut speeds) {
                // The scalar loop is slow, and needs fewer hits for the same precision.
                let hits = if *engine == Engine::Core { HITS / 8 } else { HITS };
                speeds.push(throughput(filter, &prepared, *engine, hits));
            }
        }
        let loops = best(&yardstick);
        let speeds = speeds.iter().map(|speeds| best(speeds));
        let cells: Vec<String> = speeds.map(|s| format!("{s:.0},{:.1}", s / loops)).collect();
        println!("{},{loops:.0},{}", name.text(), cells.join(","));
    }
}
