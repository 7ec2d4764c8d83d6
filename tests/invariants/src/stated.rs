//! A second implementation of the statements of docs/estimators.md. Sums of differences follow from their weights. The
//! other estimators follow from the equations at the beginning of that page's sections.

use std::f64::consts::{PI, SQRT_2};

use zwidth::{
    Design, VelocitySettings,
    units::{Acceleration, Force},
    velocity::Senses,
};

/// Number of LSB of the velocity in one count per sample.
pub const LSB: f64 = 65_536.0;

/// What docs/estimators.md states about an estimator on a device. The values are in counts and samples.
#[derive(Clone, Debug)]
pub struct Stated {
    /// Largest error at a constant speed.
    pub error: f64,
    /// Largest error at a speed of whole counts per sample.
    pub whole: f64,
    /// Whether an error is stated for these settings.
    pub holds: bool,
    /// Number of samples after which a change of speed by one count per sample has settled. The second value is added
    /// for each further count per sample.
    pub settles: [f64; 2],
    /// How the first velocity after a restart depends on the difference between the next counts and the old velocity.
    pub first: First,
    /// The estimator in `f64`, if it is linear.
    pub twin: Twin,
    /// Limits of a filter that may resonate.
    pub resonance: Option<Resonance>,
}

/// Upper limits for the effects of a resonance. They follow from the magnitudes of responses.
#[derive(Clone, Copy, Debug)]
pub struct Resonance {
    /// Largest rounding error of the velocity, in LSB. It is half an LSB times the response `(1 - q)^k / A` of the
    /// error feedback.
    pub rounding: f64,
    /// Largest error from the rounding of the coefficients, as a fraction of the fastest difference.
    pub coefficients: f64,
    /// Largest gain from input to output.
    pub gain: f64,
    /// Largest gain from the input to the last section. It is 0 if there is only one section. With a large gain, a
    /// value before the last section may saturate although the output is in range.
    pub inside: f64,
}

/// Product of two polynomials.
fn product(p: &[f64], q: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; p.len() + q.len() - 1];
    for (n, a) in p.iter().enumerate() {
        for (m, b) in q.iter().enumerate() {
            product[n + m] += a * b;
        }
    }
    product
}

impl Resonance {
    /// Limits of a biquad with these coefficients. `order` is the order of its error feedback.
    fn of(b: &[f64], a: &[f64], order: u32, samples: f64) -> Self {
        let (mut past, mut poles, mut shaped) = ([0.0; 2], 0.0, 0.0);
        let mut last = [0.0; 2];
        for n in 0..samples.min(60_000.0) as usize {
            let now = f64::from(n == 0) - a[0] * past[0] - a[1] * past[1];
            let second = now - 2.0 * last[0] + last[1];
            shaped += if order == 1 { (now - last[0]).abs() } else { second.abs() };
            poles += f64::abs(now);
            (last, past) = ([now, last[0]], [now, past[0]]);
        }
        // The velocity is at most the differences times the response of the poles and the magnitudes of the numerator.
        let gain: f64 = poles * b.iter().map(|b| b.abs()).sum::<f64>();
        let coefficients = poles * (3.0 + 2.0 * gain) * 2f64.powi(-30);
        Self { rounding: 0.5 * shaped + 1.0, coefficients, gain, inside: 0.0 }
    }

    /// The limits of this section followed by a second one. The second section makes the errors of the first larger.
    fn then(self, next: Self) -> Self {
        Self {
            rounding: self.rounding * next.gain + next.rounding,
            coefficients: self.coefficients * next.gain + next.coefficients * self.gain,
            gain: self.gain * next.gain,
            inside: self.inside.max(self.gain),
        }
    }
}

/// A linear estimator in `f64`, from its equations.
#[derive(Clone, Debug)]
pub enum Twin {
    None,
    /// A filter after the difference, with its coefficients b and a.
    Filter(Vec<f64>, Vec<f64>),
    /// An observer with its gains for position, velocity and acceleration. The last value says how it knows an
    /// acceleration.
    Observer([f64; 3], Option<First>),
}

