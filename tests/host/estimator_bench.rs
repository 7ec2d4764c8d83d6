//! Functions for the tests of the estimators. They give the design, and motions as encoder and ideal sensors measure
//! them. Core and twin get the same motions.

use std::f64::consts::PI;

use host_sim::{
    analysis::linear::{TransferFunction, transfer_function},
    simulation::{edge::last_edge, twin::TwinEstimator},
};
use proptest::prelude::*;
use zwidth::{
    Design, Output, VelocitySettings,
    units::{Acceleration, Force, Position, Velocity},
    velocity::{Edge, Estimator, Senses, State},
};

pub const DESIGN: Design = Design {
    rate_hz: 1e4,
    resolution_m: 1e-6,
    full_scale_n: 5.906,
    period: 10,
    output: Output::Continuous,
};
/// Number of LSB of the velocity in one count per sample.
pub const LSB: f64 = 65_536.0;

/// A running estimator. Its counts may wrap.
pub struct Run {
    estimator: Estimator,
    state: State,
}

impl Run {
    pub fn new(settings: &VelocitySettings, count: i32) -> Self {
        let estimator = settings.build(&DESIGN).unwrap();
        Self { estimator, state: State::at_rest(Position::from_counts(count)) }
    }

    /// Velocity after this count, in counts per sample.
    pub fn at(&mut self, count: i64) -> f64 {
        let position = Position::from_counts(count as i32);
        let velocity = self.estimator.update(&mut self.state, position, &Senses::default());
        f64::from(velocity.bits()) / LSB
    }
}

/// Response of a linear estimator to one count in the position, in counts per sample.
pub fn response_to_a_position(settings: &VelocitySettings) -> Vec<f64> {
    response_of(&transfer_function(settings, &DESIGN).unwrap().unwrap())
}

/// Response of a transfer function from position to velocity.
pub fn response_of(TransferFunction { num, den }: &TransferFunction) -> Vec<f64> {
    let mut response: Vec<f64> = Vec::new();
    for n in 0..20_000 {
        let past: f64 = (1..den.len().min(n + 1)).map(|k| den[k] * response[n - k]).sum();
        response.push(num.get(n).copied().unwrap_or(0.0) / DESIGN.rate_hz - past);
    }
    response
}

/// Speeds for the tests, in counts per sample and in both directions. They are whole numbers, and fractions near simple
/// ones and far from them.
pub fn speeds() -> Vec<f64> {
    let mut speeds = vec![0.0, 1.0, -1.0, 7.0, 300.0, -32_766.0, 32_767.0];
    speeds.extend((1..60).map(|n| f64::from(n) * 0.037_12 * if n % 2 == 0 { 1.0 } else { -1.0 }));
    speeds.extend([0.5, 1.0 / 3.0, -0.2, 0.001, 0.01, 10.01, 511.503, 32_700.4]);
    speeds
}

/// Delay of the estimate in a chirp, in samples. It is the shift of the true velocity that fits the estimate best.
pub fn delay_over_a_chirp(
    settings: &VelocitySettings,
    amplitude: f64,
    from_hz: f64,
    to_hz: f64,
) -> f64 {
    let seconds = 20.0;
    let rate = (to_hz - from_hz) / seconds;
    let phase = |t: f64| 2.0 * PI * (from_hz * t + rate * t * t / 2.0);
    let position = |n: f64| amplitude * phase(n / DESIGN.rate_hz).sin();
    let velocity = |n: f64| (position(n + 0.01) - position(n - 0.01)) / 0.02;
    let mut run = Run::new(settings, 0);
    let samples = (seconds * DESIGN.rate_hz) as usize;
    let measured: Vec<f64> =
        (0..samples).map(|n| run.at(position(n as f64).floor() as i64)).collect();
    let skip = 20_000;
    let mut delay = 0.0;
    for _ in 0..5 {
        let (mut error, mut slope) = (0.0, 0.0);
        for (n, measured) in measured.iter().enumerate().skip(skip) {
            let at = n as f64 - delay;
            let acceleration = velocity(at + 0.5) - velocity(at - 0.5);
            error += (measured - velocity(at)) * acceleration;
            slope += acceleration * acceleration;
        }
        delay -= error / slope;
    }
    delay
}

