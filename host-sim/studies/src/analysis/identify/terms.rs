//! Terms beside mass, damping and spring, each taken in only if the record tells it.
//!
//! | term | model | scene |
//! |------|-------|-------|
//! | friction | `-friction sign(x')`, true rest | `[friction]`, static equal to Coulomb |
//! | amplifier | `lag F' = gain u - F` | `[amplifier]` |
//! | offset | a constant force | `[offset]` |
//! | phase | `first sin(p) + second sin(2 p)` on the reading, `p = 2 pi x / cycle + phase` | `[encoder_error]` |
//!
//! **Test.** A model with a term holds the one without (its value 0), so the question is whether the value can be told
//! from 0: a Wald test, the value over its standard error, where the error is the one of the stated intervals
//! ([`super::confidence`]), so that it counts with the residual's colour and the quantiser. For one parameter and many
//! rows it is the likelihood-ratio (F) test with the rows that the colour leaves. One-sided for friction and lag, which
//! are not below 0; for the phase, whose sine and cosine are tested together, `exp(-z^2 / 2)` for each of the cycles that
//! were looked at. A term stays if its p-value is below [`FAMILY_P`] divided by the number of candidates (Bonferroni).
//! [`super::search`] chooses them.

use statrs::distribution::{ContinuousCDF as _, Normal};

use super::{
    confidence::Estimate,
    layout::{Included, Parameter},
};

/// Probability that any term is taken in which is not there, for a residual as the intervals suppose it.
pub const FAMILY_P: f64 = 0.002;

/// A term beside mass, damping and spring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Term {
    /// Coulomb friction of the device.
    Friction,
    /// First-order lag of the amplifier.
    Amplifier,
    /// Constant force on the device.
    Offset,
    /// Periodic error of the encoder.
    Phase,
}

impl Term {
    pub const ALL: [Self; 4] = [Self::Friction, Self::Amplifier, Self::Offset, Self::Phase];

    /// Its option on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Friction => "friction",
            Self::Amplifier => "amplifier",
            Self::Offset => "offset",
            Self::Phase => "phase",
        }
    }

    /// The parameter that is 0 without it; of the encoder's error one of several.
    pub(super) fn parameter(self) -> Parameter {
        match self {
            Self::Friction => Parameter::Friction,
            Self::Amplifier => Parameter::Lag,
            Self::Offset => Parameter::Constant,
            Self::Phase => Parameter::Sine,
        }
    }

    pub(super) fn add(self, terms: Included, included: bool) -> Included {
        match self {
            Self::Friction => Included { friction: included, ..terms },
            Self::Amplifier => Included { lag: included, ..terms },
            Self::Offset => Included { offset: included, ..terms },
            Self::Phase => Included { phase: included, second: false, ..terms },
        }
    }

    pub(super) fn is_in(self, terms: Included) -> bool {
        match self {
            Self::Friction => terms.friction,
            Self::Amplifier => terms.lag,
            Self::Offset => terms.offset,
            Self::Phase => terms.phase,
        }
    }
}

/// Which terms are fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Terms {
    /// Those that the record tells.
    #[default]
    Auto,
    /// These, whether the record tells them or not.
    These {
        friction: bool,
        /// First-order lag of the amplifier.
        amplifier: bool,
        offset: bool,
        /// Periodic error of the encoder.
        phase: bool,
    },
}

impl Terms {
    /// No term: the paper's model.
    pub const NONE: Self =
        Self::These { friction: false, amplifier: false, offset: false, phase: false };

    /// Friction may be in the model.
    pub(super) fn may_have_friction(self) -> bool {
        self == Self::Auto || self.asks(Term::Friction)
    }

    pub(super) fn asks(self, term: Term) -> bool {
        match (self, term) {
            (Self::Auto, _) => false,
            (Self::These { friction, .. }, Term::Friction) => friction,
            (Self::These { amplifier, .. }, Term::Amplifier) => amplifier,
            (Self::These { offset, .. }, Term::Offset) => offset,
            (Self::These { phase, .. }, Term::Phase) => phase,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Amplitude once per cycle, m.
    pub first_m: Estimate,
    /// Amplitude twice per cycle, m; 0 without width if the record does not tell it.
    pub second_m: Estimate,
    /// Phase at position 0, rad.
    pub phase_rad: Estimate,
    /// Travel per cycle, m.
    pub cycle_m: Estimate,
}

/// What was found of the terms; `None` where one is not in the model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Force of Coulomb friction, N.
    pub friction_n: Option<Estimate>,
    /// Time constant of the amplifier, s.
    pub lag_s: Option<Estimate>,
    /// Constant force on the device, N.
    pub offset_n: Option<Estimate>,
    /// Error of the encoder.
    pub phase: Option<Phase>,
    /// The tests of the terms in the model.
    pub tests: Vec<Tested>,
}

/// The test of one term.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tested {
    pub term: Term,
    /// Value over standard error.
    pub z: f64,
    /// Probability of such a value without the term, for all candidates together.
    pub p: f64,
}

/// What a sentence calls a term.
pub(super) fn said(term: Term) -> &'static str {
    match term {
        Term::Friction => "dry friction",
        Term::Amplifier => "lag of the amplifier",
        Term::Offset => "offset force",
        Term::Phase => "periodic error of the encoder",
    }
}

/// Probability that a standard normal value is beyond z.
pub(super) fn tail(z: f64) -> f64 {
    if z.is_nan() { 1.0 } else { Normal::standard().sf(z) }
}
