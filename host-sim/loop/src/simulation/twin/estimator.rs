//! The estimators in `f64`.

use zwidth::{
    Design, SettingsError, VelocitySettings,
    units::{Acceleration, Force},
    velocity::{
        BiquadDesign, ButterworthDesign, CascadeDesign, DIFFERENCE_WINDOW_MAX, FirstOrder,
        KalmanDesign, LevantDesign, ObserverDesign, Senses, TrackingLoop,
    },
};

use super::{
    FLUSH_BELOW, LENGTH,
    foaw::Foaw,
    kalman::KalmanState,
    levant::{Levant, LevantState},
    loops::Loop,
    stamps::Stamps,
};

/// An estimator in `f64`; velocities in counts per sample.
#[derive(Clone, Copy, Debug)]
pub struct TwinEstimator {
    kind: Kind,
    inputs: [f64; 2],
    outputs: [f64; 2],
    rest: Rest,
}

/// What the estimators with a file of their own remember.
#[derive(Clone, Copy, Debug)]
struct Rest {
    /// Last differences, newest first.
    past: [f64; LENGTH],
    levant: LevantState,
    kalman: KalmanState,
    loops: Loop,
    stamps: Stamps,
    /// Inputs and outputs of each section.
    sections: [[[f64; 2]; 2]; 2],
    /// Counts at the last samples, and the place of the newest.
    counts: [i32; 256],
    newest: u8,
}

/// The maths of an estimator. What it remembers stands beside it, so that the usual one's few
/// numbers can live in registers.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "copied once per run")]
enum Kind {
    Butterworth(ButterworthDesign),
    FirstOrder(FirstOrder),
    Biquad(BiquadDesign),
    Cascade(CascadeDesign),
    Difference,
    /// Weights of the last differences, newest first.
    Fir([f64; LENGTH]),
    TrackingLoop(TrackingLoop),
    Observer(ObserverDesign),
    Fusion(ObserverDesign),
    /// Shortest span, in samples.
    TimeStamps(f64),
    Foaw(Foaw),
    Levant(Levant),
    Kalman(KalmanDesign),
    /// Length of the window, samples.
    Window(u8),
}

/// `y = b0 (x + past[0] x1 + past[1] x2) - a[0] y1 - a[1] y2`, the form of all usual estimators.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LowPass {
    pub past: [f64; 2],
    pub b0: f64,
    pub a: [f64; 2],
}

impl TwinEstimator {
    /// The usual estimators in one form; `None` for the others.
    pub(crate) fn low_pass(&self) -> Option<LowPass> {
        match self.kind {
            Kind::Butterworth(ButterworthDesign { b0, a1, a2, .. }) => {
                Some(LowPass { past: [2.0, 1.0], b0, a: [a1, a2] })
            }
            Kind::FirstOrder(FirstOrder { b0, a1 }) => {
                Some(LowPass { past: [1.0, 0.0], b0, a: [a1, 0.0] })
            }
            Kind::Difference => Some(LowPass { past: [0.0; 2], b0: 1.0, a: [0.0; 2] }),
            Kind::Biquad(BiquadDesign { b: [b0, b1, b2], a, .. }) => {
                Some(LowPass { past: [b1 / b0, b2 / b0], b0, a })
            }
            _ => None,
        }
    }

