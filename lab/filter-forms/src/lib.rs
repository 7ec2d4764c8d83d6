//! The velocity filter, a second-order Butterworth, in every number format and form that could be used. The same source
//! runs on the host and on the board's core. On the host `cargo sim trade` measures the errors. On the board's core a
//! test counts the cycles.
//!
//! ```text
//! velocity bits -> signal of the format -> form -> velocity bits
//! ```
//!
//! For the core's own filter, the core's code is called. Some combinations are left out, because they would show
//! nothing new:
//!
//! * error feedback in the transposed form: the sums are those of direct form 1. So the outputs would be equal to the
//!   core's, bit for bit. A test of [`fixed::Direct2Transposed`] shows this for both forms without feedback.
//! * error feedback in the state-variable form: the rounded output is not fed back, so there is no error to correct.
//! * error feedback in the delta form: the form itself acts as error feedback, see [`integrators`].
//! * the state-variable form of Chamberlin (1980): it has another transfer function, and is unstable from about a sixth
//!   of the rate on. The state-variable form here has the same bilinear transform as all other forms.
//! * 32-bit sums with 32-bit words, and 16-bit sums with 16-bit words: the first product would overflow.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod fixed;
pub mod float;
pub mod integrators;
pub mod peers;
mod prototype;
mod signal;
mod variant;
pub mod word;

pub use prototype::Prototype;
pub use signal::Signal;
pub use variant::{Form, Format, Variant};

use zwidth::{
    SettingsError,
    units::Velocity,
    velocity::{Biquad, BiquadState, ButterworthDesign, Shaping},
};

use fixed::Coefficients;
use float::Float;
use word::Word;

/// The reason why a format cannot be used at a cutoff.
#[derive(Clone, Debug, PartialEq)]
pub enum Refused {
    /// The core refuses the cutoff.
    Core(SettingsError),
    /// A necessary coefficient rounds to 0.
    Zero {
        coefficient: &'static str,
        /// Number of fractional bits that the coefficient has.
        fraction: u32,
    },
}

impl core::fmt::Display for Refused {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Core(error) => write!(f, "refused: {error}"),
            Self::Zero { coefficient, fraction } => {
                write!(f, "cannot hold: {coefficient} rounds to 0 with {fraction} fractional bits")
            }
        }
    }
}

impl core::error::Error for Refused {}

#[derive(Clone, Copy, Debug)]
pub struct Filter {
    kind: Kind,
    /// Number of fractional bits of a signal in Q15.
    fraction: u32,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Core(Core),
    I32(Fixed<i32>),
    Q15(Fixed<i16>),
    Q15Feedback(fixed::Direct1Feedback<i16>),
    F32(Floating<f32>),
    F64(Floating<f64>),
    IdspDither(peers::IdspDither),
    IdspWide(peers::IdspWide),
    CmsisQ31(peers::CmsisQ31),
    Cmsis32x64(peers::Cmsis32x64),
}

#[derive(Clone, Copy, Debug)]
enum Forms<A, B, C, D> {
    Direct1(A),
    Direct2Transposed(B),
    StateVariable(C),
    Delta(D),
}

type Fixed<W> = Forms<
    fixed::Direct1<W>,
    fixed::Direct2Transposed<W>,
    integrators::StateVariable<W>,
    integrators::Delta<W>,
>;
type Floating<T> =
    Forms<float::Direct1<T>, float::Direct2Transposed<T>, float::StateVariable<T>, float::Delta<T>>;

impl<W: Word> Fixed<W> {
    fn fixed(form: Form, p: &Prototype) -> Result<Self, Refused> {
        let c = || Coefficients::exact_at_dc(p);
        Ok(match form {
            Form::Direct1 => Self::Direct1(fixed::Direct1::new(c()?)),
            Form::Direct2Transposed => Self::Direct2Transposed(fixed::Direct2Transposed::new(c()?)),
            Form::StateVariable => Self::StateVariable(integrators::StateVariable::new(p)?),
            Form::Delta => Self::Delta(integrators::Delta::new(p)?),
        })
    }
}

impl<T: Float> Floating<T> {
    fn floating(form: Form, p: &Prototype) -> Self {
        match form {
            Form::Direct1 => Self::Direct1(float::Direct1::new(p)),
            Form::Direct2Transposed => Self::Direct2Transposed(float::Direct2Transposed::new(p)),
            Form::StateVariable => Self::StateVariable(float::StateVariable::new(p)),
            Form::Delta => Self::Delta(float::Delta::new(p)),
        }
    }
}

