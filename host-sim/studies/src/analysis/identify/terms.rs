//! Terms in addition to mass, damping and spring. A term is only used if the record shows it.
//!
//! | term | model | scene |
//! |------|-------|-------|
//! | friction | `-friction sign(x')`, true rest | `[friction]`, static equal to Coulomb |
//! | stribeck | `-(friction + rise exp(-(x' / fall)^2)) sign(x')`; at rest up to `friction + rise` | `[friction]` |
//! | amplifier | `lag F' = gain u - F` | `[amplifier]` |
//! | offset | a constant force | `[offset]` |
//! | cogging | `sine sin(2 pi x / pitch) + cosine cos(2 pi x / pitch)`, a force | `[cogging]` |
//! | phase | `first sin(p) + second sin(2 p)` on the reading, `p = 2 pi x / cycle + phase` | `[encoder_error]` |
//!
//! **Test.** A model without a term is the model with the value 0. So the question is whether the value differs from 0.
//! The test is a Wald test: the value divided by its standard error. The standard error is taken from the stated
//! intervals ([`super::confidence`]). So the standard error includes the residual's colour and the quantiser. For one
//! parameter and many rows, this is the likelihood-ratio (F) test with the effective number of rows. Friction and lag
//! cannot be negative, so their test is one-sided. For the phase, sine and cosine are tested together. The p-value is
//! `exp(-z^2 / 2)` for each examined cycle. A term stays if its p-value is below [`FAMILY_P`] divided by the number of
//! candidates (Bonferroni). [`super::search`] selects the terms.

use statrs::distribution::{ContinuousCDF as _, Normal};

use super::{
    confidence::Estimate,
    layout::{Included, Parameter},
};

/// Probability with which the model gets at least one wrong term, if the residual has the properties that the intervals
/// assume.
pub const FAMILY_P: f64 = 0.002;

/// An effect that may be fitted in addition to mass, damping and spring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Term {
    /// Coulomb friction of the device.
    Friction,
    /// Friction that falls from static to Coulomb friction. This term needs [`Friction`](Self::Friction).
    Stribeck,
    /// First-order lag of the amplifier.
    Amplifier,
    /// Constant force on the device.
    Offset,
    /// Force that is periodic in the position.
    Cogging,
    /// Periodic error of the encoder.
    Phase,
}

impl Term {
    pub const ALL: [Self; 6] =
        [Self::Friction, Self::Stribeck, Self::Amplifier, Self::Offset, Self::Cogging, Self::Phase];

    /// Name of the command line option.
    pub fn name(self) -> &'static str {
        match self {
            Self::Friction => "friction",
            Self::Stribeck => "stribeck",
            Self::Amplifier => "amplifier",
            Self::Offset => "offset",
            Self::Cogging => "cogging",
            Self::Phase => "phase",
        }
    }

    /// The parameter that is 0 without the term. For the encoder's error it is one of the amplitudes.
    pub(super) fn parameter(self) -> Parameter {
        match self {
            Self::Friction => Parameter::Friction,
            Self::Stribeck => Parameter::Rise,
            Self::Amplifier => Parameter::Lag,
            Self::Offset => Parameter::Constant,
            Self::Cogging => Parameter::CogSine,
            Self::Phase => Parameter::Sine,
        }
    }

    /// Whether the term is periodic in the position. The period of a periodic term must be found.
    pub(super) fn is_periodic(self) -> bool {
        matches!(self, Self::Cogging | Self::Phase)
    }

    /// Whether the term has parameters of its shape, and not only of its size.
    pub(super) fn is_a_curve(self) -> bool {
        matches!(self, Self::Stribeck | Self::Cogging)
    }

    pub(super) fn add(self, terms: Included, included: bool) -> Included {
        match self {
            Self::Friction => {
                Included { friction: included, stribeck: terms.stribeck && included, ..terms }
            }
            Self::Stribeck => Included { stribeck: included, ..terms },
            Self::Amplifier => Included { lag: included, ..terms },
            Self::Offset => Included { offset: included, ..terms },
            Self::Cogging => Included { cogging: included, ..terms },
            Self::Phase => Included { phase: included, second: false, ..terms },
        }
    }

    pub(super) fn is_in(self, terms: Included) -> bool {
        match self {
            Self::Friction => terms.friction,
            Self::Stribeck => terms.stribeck,
            Self::Amplifier => terms.lag,
            Self::Offset => terms.offset,
            Self::Cogging => terms.cogging,
            Self::Phase => terms.phase,
        }
    }
}

