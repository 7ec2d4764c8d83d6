//! The velocity filter, a second-order Butterworth, in every number format and form that could do its work: one source
//! for the host, where `cargo sim trade` measures what each gets wrong, and for the board's core, where a test counts its
//! cycles.
//!
//! ```text
//! velocity bits -> signal of the format -> form -> velocity bits
//! ```
//!
//! The core's own filter is called from the core. Left out, because they would show nothing:
//!
//! * error feedback in the transposed form: its sums are those of direct form 1, the outputs would be the core's to
//!   the bit ([`fixed::Direct2Transposed`] shows it without feedback);
//! * error feedback in the state-variable form: its rounded output does not go back, there is nothing to carry;
//! * error feedback in the delta form: it has it by structure, see [`integrators`];
//! * the state-variable form of Chamberlin (1980): another transfer function, unstable from about a sixth
//!   of the rate on; the one here has the bilinear transform of all others;
//! * 32-bit sums under 32-bit words, 16-bit ones under 16: the first product would overflow.
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

/// Why a format cannot have a cutoff.
#[derive(Clone, Debug, PartialEq)]
pub enum Refused {
    /// The core refuses it.
    Core(SettingsError),
    /// A coefficient without which nothing moves rounds to 0.
    Zero {
        coefficient: &'static str,
        /// Fractional bits that it has.
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

/// A filter with its state.
#[derive(Clone, Copy, Debug)]
pub struct Filter {
    kind: Kind,
    /// Fractional bits of a signal in Q15.
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

/// One of the forms.
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

/// The core's own filter.
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

/// A form with its state.
pub trait Step: Copy {
    /// The number it works on.
    type Signal: Signal;

    fn step(&mut self, x: Self::Signal) -> Self::Signal;

    /// One sample, velocity in and out in LSB of the core's; `fraction` is for Q15.
    #[inline]
    fn velocity(&mut self, input: i32, fraction: u32) -> i32 {
        self.step(Signal::of_velocity(input, fraction)).to_velocity(fraction)
    }

    /// The same with all digits of the output that the format has, counts per sample.
    #[inline]
    fn counts(&mut self, input: i32, fraction: u32) -> f64 {
        self.step(Signal::of_velocity(input, fraction)).to_counts(fraction)
    }
}

/// What is done with a form, compiled for each.
pub trait Visit {
    /// What comes of it.
    type Output;

    fn visit<F: Step>(self, form: &mut F, fraction: u32) -> Self::Output;
}

impl Filter {
    /// At rest. `q15_fraction`: fractional bits that Q15 gives to a signal, up to 15; its full scale is
    /// `2^(15 - q15_fraction)` counts per sample.
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
                // the order that the core takes; where it refuses, the cutoff is low
                let shaping = design.map_or(Shaping::Second, |design| design.quantise().shaping());
                let c = Coefficients::exact_at_dc(&p)?; // of 16 bits
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

    /// Does something with the form that this is, told apart once.
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

    /// One sample, velocity in and out in LSB of the core's.
    #[inline]
    pub fn update(&mut self, input: i32) -> i32 {
        self.visit(Update(input))
    }

    /// The same for one sample after the other: inputs become outputs.
    pub fn update_all(&mut self, samples: &mut [i32]) {
        self.visit(UpdateAll(samples));
    }

    /// `samples` samples: `input` gives LSB of the core's velocity, `each` sees counts per sample with all digits that
    /// the format has.
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
        let mut copy = *form; // so that it can live in registers
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
