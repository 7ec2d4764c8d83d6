//! The equations of each estimator that has lanes, for the plain loop.

use std::{f64::consts::PI, sync::LazyLock};

use host_sim::{
    scene::Accelerometer,
    simulation::twin::{self, Equation, Foaw, LowPass},
};
use zwidth::{
    Design, VelocitySettings,
    velocity::{KalmanDesign, LevantDesign, ObserverDesign, TrackingLoop},
};

use crate::plain::{Butterworth, Filter, SAMPLES, plain};

/// A Kalman filter with two or three states.
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

/// A weighted sum of the last differences of the count. The first weight belongs to the newest difference.
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

/// The tracking loop. The estimator `smoothing` uses the same loop.
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
        let before = self.velocity;
        self.velocity += self.gains.ki * e;
        self.velocity + self.gains.lead * (self.velocity - before)
    }
}

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

/// First-order adaptive windowing in one pass. Each older sample makes the bounds of the slope narrower.
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

#[derive(Default)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
    x: [f64; 2],
    y: [f64; 2],
}

impl From<LowPass> for Section {
    fn from(LowPass { b, a, .. }: LowPass) -> Self {
        Self { b, a, ..Self::default() }
    }
}

impl Filter for Section {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        let (Self { b: [b0, b1, b2], a: [a1, a2], .. }, [x1, x2], [y1, y2]) =
            (&*self, self.x, self.y);
        let y = b0 * moved + b1 * x1 + b2 * x2 - a1 * y1 - a2 * y2;
        (self.x, self.y) = ([moved, x1], [y, y1]);
        y
    }
}

/// The observer with the motor's force as its input.
struct Observer {
    design: ObserverDesign,
    known: f64,
    error: f64,
    velocity: f64,
    disturbance: f64,
}

impl Filter for Observer {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        let [l1, l2, l3] = self.design.gains;
        let acceleration = self.known + self.disturbance;
        let e = self.error + moved - self.velocity - 0.5 * acceleration;
        self.error = e - l1 * e;
        self.velocity += acceleration + l2 * e;
        self.disturbance += l3 * e;
        self.velocity
    }

    #[inline(always)]
    fn granted(&mut self, force: f64) {
        self.known = force * self.design.per_full_scale;
    }
}

/// The accelerometer of docs/data/paper-1um-accelerometer.toml. The estimator `fusion` needs it.
pub const ACCELEROMETER: Accelerometer = Accelerometer {
    full_scale_m_per_s2: 157.0,
    resolution_m_per_s2: 0.04,
    noise_m_per_s2_per_sqrt_hz: 3e-3,
    bias_m_per_s2: 0.5,
    bandwidth_hz: Some(1600.0),
};

/// Noise of the accelerometer over a hit, with RMS 1. The noise is computed once, as for the lanes.
static NOISE: LazyLock<Vec<f64>> =
    LazyLock::new(|| (0..SAMPLES).map(|n| 2f64.sqrt() * (n as f64 * n as f64).sin()).collect());

/// The observer with the acceleration as its input, in counts and samples.
struct Fusion {
    observer: Observer,
    per_speed: f64,
    follows: f64,
    noise: f64,
    bias: f64,
    full_scale: f64,
    resolution: f64,
    speed: f64,
    filtered: f64,
    readings: std::slice::Iter<'static, f64>,
}

impl Fusion {
    fn new(observer: Observer, design: &Design) -> Self {
        let Accelerometer {
            full_scale_m_per_s2,
            resolution_m_per_s2,
            noise_m_per_s2_per_sqrt_hz,
            bias_m_per_s2,
            bandwidth_hz,
        } = ACCELEROMETER;
        let rate_hz = design.rate_hz;
        let per_speed = 1.0 / (design.resolution_m * rate_hz);
        let unit = per_speed / rate_hz;
        Self {
            observer,
            per_speed,
            follows: 1.0 - (-2.0 * PI * bandwidth_hz.unwrap() / rate_hz).exp(),
            noise: noise_m_per_s2_per_sqrt_hz * (0.5 * rate_hz).sqrt() * unit,
            bias: bias_m_per_s2 * unit,
            full_scale: full_scale_m_per_s2 * unit,
            resolution: resolution_m_per_s2 * unit,
            speed: 0.0,
            filtered: 0.0,
            readings: NOISE.iter(),
        }
    }
}

