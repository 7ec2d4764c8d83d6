//! Measures the throughput of the linear analysis for figure 2 of the paper, which has 10 cutoffs and 200 dampings. It
//! should take at most 0.2 s.

use criterion::{Criterion, criterion_group, criterion_main};
use host_sim::analysis::linear::{Boundary, Device, Loop, TransferFunction};
use std::hint::black_box;

/// Computes the stiffness limit for each cutoff and damping, and returns the sum of these limits.
fn figure(period: u32) -> f64 {
    let cutoffs = [20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0];
    let mut sum = 0.0;
    for cutoff in cutoffs {
        let filter = TransferFunction::paper(1e4, cutoff).expect("a cutoff below half the rate");
        let of = Loop { period, ..Loop::single_rate(Device::PAPER, 1e4, filter) };
        let boundary = Boundary::new(&of).expect("the paper's loop is in range");
        for step in 0..200 {
            let limit = boundary.at(10.0 * f64::from(step)).expect("finite damping");
            sum += limit.stiffness_max;
        }
    }
    sum
}

fn boundaries(criterion: &mut Criterion) {
    criterion
        .bench_function("boundary, 10 cutoffs x 200 dampings", |b| b.iter(|| figure(black_box(1))));
    criterion.bench_function("multirate boundary, 10 cutoffs x 200 dampings", |b| {
        b.iter(|| figure(black_box(10)))
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = boundaries
}
criterion_main!(benches);