impl<A: Step, B: Step, C: Step, D: Step> Forms<A, B, C, D> {
    #[inline]
    fn visit<V: Visit>(&mut self, visit: V, fraction: u32) -> V::Output {
        match self {
            Self::Direct1(form) => visit.visit(form, fraction),
            Self::Direct2Transposed(form) => visit.visit(form, fraction),
            Self::StateVariable(form) => visit.visit(form, fraction),
            Self::Delta(form) => visit.visit(form, fraction),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Core {
    filter: Biquad,
    state: BiquadState,
}

impl Step for Core {
    type Signal = i32;

    #[inline]
    fn step(&mut self, x: i32) -> i32 {
        self.filter.update(&mut self.state, Velocity::saturating_from_bits(x)).bits()
    }
}

pub trait Step: Copy {
    type Signal: Signal;

    fn step(&mut self, x: Self::Signal) -> Self::Signal;

    /// Updates the filter by one sample. Input and output are velocities in LSB of the core. Only Q15 uses `fraction`.
    #[inline]
    fn velocity(&mut self, input: i32, fraction: u32) -> i32 {
        self.step(Signal::of_velocity(input, fraction)).to_velocity(fraction)
    }

    /// Does the same as [`velocity`](Self::velocity), but returns the output in counts per sample. It has all digits of
    /// the format.
    #[inline]
    fn counts(&mut self, input: i32, fraction: u32) -> f64 {
        self.step(Signal::of_velocity(input, fraction)).to_counts(fraction)
    }
}

/// An operation that works with every form. The compiler makes one version of it for each form.
pub trait Visit {
    type Output;

    fn visit<F: Step>(self, form: &mut F, fraction: u32) -> Self::Output;
}

impl Filter {
    /// A filter at rest. `q15_fraction` is the number of fractional bits of a signal in Q15, up to 15. The full scale
    /// of Q15 is `2^(15 - q15_fraction)` counts per sample.
    ///
    /// # Errors
    /// The format cannot have this cutoff.
    pub fn new(
        variant: Variant,
        cutoff_hz: f64,
        rate_hz: f64,
        q15_fraction: u32,
    ) -> Result<Self, Refused> {
        let p = Prototype::new(cutoff_hz, rate_hz);
        let c = || Coefficients::exact_at_dc(&p);
        let design = ButterworthDesign::new(cutoff_hz, rate_hz, false).map_err(Refused::Core);
        let kind = match variant.format {
            Format::I32Feedback => {
                Kind::Core(Core { filter: design?.quantise(), state: BiquadState::default() })
            }
            Format::I32 => Kind::I32(Fixed::fixed(variant.form, &p)?),
            Format::Q15 => Kind::Q15(Fixed::fixed(variant.form, &p)?),
            Format::Q15Feedback => {
                // The core chooses the order of the feedback. If the core refuses the cutoff, the cutoff is too low,
                // and the order is 2.
                let shaping = design.map_or(Shaping::Second, |design| design.quantise().shaping());
                let c = Coefficients::exact_at_dc(&p)?; // 16-bit coefficients
                Kind::Q15Feedback(fixed::Direct1Feedback::new(c, shaping))
            }
            Format::F32 => Kind::F32(Floating::floating(variant.form, &p)),
            Format::F64 => Kind::F64(Floating::floating(variant.form, &p)),
            Format::IdspDither => Kind::IdspDither(peers::IdspDither::new(&c()?)),
            Format::IdspWide => Kind::IdspWide(peers::IdspWide::new(&c()?)),
            Format::CmsisQ31 => Kind::CmsisQ31(peers::CmsisQ31::new(&c()?)),
            Format::Cmsis32x64 => Kind::Cmsis32x64(peers::Cmsis32x64::new(&c()?)),
        };
        Ok(Self { kind, fraction: q15_fraction })
    }

    /// Applies an operation to the form of this filter. The form is looked up only once, before the operation.
    #[inline]
    pub fn visit<V: Visit>(&mut self, visit: V) -> V::Output {
        let fraction = self.fraction;
        match &mut self.kind {
            Kind::Core(form) => visit.visit(form, fraction),
            Kind::I32(forms) => forms.visit(visit, fraction),
            Kind::Q15(forms) => forms.visit(visit, fraction),
            Kind::Q15Feedback(form) => visit.visit(form, fraction),
            Kind::F32(forms) => forms.visit(visit, fraction),
            Kind::F64(forms) => forms.visit(visit, fraction),
            Kind::IdspDither(form) => visit.visit(form, fraction),
            Kind::IdspWide(form) => visit.visit(form, fraction),
            Kind::CmsisQ31(form) => visit.visit(form, fraction),
            Kind::Cmsis32x64(form) => visit.visit(form, fraction),
        }
    }

    /// Updates the filter by one sample. Input and output are velocities in LSB of the core.
    #[inline]
    pub fn update(&mut self, input: i32) -> i32 {
        self.visit(Update(input))
    }

    /// Updates the filter by all samples in their order. The outputs replace the inputs.
    pub fn update_all(&mut self, samples: &mut [i32]) {
        self.visit(UpdateAll(samples));
    }

    /// Runs the filter over `samples` samples. `input` returns the velocity in LSB of the core. `each` gets the output
    /// in counts per sample, with all digits of the format.
    pub fn run(&mut self, samples: u32, input: impl FnMut(u32) -> i32, each: impl FnMut(u32, f64)) {
        self.visit(Run { samples, input, each });
    }
}

struct Update(i32);

impl Visit for Update {
    type Output = i32;

    #[inline]
    fn visit<F: Step>(self, form: &mut F, fraction: u32) -> i32 {
        form.velocity(self.0, fraction)
    }
}

struct UpdateAll<'a>(&'a mut [i32]);

impl Visit for UpdateAll<'_> {
    type Output = ();

    fn visit<F: Step>(self, form: &mut F, fraction: u32) {
        let mut copy = *form; // a local copy can live in registers
        for sample in self.0 {
            *sample = copy.velocity(*sample, fraction);
        }
        *form = copy;
    }
}

struct Run<I, E> {
    samples: u32,
    input: I,
    each: E,
}

impl<I: FnMut(u32) -> i32, E: FnMut(u32, f64)> Visit for Run<I, E> {
    type Output = ();

    fn visit<F: Step>(mut self, form: &mut F, fraction: u32) {
        for n in 0..self.samples {
            let output = form.counts((self.input)(n), fraction);
            (self.each)(n, output);
        }
    }
}