/// Which terms are fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Terms {
    /// The terms that the record shows.
    #[default]
    Auto,
    /// Exactly these terms, even if the record does not show them.
    These {
        friction: bool,
        /// Static friction and Stribeck speed. This term needs `friction`.
        stribeck: bool,
        amplifier: bool,
        offset: bool,
        cogging: bool,
        phase: bool,
    },
}

impl Terms {
    /// No further term, as in the paper's model.
    pub const NONE: Self = Self::These {
        friction: false,
        stribeck: false,
        amplifier: false,
        offset: false,
        cogging: false,
        phase: false,
    };

    /// Selects the terms for which `has` is true.
    pub fn these(has: impl Fn(Term) -> bool) -> Self {
        Self::These {
            friction: has(Term::Friction) || has(Term::Stribeck),
            stribeck: has(Term::Stribeck),
            amplifier: has(Term::Amplifier),
            offset: has(Term::Offset),
            cogging: has(Term::Cogging),
            phase: has(Term::Phase),
        }
    }

    pub(super) fn may_have_friction(self) -> bool {
        self == Self::Auto || self.asks(Term::Friction)
    }

    pub(super) fn asks(self, term: Term) -> bool {
        match (self, term) {
            (Self::Auto, _) => false,
            (Self::These { friction, .. }, Term::Friction) => friction,
            (Self::These { stribeck, .. }, Term::Stribeck) => stribeck,
            (Self::These { cogging, .. }, Term::Cogging) => cogging,
            (Self::These { amplifier, .. }, Term::Amplifier) => amplifier,
            (Self::These { offset, .. }, Term::Offset) => offset,
            (Self::These { phase, .. }, Term::Phase) => phase,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Amplitude of the part that repeats once per cycle, in m.
    pub first_m: Estimate,
    /// Amplitude of the part that repeats twice per cycle, in m. It is 0 without an interval if the record does not
    /// show this part.
    pub second_m: Estimate,
    /// Phase at position 0, in rad.
    pub phase_rad: Estimate,
    /// Distance over which the encoder's signals repeat, in m.
    pub cycle_m: Estimate,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stribeck {
    /// Largest friction at rest, in N.
    pub static_n: Estimate,
    /// Speed over which friction falls from static to Coulomb friction, in m/s.
    pub speed_m_per_s: Estimate,
}

/// The force `amplitude sin(2 pi x / pitch + phase)` on the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cogging {
    pub amplitude_n: Estimate,
    /// Travel from cog to cog, in m.
    pub pitch_m: Estimate,
    /// Phase at position 0, in rad.
    pub phase_rad: Estimate,
}

/// Values of the terms. `None` stands for a term that is not in the model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Force of Coulomb friction, in N.
    pub friction_n: Option<Estimate>,
    pub stribeck: Option<Stribeck>,
    /// Time constant of the amplifier, in s.
    pub lag_s: Option<Estimate>,
    /// Constant force on the device, in N.
    pub offset_n: Option<Estimate>,
    pub cogging: Option<Cogging>,
    pub phase: Option<Phase>,
    pub tests: Vec<Tested>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tested {
    pub term: Term,
    /// Value divided by its standard error.
    pub z: f64,
    /// Probability of a value as far from 0 as this one, if the true value is 0. It is for all candidates together.
    pub p: f64,
}

/// Name of a term in a sentence.
pub(super) fn said(term: Term) -> &'static str {
    match term {
        Term::Friction => "dry friction",
        Term::Stribeck => "fall of friction with speed",
        Term::Amplifier => "lag of the amplifier",
        Term::Offset => "offset force",
        Term::Cogging => "cogging",
        Term::Phase => "periodic error of the encoder",
    }
}

/// Probability that a standard normal value is beyond z.
pub(super) fn tail(z: f64) -> f64 {
    if z.is_nan() { 1.0 } else { Normal::standard().sf(z) }
}