    /// The estimator of those settings at rest.
    ///
    /// # Errors
    /// A parameter is out of range.
    pub fn new(settings: &VelocitySettings, design: &Design) -> Result<Self, SettingsError> {
        settings.build(design)?; // the ranges
        let rate_hz = design.rate_hz;
        let kind = match *settings {
            VelocitySettings::Butterworth { cutoff_hz } => {
                Kind::Butterworth(ButterworthDesign::new(cutoff_hz, rate_hz, false)?)
            }
            VelocitySettings::ButterworthPrewarped { cutoff_hz } => {
                Kind::Butterworth(ButterworthDesign::new(cutoff_hz, rate_hz, true)?)
            }
            VelocitySettings::FirstOrder { cutoff_hz } => {
                Kind::FirstOrder(FirstOrder::new(cutoff_hz, rate_hz, false)?)
            }
            VelocitySettings::FirstOrderPrewarped { cutoff_hz } => {
                Kind::FirstOrder(FirstOrder::new(cutoff_hz, rate_hz, true)?)
            }
            VelocitySettings::SecondOrder { cutoff_hz, quality } => {
                Kind::Butterworth(ButterworthDesign::damped(cutoff_hz, quality, rate_hz)?)
            }
            VelocitySettings::TrackingLead { bandwidth_hz, lead } => {
                Kind::TrackingLoop(TrackingLoop::led(bandwidth_hz, lead, rate_hz)?)
            }
            VelocitySettings::Smoothing { cutoff_hz, ratio } => {
                Kind::TrackingLoop(TrackingLoop::smoothing(cutoff_hz, ratio, rate_hz)?)
            }
            VelocitySettings::WindowDifference { window_samples } => {
                Kind::Window(u8::try_from(window_samples).unwrap_or(DIFFERENCE_WINDOW_MAX))
            }
            VelocitySettings::Difference {} => Kind::Difference,
            VelocitySettings::Biquad { frequency_hz, damping, lead_s, zero } => {
                let design = BiquadDesign::new(frequency_hz, damping, lead_s, zero, rate_hz)?;
                Kind::Biquad(design)
            }
            VelocitySettings::Biquad2 {
                frequency_hz,
                damping,
                lead_s,
                zero,
                second_ratio,
                second_damping,
                second_lead_s,
                second_zero,
            } => Kind::Cascade(CascadeDesign::new(
                [frequency_hz, damping, lead_s, zero],
                [second_ratio, second_damping, second_lead_s, second_zero],
                rate_hz,
            )?),
            VelocitySettings::TrackingLoop { bandwidth_hz } => {
                Kind::TrackingLoop(TrackingLoop::new(bandwidth_hz, rate_hz)?)
            }
            VelocitySettings::Observer { bandwidth_hz, mass_kg } => {
                Kind::Observer(ObserverDesign::of_mass(bandwidth_hz, mass_kg, design)?)
            }
            VelocitySettings::TimeStamps { span_samples } => Kind::TimeStamps(span_samples.into()),
            VelocitySettings::Fusion { crossover_hz } => {
                Kind::Fusion(ObserverDesign::of_accelerometer(crossover_hz, rate_hz)?)
            }
            VelocitySettings::FoawEnd { window_samples, noise_counts } => {
                Kind::Foaw(Foaw::new(false, window_samples, noise_counts))
            }
            VelocitySettings::FoawBest { window_samples, noise_counts } => {
                Kind::Foaw(Foaw::new(true, window_samples, noise_counts))
            }
            VelocitySettings::LevantExplicit { acceleration_max_m_per_s2: c, lambda_ratio } => {
                let sizes = LevantDesign::new(c, lambda_ratio, design)?;
                Kind::Levant(Levant { implicit: false, sizes })
            }
            VelocitySettings::LevantImplicit { acceleration_max_m_per_s2: c, lambda_ratio } => {
                let sizes = LevantDesign::new(c, lambda_ratio, design)?;
                Kind::Levant(Levant { implicit: true, sizes })
            }
            VelocitySettings::Kalman2 { acceleration_rms_m_per_s2 } => {
                Kind::Kalman(KalmanDesign::two_states(acceleration_rms_m_per_s2, design)?)
            }
            VelocitySettings::Kalman3 { jerk_rms_m_per_s3 } => {
                Kind::Kalman(KalmanDesign::three_states(jerk_rms_m_per_s3, design)?)
            }
            _ => Kind::Fir(weights(settings, design)?),
        };
        let rest = Rest {
            past: [0.0; LENGTH],
            levant: LevantState::default(),
            kalman: KalmanState::default(),
            loops: Loop::default(),
            stamps: Stamps::REST,
            sections: [[[0.0; 2]; 2]; 2],
            counts: [0; 256],
            newest: 0,
        };
        Ok(Self { kind, inputs: [0.0; 2], outputs: [0.0; 2], rest })
    }