impl Twin {
    /// The velocities for these counts, if the estimator starts at rest at count 0. Without `senses` no acceleration is
    /// known.
    pub fn run(&self, counts: &[i64], senses: &[Senses]) -> Vec<f64> {
        match self {
            Self::None => Vec::new(),
            Self::Filter(b, a) => {
                let mut velocities: Vec<f64> = Vec::new();
                let at = |n: usize| if n == 0 { 0.0 } else { counts[n - 1] as f64 };
                for n in 0..counts.len() {
                    let sum: f64 =
                        (0..b.len().min(n + 1)).map(|k| b[k] * (at(n + 1 - k) - at(n - k))).sum();
                    let past: f64 =
                        (1..=a.len().min(n)).map(|k| a[k - 1] * velocities[n - k]).sum();
                    velocities.push(sum - past);
                }
                velocities
            }
            Self::Observer([alpha, beta, gamma], known) => {
                let (mut x, mut v, mut rest) = (0.0, 0.0, 0.0);
                let step = |(n, count): (usize, &i64)| {
                    let known = known.zip(senses.get(n));
                    let a: f64 =
                        rest + known.map_or(0.0, |(first, senses)| first.acceleration(senses));
                    let ahead: f64 = x + v + a / 2.0;
                    let e = *count as f64 - ahead;
                    x = ahead + alpha * e;
                    v += a + beta * e;
                    rest += gamma * e;
                    v
                };
                counts.iter().enumerate().map(step).collect()
            }
        }
    }

    /// Largest difference between the integer estimator and its equations, in LSB, at speeds up to `fastest`. The
    /// causes are rounding, and rounded coefficients.
    pub fn lsb(&self, fastest: f64) -> f64 {
        match self {
            Self::Filter(b, _) => 3.0 + fastest * 3.0 * 2f64.powi(-31) / b.iter().sum::<f64>(),
            _ => 2.0 + fastest * 1e-9,
        }
    }
}

/// How the first velocity after a restart depends on the counts.
#[derive(Clone, Copy, Debug)]
pub enum First {
    /// The velocity changes by this fraction of the difference. The second value is the most that may be added.
    Part(f64, f64),
    /// The velocity changes by this value times the square root of the difference.
    Root(f64),
    /// The velocity changes by the difference, but by no more than this value.
    Bounded(f64),
    /// Half of the known acceleration is first subtracted from the difference. The velocity then changes by a fraction
    /// of the result, which is the first value. The second value is the acceleration at full-scale force, or `None` if
    /// the acceleration is measured.
    Known(f64, Option<f64>),
    /// The velocity is a mean over this time, or the limit that follows from one count since the last edge.
    Mean(f64),
}

impl First {
    fn acceleration(&self, senses: &Senses) -> f64 {
        match self {
            Self::Known(_, Some(full_scale)) => {
                full_scale * f64::from(senses.force.bits()) / f64::from(Force::FULL_SCALE.bits())
            }
            Self::Known(_, None) => {
                f64::from(senses.acceleration.bits()) / f64::from(1 << Acceleration::FRACTION_BITS)
            }
            _ => 0.0,
        }
    }
}

impl Stated {
    pub fn lsb(&self, fastest: f64) -> f64 {
        match self.resonance {
            Some(Resonance { rounding, coefficients, .. }) => rounding + fastest * coefficients,
            None => self.twin.lsb(fastest),
        }
    }

    /// Largest jump of the velocity in the first sample after a restart at `velocity`. The jump includes 2 LSB and
    /// 2^-30 of the difference for rounding.
    pub fn jump(&self, velocity: f64, counts: f64, senses: &Senses) -> f64 {
        let off = (counts - velocity).abs();
        let rounding = 2.0 / LSB + off * 2f64.powi(-30);
        rounding
            + match self.first {
                First::Part(part, beside) => part * off + beside,
                First::Root(lambda) => lambda * off.sqrt(),
                First::Bounded(most) => off.min(most),
                First::Known(part, _) => {
                    let known = self.first.acceleration(senses).abs();
                    part * (off + known / 2.0) + known
                }
                First::Mean(span) => off.max((off + 2.0) / (span - 0.5)),
            }
    }
}

