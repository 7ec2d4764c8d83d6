//! Throughput of every estimator that has lanes, on one core and for each backend that this machine has, beside a plain
//! scalar `f64` loop of the same maths; written as docs/data/batch-estimators.csv. Rounds of all of them are interleaved, and the best round of each counts: other
//! work on the machine only ever slows a round down. `-- --core` measures the scalar loop alone, and of all estimators.
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
    engine::{Backend, Depth, Engine, Outcome, Tally, Work, run},
    scene::{NamedScene, Scene},
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
};
use plain::{Butterworth, Filter, SAMPLES, plain};
use zwidth::{
    VelocitySettings,
    velocity::{EstimatorName, FirstOrder, KalmanDesign, LevantDesign, TrackingLoop},
};

const ROUNDS: usize = 15;
/// Hits of a round; a multiple of every number of lanes.
const HITS: u32 = 16;

/// Hits beyond the boundary, all whole: limit cycles, so no state ever gets subnormal.
struct Hits(u32);

impl Work for Hits {
    fn next(&mut self, _: usize) -> Option<WallHit> {
        self.0 = self.0.checked_sub(1)?;
        Some(WallHit {
            cutoff_hz: 1500.0,
            stiffness_n_per_m: 60_000.0 + 50.0 * f64::from(self.0),
            damping_n_s_per_m: 300.0,
            start_offset_counts: 0.0,
        })
    }

    fn done(&mut self, _: usize, outcome: Result<Outcome, HitError>) {
        black_box(outcome.unwrap());
    }
}

/// Million samples per second of one run.
fn throughput(prepared: &PreparedScene, engine: Engine, hits: u32) -> f64 {
    let began = Instant::now();
    let tally = run(engine, prepared, Numeric::Fixed, Depth::Whole, &mut Hits(hits));
    let scalar = engine == Engine::Core;
    let (in_lanes, scalar) = if scalar { (0, hits) } else { (hits, 0) };
    assert_eq!(tally, Tally { in_lanes: in_lanes.into(), scalar: scalar.into() });
    f64::from(hits) * SAMPLES as f64 / began.elapsed().as_secs_f64() / 1e6
}

struct Kalman {
    gains: KalmanDesign,
    distance: f64,
    velocity: f64,
    acceleration: f64,
}

impl Filter for Kalman {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        let predicted = self.distance + self.velocity + self.acceleration / 2.0 - moved;
        self.distance = predicted - self.gains.alpha * predicted;
        self.velocity += self.acceleration - self.gains.beta * predicted;
        self.acceleration -= self.gains.gamma * predicted;
        self.velocity
    }
}

/// A weighted sum of the last differences, newest first.
struct Sum {
    weights: Vec<f64>,
    past: [f64; 64],
    newest: usize,
}

impl Filter for Sum {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        self.newest = (self.newest + 1) % 64;
        self.past[self.newest] = moved;
        let at = |age: usize| self.past[(self.newest + 64 - age) % 64];
        self.weights.iter().enumerate().map(|(age, weight)| weight * at(age)).sum()
    }
}

/// The tracking loop with both its poles at 1500 Hz.
struct Tracking {
    gains: TrackingLoop,
    error: f64,
    velocity: f64,
}

impl Filter for Tracking {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        let e = self.error + moved - self.velocity;
        self.error = e - self.gains.kp * e;
        self.velocity += self.gains.ki * e;
        self.velocity
    }
}

/// Levant's differentiator.
struct Levant {
    implicit: bool,
    sizes: LevantDesign,
    ahead: f64,
    velocity: f64,
}

impl Filter for Levant {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        let LevantDesign { alpha, lambda } = self.sizes;
        let b = self.ahead - moved;
        let sign = if b == 0.0 { 0.0 } else { b.signum() };
        if !self.implicit {
            let u = self.velocity - lambda * b.abs().sqrt() * sign;
            self.velocity -= alpha * sign;
            self.ahead = b + u;
            return u;
        }
        let mut e = 0.0;
        if b.abs() <= alpha {
            self.velocity -= b;
        } else {
            let root = (lambda * lambda / 4.0 + b.abs() - alpha).sqrt() - lambda / 2.0;
            e = root * root * sign;
            self.velocity -= alpha * sign;
        }
        self.ahead = e + self.velocity;
        self.velocity
    }
}

/// First-order adaptive windowing in one pass: the bounds of the slope as they narrow.
struct Adaptive {
    best: bool,
    window: usize,
    noise: f64,
    past: [f64; 64],
    newest: usize,
}

impl Filter for Adaptive {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        self.newest = (self.newest + 1) % 64;
        self.past[self.newest] = moved;
        let (mut low, mut high, mut velocity) = (f64::NEG_INFINITY, f64::INFINITY, 0.0);
        let (mut s, mut sum, mut moment) = (0.0, 0.0, 0.0);
        for age in 0..self.window {
            let i = (age + 1) as f64;
            s += self.past[(self.newest + 64 - age) % 64];
            let slope = if self.best {
                sum += s;
                moment += i * s;
                (2.0 * moment - i * sum) / (i * (i + 1.0) * (i + 2.0) / 6.0)
            } else {
                s / i
            };
            if slope < low || slope > high {
                break;
            }
            velocity = slope;
            low = low.max((s - self.noise) / i);
            high = high.min((s + self.noise) / i);
        }
        velocity
    }
}

