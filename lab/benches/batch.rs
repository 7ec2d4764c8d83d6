//! Measures the throughput of the lanes on one core, for each backend of this machine. The benchmark also measures a
//! plain scalar `f64` loop with the same equations. The rounds of all backends are interleaved. Only the best round of
//! a backend counts, because other work on the machine can only slow a round down.
//!
//! `cargo bench -p host-sim-bench --bench batch -- --figure STEM` measures something else: time and memory, against the
//! number of hits and of samples. This command writes STEM.csv and STEM.png.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "a benchmark fails loudly"
)]

mod plain;

use std::{
    fmt::Write as _, fs, hint::black_box, path::Path, sync::atomic::AtomicBool, time::Instant,
};

use host_sim::{
    engine::{Backend, Depth, Engine, Outcome, Work, run, stream},
    output::figure::{Mark, TradePanel, TradePlot, TradeSeries, trade},
    scene::NamedScene,
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};
use plain::{Butterworth, SAMPLES, plain};
use zwidth::VelocitySettings;

const ROUNDS: usize = 25;
/// Number of hits in a round. It is a multiple of every backend's number of lanes.
const HITS: u32 = 16;
const FILTER: VelocitySettings = VelocitySettings::Butterworth { cutoff_hz: 1500.0 };

/// Hits close to the stability boundary, none of which ends early. The limit cycles there keep the states away from
/// subnormal numbers.
struct Hits {
    left: u32,
    unstable: u32,
}

impl Work for Hits {
    fn next(&mut self, _: usize) -> Option<WallHit> {
        self.left = self.left.checked_sub(1)?;
        Some(WallHit {
            velocity: FILTER,
            stiffness_n_per_m: 60_000.0 + 50.0 * f64::from(self.left),
            damping_n_s_per_m: 300.0,
            start_offset_counts: 0.0,
        })
    }

    fn done(&mut self, _: usize, outcome: Result<Outcome, HitError>) {
        self.unstable += u32::from(outcome.unwrap().rms_m.unwrap() > 1.5e-5);
    }
}

/// Throughput of one run, in samples per second.
fn throughput(prepared: &PreparedScene, engine: Engine, numeric: Numeric) -> f64 {
    // The scalar loop is slow, and needs fewer hits for the same precision.
    let hits = if engine == Engine::Core { HITS / 4 } else { HITS };
    let mut work = Hits { left: hits, unstable: 0 };
    let began = Instant::now();
    run(engine, prepared, numeric, Depth::Whole, &mut work);
    black_box(work.unstable);
    f64::from(hits) * SAMPLES as f64 / began.elapsed().as_secs_f64()
}

fn plain_throughput() -> f64 {
    let began = Instant::now();
    for n in 0..8 {
        black_box(plain(
            Butterworth::default(),
            black_box(60_000.0 + 50.0 * f64::from(n)),
            black_box(300.0),
        ));
    }
    8.0 * SAMPLES as f64 / began.elapsed().as_secs_f64()
}

/// The largest value. It is from the round that other work on the machine has disturbed least.
fn best(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn main() {
    if std::env::args().any(|argument| argument == "--test") {
        return; // `cargo test --benches` only checks that the benchmark starts
    }
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(place) = arguments.iter().position(|argument| argument == "--figure") {
        return figure(Path::new(&arguments[place + 1]));
    }
    let prepared = PreparedScene::new(&NamedScene::load("paper-1um").unwrap().scene).unwrap();
    let mut rows = vec![];
    let available = Backend::ALL.into_iter().filter(|backend| backend.is_available());
    for engine in available.map(Engine::Lanes).chain([Engine::Core]) {
        for (name, numeric) in [("fixed", Numeric::Fixed), ("f64", Numeric::F64)] {
            rows.push((engine, name, numeric, vec![]));
        }
    }
    let mut yardstick = vec![];
    for _ in 0..ROUNDS {
        for (engine, _, numeric, speeds) in &mut rows {
            yardstick.push(plain_throughput() / 1e6);
            speeds.push(throughput(&prepared, *engine, *numeric) / 1e6);
        }
    }
    println!("plain f64 loop: {:.1} Msamples/s, one core", best(&yardstick));
    println!(
        "{:8} {:6} {:>5} {:>12} {:>16}",
        "engine", "", "lanes", "Msamples/s", "times the loop"
    );
    for (engine, name, _, speeds) in rows {
        println!(
            "{:8} {name:6} {:5} {:12.1} {:16.2}",
            match engine {
                Engine::Core => engine.name(),
                Engine::Lanes(backend) => backend.name(),
            },
            engine.hits_at_once(&prepared, Numeric::Fixed),
            best(&speeds),
            best(&speeds) / best(&yardstick)
        );
    }
}

/// The paper's device with a hit of `samples` samples. The second half of the hit is its window.
fn prepared_of(samples: u64) -> PreparedScene {
    let mut scene = NamedScene::load("paper-1um").unwrap().scene;
    scene.device.start_position_m = 0.0695;
    scene.wall_hit.settle_s = samples as f64 * 0.5e-4;
    scene.wall_hit.window_s = samples as f64 * 0.5e-4;
    PreparedScene::new(&scene).unwrap()
}

/// Processor time of one thread for `hits` hits, in s.
fn cost_of(prepared: &PreparedScene, numeric: Numeric, hits: u64) -> f64 {
    let hit = |number: u64| WallHit {
        velocity: FILTER,
        stiffness_n_per_m: 40_000.0 + 1e-2 * number as f64,
        damping_n_s_per_m: 300.0,
        start_offset_counts: 0.0,
    };
    let stop = AtomicBool::new(false);
    let (began_s, mut rounds) = (processor_s(), 0.0);
    loop {
        let mut seen = 0;
        stream(
            Engine::lanes(),
            prepared,
            numeric,
            Depth::Whole,
            hits,
            hit,
            &stop,
            |number, outcome| {
                black_box(outcome.unwrap());
                seen = number + 1;
                Ok(())
            },
        )
        .unwrap();
        assert_eq!(seen, hits);
        rounds += 1.0;
        let time_s = processor_s() - began_s;
        if time_s > ENOUGH_S {
            return time_s / rounds;
        }
    }
}

/// Shortest time of a measurement, in s. The system counts a thread's time in ticks of some milliseconds.
const ENOUGH_S: f64 = 0.3;

/// Processor time of this thread so far, in s. Other work on the machine does not count.
fn processor_s() -> f64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split(' ').next().unwrap().parse::<f64>().unwrap() * 1e-9
}