/// Uniform random numbers from -1 to 1.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / (1u64 << 30) as f64 - 1.0
    }
}

/// Largest difference between core and twin in 20 random motions, and the largest speed, both in LSB. `push` is the
/// largest change of speed in one sample, in counts per sample^2.
pub fn twin_over_random_motion(settings: &VelocitySettings, push: f64) -> (f64, f64) {
    let (mut worst, mut fastest) = (0f64, 0f64);
    for seed in 1..=20 {
        let mut run = Run::new(settings, 0);
        let mut twin = TwinEstimator::new(settings, &DESIGN).unwrap();
        let mut random = Random(seed);
        let (mut position, mut speed, mut pushed, mut count) = (0.0, 0.0, 0.0, 0i64);
        for n in 0..20_000 {
            if n % 100 == 0 {
                pushed = if n % 700 == 0 { 0.0 } else { push * random.next() };
            }
            speed = 0.999 * speed + pushed;
            position += speed;
            let now = f64::floor(position) as i64;
            let exact = twin.update((now - count) as i32, &Senses::default());
            count = now;
            worst = worst.max((run.at(now) - exact).abs() * LSB);
            fastest = fastest.max(exact.abs() * LSB);
        }
    }
    (worst, fastest)
}

/// The pieces of a motion. Each has a step of the count, the number of times that the step comes, and whether its sign
/// changes with every sample.
pub type Pieces = Vec<(i32, usize, bool)>;

/// Draws the pieces of a motion. They are standstill, slow and fast motion, and jumps to the ends of the range.
pub fn pieces() -> impl Strategy<Value = Pieces> {
    let step = prop_oneof![
        Just(0),
        Just(1),
        Just(-1),
        Just(32_767),
        Just(-32_767),
        Just(i32::MIN),
        Just(i32::MAX),
        -300..300i32,
        any::<i32>()
    ];
    prop::collection::vec((step, 1..300usize, any::<bool>()), 1..12)
}

/// Moves by these pieces from `start`, with every speed in range. Then stands still for `wait` samples. Returns the
/// largest speed in the next 100 samples, in counts per sample.
pub fn rest_after(settings: &VelocitySettings, start: i32, pieces: &Pieces, wait: usize) -> f64 {
    let mut run = Run::new(settings, start);
    let mut count = i64::from(start);
    for &(step, samples, reverses) in pieces {
        for n in 0..samples {
            count += i64::from(if reverses && n % 2 == 1 { step.wrapping_neg() } else { step });
            let velocity = run.at(count);
            assert!(velocity.abs() <= f64::from(Velocity::LIMIT), "{settings:?}: {velocity}");
        }
    }
    for _ in 0..wait {
        run.at(count);
    }
    (0..100).map(|_| run.at(count).abs()).fold(0.0, f64::max)
}

/// A motion that the encoder and an ideal accelerometer measure, sample by sample.
pub struct Motion<F> {
    /// Position in counts, as a function of the time in samples.
    pub at: F,
    pub state: State,
    pub estimator: Estimator,
    twin: TwinEstimator,
    pub sample: i64,
    count: i32,
    edge: Option<Edge>,
}

/// Values of one sample for core and twin, in counts per sample.
pub struct Seen {
    pub core: f64,
    pub twin: f64,
}

impl<F: Fn(f64) -> f64> Motion<F> {
    pub fn new(settings: VelocitySettings, at: F) -> Self {
        let count = at(0.0).floor() as i32;
        Self {
            at,
            state: State::at_rest(Position::from_counts(count)),
            estimator: settings.build(&DESIGN).unwrap(),
            twin: TwinEstimator::new(&settings, &DESIGN).unwrap(),
            sample: 0,
            count,
            edge: None,
        }
    }

