//! Cost of one sample of the loop: the fixed-point core, its `f64` twin in the simulator, and a plain scalar `f64` loop
//! with the same equations. The plain loop uses no part of the simulator. Core, twin and plain loop run whole wall
//! hits. The throughput counts samples.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "a test fails loudly"
)]

mod plain;

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use host_sim::{
    scene::NamedScene,
    simulation::prepared::{Numeric, PreparedScene, WallHit},
};
use plain::{Butterworth, SAMPLES, plain};
use zwidth::VelocitySettings;

const HIT: WallHit = WallHit {
    velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
    stiffness_n_per_m: 60_000.0,
    damping_n_s_per_m: 300.0, // on the boundary: a limit cycle, so no state becomes subnormal
    start_offset_counts: 0.0,
};

fn step(c: &mut Criterion) {
    let prepared =
        PreparedScene::new(&NamedScene::load("paper-1um").expect("built in").scene).expect("valid");
    let mut group = c.benchmark_group("one wall hit");
    group.throughput(Throughput::Elements(SAMPLES as u64));
    group.bench_function("plain f64 loop", |bencher| {
        bencher.iter(|| plain(Butterworth::default(), black_box(60_000.0), black_box(300.0)));
    });
    for (name, numeric) in [("fixed point", Numeric::Fixed), ("f64 twin", Numeric::F64)] {
        group.bench_function(name, |bencher| {
            bencher.iter(|| prepared.verdict(black_box(numeric), black_box(&HIT)));
        });
    }
    group.finish();
}

criterion_group!(benches, step);
criterion_main!(benches);