impl Filter for Fusion {
    #[inline(always)]
    fn look(&mut self, speed: f64) {
        let speed = speed * self.per_speed;
        self.filtered += self.follows * (speed - self.speed - self.filtered);
        self.speed = speed;
        let noise = self.noise * self.readings.next().unwrap();
        let reading = self.filtered + noise + self.bias;
        let steps = reading.clamp(-self.full_scale, self.full_scale) / self.resolution;
        self.observer.known = (steps + 0.5f64.copysign(steps)) as i64 as f64 * self.resolution;
    }

    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        self.observer.update(moved)
    }
}

/// The mean of the count's differences in a window: their sum divided by the window's length.
struct Window {
    past: [f64; 256],
    newest: usize,
    window: usize,
    sum: f64,
}

impl Filter for Window {
    #[inline(always)]
    fn update(&mut self, moved: f64) -> f64 {
        self.newest = (self.newest + 1) % 256;
        self.sum += moved - self.past[(self.newest + 256 - self.window) % 256];
        self.past[self.newest] = moved;
        self.sum / self.window as f64
    }
}

/// A wall hit with the estimator of `settings`.
pub fn plain_hit(settings: &VelocitySettings, design: &Design, [k, b]: [f64; 2]) -> f64 {
    type V = VelocitySettings;
    let observer = |design| {
        let (known, error, velocity, disturbance) = (0.0, 0.0, 0.0, 0.0);
        Observer { design, known, error, velocity, disturbance }
    };
    match Equation::of(settings, design).unwrap() {
        Equation::LowPass(LowPass { order: 0, .. }) => plain(|moved: f64| moved, k, b),
        Equation::LowPass(LowPass { order: 1, b: [b0, ..], a: [a1, _] }) => {
            let (mut x1, mut y1) = (0.0, 0.0);
            let filter = |moved: f64| {
                (y1, x1) = (b0 * (moved + x1) - a1 * y1, moved);
                y1
            };
            plain(filter, k, b)
        }
        Equation::LowPass(_) if matches!(settings, V::Butterworth { .. }) => {
            plain(Butterworth::default(), k, b)
        }
        Equation::LowPass(section) => plain(Section::from(section), k, b),
        Equation::Cascade(sections) => {
            let [mut first, mut second] = sections.map(Section::from);
            plain(move |moved: f64| second.update(first.update(moved)), k, b)
        }
        Equation::Kalman(gains) => {
            plain(Kalman { gains, distance: 0.0, velocity: 0.0, acceleration: 0.0 }, k, b)
        }
        Equation::Tracking(gains) => plain(Tracking { gains, error: 0.0, velocity: 0.0 }, k, b),
        Equation::Observer(design) => plain(observer(design), k, b),
        Equation::Fusion(of) => plain(Fusion::new(observer(of), design), k, b),
        Equation::Foaw(Foaw { best, window, noise }) => {
            let (window, past) = (window as usize, [0.0; 64]);
            plain(Adaptive { best, window, noise, past, newest: 0 }, k, b)
        }
        Equation::Levant(twin::Levant { implicit, sizes }) => {
            plain(Levant { implicit, sizes, ahead: 0.0, velocity: 0.0 }, k, b)
        }
        Equation::Ends(samples) => {
            let (window, past) = (samples as usize, [0.0; 256]);
            plain(Window { past, newest: 0, window, sum: 0.0 }, k, b)
        }
        Equation::Sum(fir) => {
            let weights = fir.weights().to_vec();
            plain(Sum { weights, past: [0.0; 64], newest: 0 }, k, b)
        }
        Equation::TimeStamps(_) => unreachable!("it has no lanes"),
    }
}