    /// Speed at time `t`. It is computed from the positions a thousandth of a sample before and after `t`.
    pub fn speed(&self, t: f64) -> f64 {
        const H: f64 = 1e-3;
        ((self.at)(t + H) - (self.at)(t - H)) / (2.0 * H)
    }

    pub fn next(&mut self, force: Force) -> Seen {
        let (t0, t1) = (self.sample as f64, (self.sample + 1) as f64);
        self.sample += 1;
        let ends = [t0, t1].map(|t| [(self.at)(t), self.speed(t)]);
        self.edge = match last_edge(ends[0], ends[1]) {
            Some((at, up)) => Some(Edge { age: ((1.0 - at) * LSB) as u32, up }),
            None => self.edge.map(|e| Edge { age: e.age.saturating_add(Edge::SAMPLE), ..e }),
        };
        let acceleration = (ends[1][1] - ends[0][1]) * f64::from(1 << 24);
        let senses = Senses {
            force,
            acceleration: Acceleration::saturating_from_bits(acceleration.round() as i32),
            edge: self.edge,
        };
        let count = ends[1][0].floor() as i64 as i32; // wraps like the counter
        let difference = count.wrapping_sub(self.count);
        self.count = count;
        let core = self.estimator.update(&mut self.state, Position::from_counts(count), &senses);
        let twin = self.twin.update(difference, &senses);
        Seen { core: f64::from(core.bits()) / LSB, twin }
    }

    pub fn free(&mut self) -> Seen {
        self.next(Force::ZERO)
    }
}

/// Checks that the velocity is 0 in every sample from `wait` samples after a stop on.
pub fn reads_zero_after_a_stop(settings: &VelocitySettings, wait: i64) {
    let mut motion = Motion::new(*settings, |t| 3.7 * t.min(500.0) + 0.5);
    for _ in 0..500 + wait {
        motion.free();
    }
    for _ in 0..100 {
        assert_eq!(motion.free().core, 0.0, "{settings:?}");
    }
}

/// Moves along a sum of sines under random forces. Returns the largest difference between core and twin, and the
/// largest speed, both in LSB.
pub fn twin_is_off_by(settings: &VelocitySettings, steps: &[(f64, f64)], speed: f64) -> (f64, f64) {
    let at = |t: f64| {
        let mut x = 0.3;
        for (n, (amplitude, phase)) in steps.iter().enumerate() {
            let w = 0.001 * 1.4f64.powi(n as i32);
            x += speed * amplitude / w.max(0.01) / 20.0 * (w * t + 6.0 * phase).sin();
        }
        x
    };
    let mut motion = Motion::new(*settings, at);
    let (mut worst, mut fastest) = (0.0f64, 0.0f64);
    for n in 0..3000usize {
        let (_, force) = steps[n / 10 % steps.len()];
        let force = Force::saturating_from_bits((force * f64::from(1 << 30)) as i32);
        let seen = motion.next(force);
        worst = worst.max((seen.core - seen.twin).abs() * LSB);
        fastest = fastest.max(seen.twin.abs() * LSB);
    }
    (worst, fastest)
}

/// Amplitudes and phases for [`twin_is_off_by`].
pub fn sines() -> impl Strategy<Value = Vec<(f64, f64)>> {
    prop::collection::vec((-2.0..2.0f64, -1.0..1.0f64), 20)
}

/// Inputs without physical meaning, with counts that jump by any amount.
#[derive(Clone, Debug)]
pub struct Nonsense {
    jumps: Vec<i32>,
    senses: Vec<(i32, i32, u32, bool, u8)>,
    /// Number of samples for which a jump is repeated.
    held: usize,
}

pub fn nonsense() -> impl Strategy<Value = Nonsense> {
    let jump = prop_oneof![any::<i32>(), -3..4i32, Just(32_767), Just(-32_767), Just(0)];
    let sense = (any::<i32>(), any::<i32>(), any::<u32>(), any::<bool>(), 0..4u8);
    let parts =
        (prop::collection::vec(jump, 1..400), prop::collection::vec(sense, 1..400), 1..200usize);
    parts.prop_map(|(jumps, senses, held)| Nonsense { jumps, senses, held })
}