/// Million samples per second of the plain loop.
fn plain_throughput(settings: &VelocitySettings, prepared: &PreparedScene) -> f64 {
    let began = Instant::now();
    let runs = 4;
    for n in 0..runs {
        let (k, b) = (black_box(60_000.0 + 50.0 * f64::from(n)), black_box(300.0));
        let kalman = |gains: Result<KalmanDesign, _>| Kalman {
            gains: gains.unwrap(),
            distance: 0.0,
            velocity: 0.0,
            acceleration: 0.0,
        };
        let design = prepared.design();
        black_box(match *settings {
            VelocitySettings::Kalman2 { acceleration_rms_m_per_s2 } => {
                plain(kalman(KalmanDesign::two_states(acceleration_rms_m_per_s2, design)), k, b)
            }
            VelocitySettings::Kalman3 { jerk_rms_m_per_s3 } => {
                plain(kalman(KalmanDesign::three_states(jerk_rms_m_per_s3, design)), k, b)
            }
            VelocitySettings::TrackingLoop { .. } => {
                let gains = TrackingLoop::new(1500.0, design.rate_hz).unwrap();
                plain(Tracking { gains, error: 0.0, velocity: 0.0 }, k, b)
            }
            VelocitySettings::FoawEnd { window_samples, noise_counts: noise }
            | VelocitySettings::FoawBest { window_samples, noise_counts: noise } => {
                let best = matches!(settings, VelocitySettings::FoawBest { .. });
                let window = window_samples as usize;
                plain(Adaptive { best, window, noise, past: [0.0; 64], newest: 0 }, k, b)
            }
            VelocitySettings::LevantExplicit { acceleration_max_m_per_s2: c, lambda_ratio }
            | VelocitySettings::LevantImplicit { acceleration_max_m_per_s2: c, lambda_ratio } => {
                let implicit = matches!(settings, VelocitySettings::LevantImplicit { .. });
                let sizes = LevantDesign::new(c, lambda_ratio, design).unwrap();
                plain(Levant { implicit, sizes, ahead: 0.0, velocity: 0.0 }, k, b)
            }
            VelocitySettings::Difference {} => plain(|moved: f64| moved, k, b),
            VelocitySettings::FirstOrder { .. } | VelocitySettings::FirstOrderPrewarped { .. } => {
                let FirstOrder { b0, a1 } = FirstOrder::new(1500.0, 1e4, false).unwrap();
                let (mut x1, mut y1) = (0.0, 0.0);
                let filter = |moved: f64| {
                    (y1, x1) = (b0 * (moved + x1) - a1 * y1, moved);
                    y1
                };
                plain(filter, k, b)
            }
            _ => match settings.weights(design).unwrap() {
                Some(fir) => {
                    let weights = fir.weights().to_vec();
                    plain(Sum { weights, past: [0.0; 64], newest: 0 }, k, b)
                }
                None => plain(Butterworth::default(), k, b),
            },
        });
    }
    f64::from(runs) * SAMPLES as f64 / began.elapsed().as_secs_f64() / 1e6
}

/// The undisturbed one.
fn best(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn main() {
    if std::env::args().any(|argument| argument == "--test") {
        return; // `cargo test --benches` only wants to know that it starts
    }
    let scalar = std::env::args().any(|argument| argument == "--core");
    let only: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let mut scene = NamedScene::load("paper-1um").unwrap().scene;
    scene.sweep.cutoffs_hz = vec![1500.0]; // every estimator takes it
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
        let scene = Scene { velocity: settings.into(), ..scene.clone() };
        if scene.check().is_err() {
            continue; // a sense that the scene has not
        }
        let prepared = PreparedScene::new(&scene).unwrap();
        if !scalar && !host_sim::engine::lanes_for(&prepared, Numeric::Fixed) {
            continue;
        }
        let mut speeds = vec![vec![]; engines.len()];
        let mut yardstick = vec![];
        for _ in 0..ROUNDS {
            yardstick.push(plain_throughput(&settings, &prepared));
            for (engine, speeds) in engines.iter().zip(&mut speeds) {
                // the scalar loop is slow, and needs fewer hits for the same precision
                let hits = if *engine == Engine::Core { HITS / 8 } else { HITS };
                speeds.push(throughput(&prepared, *engine, hits));
            }
        }
        let loops = best(&yardstick);
        let speeds = speeds.iter().map(|speeds| best(speeds));
        let cells: Vec<String> = speeds.map(|s| format!("{s:.0},{:.1}", s / loops)).collect();
        println!("{},{loops:.0},{}", name.text(), cells.join(","));
    }
}