    /// The velocity after a move by `difference` counts.
    #[inline]
    pub fn update(&mut self, difference: i32, senses: &Senses) -> f64 {
        let input = f64::from(difference);
        match &self.kind {
            Kind::Butterworth(ButterworthDesign { b0, a1, a2, .. }) => {
                let [x1, x2] = self.inputs;
                let [y1, y2] = self.outputs;
                let raw = b0 * (input + 2.0 * x1 + x2) - a1 * y1 - a2 * y2;
                let output = if raw.abs() < FLUSH_BELOW { 0.0 } else { raw };
                self.inputs = [input, x1];
                self.outputs = [output, y1];
                output
            }
            Kind::FirstOrder(FirstOrder { b0, a1 }) => {
                let [x1, _] = self.inputs;
                let [y1, _] = self.outputs;
                let raw = b0 * (input + x1) - a1 * y1;
                let output = if raw.abs() < FLUSH_BELOW { 0.0 } else { raw };
                self.inputs = [input, x1];
                self.outputs = [output, y1];
                output
            }
            Kind::Biquad(design) => section(design, &mut self.inputs, &mut self.outputs, input),
            Kind::Difference => input,
            other => self.rest.update(other, difference, senses),
        }
    }
}

impl Rest {
    #[inline(never)] // so that the other estimators' state stays in registers
    fn update(&mut self, kind: &Kind, difference: i32, senses: &Senses) -> f64 {
        let input = f64::from(difference);
        match kind {
            Kind::TrackingLoop(gains) => self.loops.track(gains, difference.into()),
            Kind::Observer(observer) => {
                let force = f64::from(senses.force.bits()) / f64::from(Force::FULL_SCALE.bits());
                let known = force * observer.per_full_scale;
                self.loops.observe(observer, difference.into(), known)
            }
            Kind::Fusion(observer) => {
                let bits = f64::from(senses.acceleration.bits());
                let known = bits / f64::from(1u32 << Acceleration::FRACTION_BITS);
                self.loops.observe(observer, difference.into(), known)
            }
            Kind::TimeStamps(span) => self.stamps.update(*span, difference, senses.edge),
            Kind::Fir(weights) => weighted(weights, &mut self.past, input),
            Kind::Foaw(foaw) => foaw.update(&mut self.past, input),
            Kind::Levant(levant) => levant.update(&mut self.levant, input),
            Kind::Kalman(gains) => self.kalman.update(gains, input),
            Kind::Cascade(CascadeDesign { sections }) => {
                let mut value = input;
                for (design, [inputs, outputs]) in sections.iter().zip(&mut self.sections) {
                    value = section(design, inputs, outputs, value);
                }
                value
            }
            Kind::Window(window) => {
                let count = self.counts[usize::from(self.newest)].wrapping_add(difference);
                self.newest = self.newest.wrapping_add(1);
                self.counts[usize::from(self.newest)] = count;
                let before = self.counts[usize::from(self.newest.wrapping_sub(*window))];
                f64::from(count.wrapping_sub(before)) / f64::from(*window)
            }
            Kind::Butterworth(_) | Kind::FirstOrder(_) | Kind::Biquad(_) | Kind::Difference => {
                input
            }
        }
    }
}

/// One section; its numerator is over its first coefficient, as in [`LowPass`].
#[inline(always)]
fn section(
    design: &BiquadDesign,
    inputs: &mut [f64; 2],
    outputs: &mut [f64; 2],
    input: f64,
) -> f64 {
    let BiquadDesign { b: [b0, b1, b2], a: [a1, a2], .. } = design;
    let ([x1, x2], [y1, y2]) = (*inputs, *outputs);
    let raw = b0 * (input + b1 / b0 * x1 + b2 / b0 * x2) - a1 * y1 - a2 * y2;
    let output = if raw.abs() < FLUSH_BELOW { 0.0 } else { raw };
    *inputs = [input, x1];
    *outputs = [output, y1];
    output
}

/// Of an estimator that has no arm of its own above: a sum of differences.
fn weights(settings: &VelocitySettings, design: &Design) -> Result<[f64; LENGTH], SettingsError> {
    let mut weights = [0.0; LENGTH];
    let exact = settings.weights(design)?.ok_or(SettingsError {
        parameter: "estimators without a form in f64",
        value: 1.0,
        range: 0.0..=0.0,
    })?;
    for (weight, exact) in weights.iter_mut().zip(exact.weights()) {
        *weight = *exact;
    }
    Ok(weights)
}

#[inline(never)] // so that the other estimators' state stays in registers
fn weighted(weights: &[f64; LENGTH], past: &mut [f64; LENGTH], input: f64) -> f64 {
    past.rotate_right(1);
    past[0] = input;
    weights.iter().zip(past).map(|(weight, input)| weight * *input).sum()
}