/// Checks that every speed is in range. Returns the last speed, after the handle has been still for `wait` samples
/// without other inputs.
pub fn after_nonsense(settings: &VelocitySettings, nonsense: &Nonsense, wait: i64) -> Velocity {
    let estimator = settings.build(&DESIGN).unwrap();
    let mut count = i32::MAX - 5;
    let mut state = State::at_rest(Position::from_counts(count));
    for n in 0..2000 {
        count = count.wrapping_add(nonsense.jumps[n / nonsense.held % nonsense.jumps.len()]);
        let (force, acceleration, age, up, kind) = nonsense.senses[n % nonsense.senses.len()];
        let senses = Senses {
            force: Force::saturating_from_bits(force),
            acceleration: Acceleration::saturating_from_bits(acceleration),
            edge: match kind {
                0 => None,
                1 => Some(Edge { age, up }),
                2 => Some(Edge { age: age % Edge::SAMPLE, up }),
                _ => Some(Edge { age: 0, up }),
            },
        };
        let velocity = estimator.update(&mut state, Position::from_counts(count), &senses);
        assert!(velocity.bits().abs() <= Velocity::LIMIT << 16, "{settings:?}");
    }
    let mut last = Velocity::ZERO;
    for n in 0..wait {
        let age = Edge::SAMPLE.saturating_mul(n as u32 + 1);
        let senses = Senses { edge: Some(Edge { age, up: true }), ..Senses::NONE };
        last = estimator.update(&mut state, Position::from_counts(count), &senses);
    }
    last
}

/// Runs a wall hit through the whole program, with scene, inputs, core and twin. `[velocity]` of the scene has these
/// lines. On the way to the wall, the estimate must be the handle's speed. Core and twin must go equally deep.
pub fn hits_a_wall_like_its_twin(velocity: &str, cutoff_hz: f64, table: &str) {
    use host_sim::{
        scene::NamedScene,
        simulation::prepared::{Numeric, PreparedScene, WallHit},
    };
    let built_in = host_sim::scene::BUILT_IN[0].1;
    let usual = "estimator = \"butterworth\"\nprewarp = false";
    assert!(built_in.contains(usual));
    // A tuning that is in the range of all estimators.
    let list = built_in.lines().find(|line| line.starts_with("cutoffs_hz")).unwrap();
    let text = built_in.replace(usual, velocity).replace(list, "cutoffs_hz = [100, 300, 1000]");
    let scene = NamedScene::parse("x".into(), text + table, "x").unwrap().scene;
    let prepared = PreparedScene::new(&scene).unwrap();
    let hit = WallHit {
        velocity: scene.velocity.at(cutoff_hz),
        stiffness_n_per_m: 10_000.0,
        damping_n_s_per_m: 50.0,
        start_offset_counts: 0.0,
    };
    let reports = [Numeric::Fixed, Numeric::F64].map(|numeric| {
        let (mut worst, mut fastest, mut before) = (0.0f64, 0.0f64, None::<f64>);
        let report = prepared
            .hit(numeric, &hit, |sample| {
                // On the way to the wall: compares the estimate with the handle's speed.
                if (1000..2500).contains(&sample.index)
                    && sample.position_m < scene.wall.position_m
                    && let Some(before) = before
                {
                    let speed = (sample.position_m - before) / DESIGN.resolution_m;
                    worst = worst.max((sample.velocity - speed).abs());
                    fastest = fastest.max(speed);
                }
                before = Some(sample.position_m);
            })
            .unwrap();
        println!("{velocity}: off by {worst} of {fastest} counts per sample, {report:?}");
        assert!(fastest > 30.0 && worst < 0.7, "{velocity}: {worst} of {fastest}");
        report
    });
    assert!(reports[0].is_stable() && reports[1].is_stable(), "{velocity}: {reports:?}");
    let off = (reports[0].peak_penetration_m - reports[1].peak_penetration_m).abs();
    assert!(off < 0.05 * reports[1].peak_penetration_m, "{velocity}: {reports:?}");
}