/// Sums the magnitudes of the first `samples` samples of the response to a position. Returns half of the sum.
fn ripple(twin: &Twin, samples: f64) -> f64 {
    let mut counts = vec![0; samples.min(60_000.0) as usize];
    counts[0] = 1;
    twin.run(&counts, &[]).iter().map(|v| 0.5 * v.abs()).sum()
}

/// `u` of the Kalman filters, by the documentation's equation: `2 u^2 = L (1 - u)` or `2 u^3 = L (1 - u) (2 - u)`.
fn kalman_u(ratio: f64, states: i32) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let u: f64 = (low + high) / 2.0;
        let right = if states == 2 { ratio * (1.0 - u) } else { ratio * (1.0 - u) * (2.0 - u) };
        if 2.0 * u.powi(states) < right { low = u } else { high = u }
    }
    (low + high) / 2.0
}

/// Statements of docs/estimators.md for these settings.
pub fn stated(settings: &VelocitySettings, design: &Design) -> Stated {
    use VelocitySettings as V;
    let exact = |error: f64, lsb: f64, settles: f64, first: First| Stated {
        error: error + lsb / LSB,
        whole: lsb / LSB,
        holds: true,
        settles: [settles, 0.0],
        first,
        twin: Twin::None,
        resonance: None,
    };
    let linear = |twin: Twin, lsb: f64, settles: f64, first: First| {
        let error = ripple(&twin, settles);
        Stated { twin, ..exact(error, lsb, settles, first) }
    };
    if let Some(sum) = settings.weights(design).unwrap() {
        let weights = sum.weights();
        let twin = Twin::Filter(weights.to_vec(), Vec::new());
        let settles = weights.len() as f64 + 1.0;
        let first = First::Part(weights[0].abs(), ripple(&twin, settles));
        return Stated { whole: 0.0, ..linear(twin, 1.0, settles, first) };
    }
    let low_pass = |b: &[f64], a: &[f64], part: f64| {
        let twin = Twin::Filter(b.to_vec(), a.to_vec());
        linear(twin, 2.0, 8.0 / part + 200.0, First::Part(b[0], 0.0))
    };
    let digital = |cutoff_hz: f64, prewarp: bool| {
        let angle = 2.0 * PI * cutoff_hz / design.rate_hz;
        if prewarp { 2.0 * (angle / 2.0).tan() } else { angle }
    };
    let of_second_order = |cutoff_hz: f64, prewarp: bool, quality: f64| {
        let w = digital(cutoff_hz, prewarp);
        let a0 = 4.0 + 2.0 * w / quality + w * w;
        let b = [w * w / a0, 2.0 * w * w / a0, w * w / a0];
        (b, [(2.0 * w * w - 8.0) / a0, (4.0 - 2.0 * w / quality + w * w) / a0])
    };
    let second_order = |cutoff_hz: f64, prewarp: bool, quality: f64| {
        let (b, a) = of_second_order(cutoff_hz, prewarp, quality);
        // The slower of two real poles, or the decay of the ringing.
        let slowest = (quality * SQRT_2).min(1.0 / (quality * SQRT_2));
        low_pass(&b, &a, slowest * cutoff_hz / design.rate_hz)
    };
    let butterworth =
        |cutoff_hz: f64, prewarp: bool| second_order(cutoff_hz, prewarp, 1.0 / SQRT_2);
    let first_order = |cutoff_hz: f64, prewarp: bool| {
        let w = digital(cutoff_hz, prewarp);
        low_pass(
            &[w / (2.0 + w), w / (2.0 + w)],
            &[(w - 2.0) / (w + 2.0)],
            cutoff_hz / design.rate_hz,
        )
    };
    let kalman = |noise: f64, states: i32| {
        let samples = design.rate_hz.powi(states);
        let u = kalman_u(noise / samples / (design.resolution_m / 12f64.sqrt()), states);
        let (alpha, beta) = (u * (2.0 - u), 2.0 * u * u);
        let gamma = if states == 2 { 0.0 } else { beta * beta / (2.0 * alpha) };
        let twin = Twin::Observer([alpha, beta, gamma], None);
        linear(twin, 2.0, 60.0 / u + 200.0, First::Part(beta, 0.0))
    };
    let observer = |bandwidth_hz: f64, full_scale: Option<f64>| {
        let p = (-2.0 * PI * bandwidth_hz / design.rate_hz).exp();
        let gains = [1.0 - p * p * p, 1.5 * (1.0 - p).powi(2) * (1.0 + p), (1.0 - p).powi(3)];
        let first = First::Known(gains[1], full_scale);
        let settles = 12.0 / (bandwidth_hz / design.rate_hz) + 200.0;
        linear(Twin::Observer(gains, Some(first)), 0.0, settles, first)
    };
    let c =
        |acceleration: f64| acceleration / (design.resolution_m * design.rate_hz * design.rate_hz);
    // With a noise limit below one count, quantisation is treated as motion.
    let windowed = |error: f64, window_samples: u32, noise_counts: f64| {
        let window = f64::from(window_samples);
        let error = if noise_counts < 1.0 { 1.0 } else { error / window };
        exact(error, 0.0, window + 1.0, First::Part(1.0, 1.0))
    };
    // A biquad from its physical parameters, after a delay of `late` samples.
    let section = |[frequency_hz, damping, lead_s, zero]: [f64; 4], late: f64| {
        let w = 2.0 * PI * frequency_hz / design.rate_hz;
        let product = (-2.0 * damping * w).exp();
        let apart = (damping * damping - 1.0).abs().sqrt() * w;
        let sum = 2.0 * product.sqrt() * if damping < 1.0 { apart.cos() } else { apart.cosh() };
        // (1 - p)(1 - p'), in a form without cancellation.
        let lost = 1.0 - product.sqrt();
        let s = match damping < 1.0 {
            true => lost * lost + 4.0 * product.sqrt() * (apart / 2.0).sin().powi(2),
            false => lost * lost - 4.0 * product.sqrt() * (apart / 2.0).sinh().powi(2),
        };
        // Delay of the poles, and lead of the second zero.
        let (poles, h) = ((sum - 2.0 * product) / s, zero / (1.0 - zero));
        let g = lead_s * design.rate_hz + late + poles - h;
        let b = [s * (1.0 + g) * (1.0 + h), -s * (g + h + 2.0 * g * h), s * g * h];
        let slowest = damping.min(1.0 / damping).min(1.0 / (2.0 * damping));
        let part = slowest * frequency_hz / design.rate_hz;
        let order = if frequency_hz / design.rate_hz < 0.064 { 2 } else { 1 };
        (b, [-sum, product], part, order)
    };
    let resonant = |sections: &[([f64; 3], [f64; 2], f64, u32)]| {
        let part = sections.iter().map(|(_, _, part, _)| *part).fold(f64::INFINITY, f64::min);
        let numerators = sections.iter().map(|(b, ..)| b.to_vec());
        let denominators = sections.iter().map(|(_, [a1, a2], ..)| vec![1.0, *a1, *a2]);
        let b = numerators.reduce(|p, q| product(&p, &q)).unwrap_or_default();
        let a = denominators.reduce(|p, q| product(&p, &q)).unwrap_or_default();
        let says = low_pass(&b, &a[1..], part);
        let of = |(b, a, _, order): &([f64; 3], [f64; 2], f64, u32)| {
            Resonance::of(b, a, *order, says.settles[0])
        };
        let resonance = sections.iter().map(of).reduce(Resonance::then).expect("a section");
        let more = (resonance.rounding / LSB - says.whole).max(0.0);
        let (error, whole) = (says.error + more, says.whole + more);
        Stated { error, whole, resonance: Some(resonance), ..says }
    };
    match *settings {
        V::Butterworth { cutoff_hz } => butterworth(cutoff_hz, false),
        V::ButterworthPrewarped { cutoff_hz } => butterworth(cutoff_hz, true),
        V::FirstOrder { cutoff_hz } => first_order(cutoff_hz, false),
        V::FirstOrderPrewarped { cutoff_hz } => first_order(cutoff_hz, true),
        // A quality of 2 makes rounding errors larger, like everything else at its resonance.
        V::SecondOrder { cutoff_hz, quality } => {
            let (b, a) = of_second_order(cutoff_hz, false, quality);
            let says = second_order(cutoff_hz, false, quality);
            let order = if cutoff_hz / design.rate_hz < 0.064 { 2 } else { 1 };
            let resonance = Some(Resonance::of(&b, &a, order, says.settles[0]));
            Stated { resonance, ..says }
        }
        V::WindowDifference { window_samples } => {
            let window = f64::from(window_samples);
            exact(1.0 / window, 1.0, window + 1.0, First::Part(1.0 / window, 1.0 / window))
        }
        V::Difference {} => exact(1.0, 0.0, 2.0, First::Part(1.0, 0.0)),
        V::TrackingLoop { bandwidth_hz } => {
            let part = bandwidth_hz / design.rate_hz;
            let p = (-2.0 * PI * part).exp();
            low_pass(&[(1.0 - p).powi(2)], &[-2.0 * p, p * p], part)
        }
        V::TrackingLead { bandwidth_hz, lead } => {
            let part = bandwidth_hz / design.rate_hz;
            let p = (-2.0 * PI * part).exp();
            let ki = (1.0 - p).powi(2);
            low_pass(&[ki * (1.0 + lead), -ki * lead], &[-2.0 * p, p * p], part)
        }
        V::Biquad { frequency_hz, damping, lead_s, zero } => {
            resonant(&[section([frequency_hz, damping, lead_s, zero], 0.5)])
        }
        V::Biquad2 {
            frequency_hz,
            damping,
            lead_s,
            zero,
            second_ratio,
            second_damping,
            second_lead_s,
            second_zero,
        } => {
            let second = [second_ratio * frequency_hz, second_damping, second_lead_s, second_zero];
            resonant(&[section([frequency_hz, damping, lead_s, zero], 0.5), section(second, 0.0)])
        }
        V::Smoothing { cutoff_hz, ratio } => {
            let part = cutoff_hz / design.rate_hz;
            let [p, q] = [1.0, ratio].map(|times| (-2.0 * PI * part * times).exp());
            low_pass(&[(1.0 - p) * (1.0 - q)], &[-p - q, p * q], part)
        }
        V::Observer { bandwidth_hz, mass_kg } => {
            let metres = design.full_scale_n / mass_kg / design.rate_hz / design.rate_hz;
            observer(bandwidth_hz, Some(metres / design.resolution_m))
        }
        V::Fusion { crossover_hz } => observer(crossover_hz, None),
        V::Kalman2 { acceleration_rms_m_per_s2 } => kalman(acceleration_rms_m_per_s2, 2),
        V::Kalman3 { jerk_rms_m_per_s3 } => kalman(jerk_rms_m_per_s3, 3),
        V::TimeStamps { span_samples } => Stated {
            error: f64::NAN, // the error depends on the speed
            whole: f64::NAN,
            holds: true,
            settles: [2.0 * f64::from(span_samples) + 10.0, 0.0],
            first: First::Mean(span_samples.into()),
            twin: Twin::None,
            resonance: None,
        },
        V::FoawEnd { window_samples, noise_counts } => windowed(1.0, window_samples, noise_counts),
        V::FoawBest { window_samples, noise_counts } => windowed(1.5, window_samples, noise_counts),
        V::LevantExplicit { acceleration_max_m_per_s2, lambda_ratio } => {
            let c = c(acceleration_max_m_per_s2);
            let [error, whole] = if lambda_ratio <= 1.5 { [2.5, 2.0] } else { [3.5, 2.5] };
            Stated {
                error: error * c.max(c.sqrt()) + 1.0 / LSB,
                whole: whole * c + 1.0 / LSB,
                holds: (1.0..=2.5).contains(&lambda_ratio),
                settles: [200.0, 4.0 / c],
                first: First::Root(lambda_ratio * c.sqrt()),
                twin: Twin::None,
                resonance: None,
            }
        }
        V::LevantImplicit { acceleration_max_m_per_s2, lambda_ratio } => {
            let c = c(acceleration_max_m_per_s2);
            Stated {
                error: f64::min(1.0, 1.2 * c.sqrt()) + 1.0 / LSB,
                whole: 0.0,
                holds: (1.0..=2.5).contains(&lambda_ratio),
                settles: [200.0, 4.0 / c],
                first: First::Bounded(1.1 * c),
                twin: Twin::None,
                resonance: None,
            }
        }
        ref other => panic!(
            "{other:?}: state its error at constant speed and its jump after a restart, here and on the page"
        ),
    }
}