/// The largest memory that this process has used so far, in MB.
fn peak_mb() -> f64 {
    let text = fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<f64>().unwrap() / 1024.0
}

/// The exponent of the power law that fits the points best, by least squares.
fn slope(line: &[[f64; 2]]) -> f64 {
    let logs = line.iter().map(|point| point.map(f64::log10));
    let n = line.len() as f64;
    let [x, y] = logs.clone().fold([0.0; 2], |sum, p| [sum[0] + p[0] / n, sum[1] + p[1] / n]);
    let (mut xy, mut xx) = (0.0, 0.0);
    for point in logs {
        xy += (point[0] - x) * (point[1] - y);
        xx += (point[0] - x).powi(2);
    }
    xy / xx
}

fn figure(stem: &Path) {
    const NUMERICS: [(&str, Numeric); 2] = [("fixed", Numeric::Fixed), ("f64", Numeric::F64)];
    const HITS: [u64; 7] = [1000, 3000, 10_000, 30_000, 100_000, 300_000, 1_000_000];
    const LENGTHS: [u64; 7] = [1000, 3000, 10_000, 30_000, 100_000, 300_000, 1_000_000];
    const SAMPLES_PER_HIT: u64 = 200;
    const HITS_PER_LENGTH: u64 = 64;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut csv = String::from("numeric,hits,samples_per_hit,time_s,peak_mb\n");
    let mut series = vec![];
    let short = prepared_of(SAMPLES_PER_HIT);
    for (name, numeric) in NUMERICS {
        let (mut times, mut memory, mut lengths) = (vec![], vec![], vec![]);
        for hits in HITS {
            let time_s = pool.install(|| cost_of(&short, numeric, hits));
            times.push([hits as f64, time_s]);
            memory.push([hits as f64, peak_mb()]);
            writeln!(csv, "{name},{hits},{SAMPLES_PER_HIT},{time_s},{:.1}", peak_mb()).unwrap();
        }
        for samples in LENGTHS {
            let prepared = prepared_of(samples);
            let time_s = pool.install(|| cost_of(&prepared, numeric, HITS_PER_LENGTH));
            lengths.push([samples as f64, time_s]);
            writeln!(csv, "{name},{HITS_PER_LENGTH},{samples},{time_s},{:.1}", peak_mb()).unwrap();
        }
        println!(
            "{name}: time ~ hits^{:.3}, ~ samples^{:.3}; at most {:.1} MB",
            slope(&times),
            slope(&lengths),
            peak_mb()
        );
        series.push(TradeSeries {
            name: name.into(),
            colour: series.len(),
            mark: Mark::Circle,
            points: vec![times, memory, lengths],
        });
    }
    let panels = [
        ("Processor time [s]", "hits"),
        ("Peak memory [MB]", "hits"),
        ("Processor time [s]", "samples of a hit"),
    ];
    let figure = trade(&TradePlot {
        title: "Cost of wall hits in lanes".into(),
        subtitle: format!(
            "One thread, {}; hits of {SAMPLES_PER_HIT} samples, then {HITS_PER_LENGTH} hits",
            Backend::best().name()
        ),
        legend: "Arithmetic".into(),
        x_title: "Hits, or samples of a hit".into(),
        panels: panels
            .map(|(y_title, over)| TradePanel {
                title: format!("over {over}"),
                y_title: y_title.into(),
                limit: None,
                floor: 1e-9,
                front: vec![],
            })
            .into(),
        series,
        lines: true,
    })
    .unwrap();
    fs::write(stem.with_extension("csv"), csv).unwrap();
    fs::write(stem.with_extension("png"), figure.png().unwrap()).unwrap();
}
