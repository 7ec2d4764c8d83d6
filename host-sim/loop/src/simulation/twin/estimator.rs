//! The estimators in `f64`. They run the [equations](Equation).

use zwidth::{
    Design, SettingsError, VelocitySettings,
    units::{Acceleration, Force},
    velocity::Senses,
};

use super::{
    FLUSH_BELOW, LENGTH,
    equation::{Equation, LowPass},
    kalman::KalmanState,
    levant::LevantState,
    loops::Loop,
    stamps::Stamps,
};

/// An estimator in `f64`. Velocities are in counts per sample.
#[derive(Clone, Copy, Debug)]
pub struct TwinEstimator {
    /// The form that all common estimators have. It is small enough for the processor's registers.
    low_pass: Option<Section>,
    equation: Equation,
    memory: Memory,
    rest: Rest,
}

/// Last inputs and outputs of a section.
#[derive(Clone, Copy, Debug, Default)]
struct Memory {
    inputs: [f64; 2],
    outputs: [f64; 2],
}

/// State of the estimators that are not a [`Section`].
#[derive(Clone, Copy, Debug)]
struct Rest {
    /// Last differences, newest first.
    past: [f64; LENGTH],
    levant: LevantState,
    kalman: KalmanState,
    loops: Loop,
    stamps: Stamps,
    sections: [Memory; 2],
    /// Counts at the last samples, with the index of the newest count.
    counts: [i32; 256],
    newest: u8,
}

/// A [`LowPass`] in the form in which it is computed: `y = b0 (x + past[0] x1 + past[1] x2) - a[0] y1 - a[1] y2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Section {
    pub past: [f64; 2],
    pub b0: f64,
    pub a: [f64; 2],
}

impl From<LowPass> for Section {
    fn from(LowPass { b: [b0, b1, b2], a, .. }: LowPass) -> Self {
        Self { past: [b1 / b0, b2 / b0], b0, a }
    }
}

impl Section {
    #[inline(always)]
    fn update(&self, Memory { inputs, outputs }: &mut Memory, input: f64) -> f64 {
        let Self { past: [p1, p2], b0, a: [a1, a2] } = self;
        let ([x1, x2], [y1, y2]) = (*inputs, *outputs);
        let raw = b0 * (input + p1 * x1 + p2 * x2) - a1 * y1 - a2 * y2;
        let output = if raw.abs() < FLUSH_BELOW { 0.0 } else { raw };
        *inputs = [input, x1];
        *outputs = [output, y1];
        output
    }
}

impl TwinEstimator {
    /// The estimator as a [`Section`], the form of the common estimators. `None` for all other estimators.
    pub(crate) fn low_pass(&self) -> Option<Section> {
        self.low_pass
    }

    /// Makes an estimator with these settings, at rest.
    pub fn new(settings: &VelocitySettings, design: &Design) -> Result<Self, SettingsError> {
        let equation = Equation::of(settings, design)?;
        let low_pass = match equation {
            Equation::LowPass(of) => Some(of.into()),
            _ => None,
        };
        let rest = Rest {
            past: [0.0; LENGTH],
            levant: LevantState::default(),
            kalman: KalmanState::default(),
            loops: Loop::default(),
            stamps: Stamps::REST,
            sections: [Memory::default(); 2],
            counts: [0; 256],
            newest: 0,
        };
        Ok(Self { low_pass, equation, memory: Memory::default(), rest })
    }

    /// The velocity after a change of the count by `difference`.
    #[inline]
    pub fn update(&mut self, difference: i32, senses: &Senses) -> f64 {
        match &self.low_pass {
            Some(section) => section.update(&mut self.memory, difference.into()),
            None => self.rest.update(&self.equation, difference, senses),
        }
    }
}

impl Rest {
    #[inline(never)] // keeps the state of the other estimators in registers
    fn update(&mut self, equation: &Equation, difference: i32, senses: &Senses) -> f64 {
        let input = f64::from(difference);
        match equation {
            Equation::LowPass(section) => {
                Section::from(*section).update(&mut self.sections[0], input)
            }
            Equation::Cascade(sections) => {
                let both = sections.iter().zip(&mut self.sections);
                both.fold(input, |value, (of, memory)| Section::from(*of).update(memory, value))
            }
            Equation::Sum(design) => weighted(design.weights(), &mut self.past, input),
            Equation::Ends(window) => {
                let count = self.counts[usize::from(self.newest)].wrapping_add(difference);
                self.newest = self.newest.wrapping_add(1);
                self.counts[usize::from(self.newest)] = count;
                let [.., samples] = window.to_be_bytes(); // the window has at most 255 samples
                let before = self.counts[usize::from(self.newest.wrapping_sub(samples))];
                f64::from(count.wrapping_sub(before)) / f64::from(*window)
            }
            Equation::Tracking(gains) => self.loops.track(gains, input),
            Equation::Kalman(gains) => self.kalman.update(gains, input),
            Equation::Observer(observer) => {
                let force = f64::from(senses.force.bits()) / f64::from(Force::FULL_SCALE.bits());
                let known = force * observer.per_full_scale;
                self.loops.observe(observer, input, known)
            }
            Equation::Fusion(observer) => {
                let bits = f64::from(senses.acceleration.bits());
                let known = bits / f64::from(1u32 << Acceleration::FRACTION_BITS);
                self.loops.observe(observer, input, known)
            }
            Equation::TimeStamps(span) => {
                self.stamps.update((*span).into(), difference, senses.edge)
            }
            Equation::Foaw(foaw) => foaw.update(&mut self.past, input),
            Equation::Levant(levant) => levant.update(&mut self.levant, input),
        }
    }
}

#[inline(never)] // keeps the state of the other estimators in registers
fn weighted(weights: &[f64], past: &mut [f64; LENGTH], input: f64) -> f64 {
    past.rotate_right(1);
    past[0] = input;
    weights.iter().zip(past).map(|(weight, input)| weight * *input).sum()
}
