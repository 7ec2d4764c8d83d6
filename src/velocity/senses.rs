//! What an estimator may use beside the position.

use crate::units::{Acceleration, Force};

/// What an estimator may use beside the position, at a sample. The board or simulator fills in what it has. An
/// estimator that needs something else is not offered ([`Sense`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Senses {
    /// Mean force on the handle since the last sample, as far as the controller knows: saturated,
    /// held, and taken as acting since then.
    pub force: Force,
    /// Mean acceleration of the handle since the last sample, as measured.
    pub acceleration: Acceleration,
    /// The latest edge of the encoder's signals; `None` before the first one.
    pub edge: Option<Edge>,
}

impl Senses {
    /// Nothing but the position.
    pub const NONE: Self =
        Self { force: Force::ZERO, acceleration: Acceleration::ZERO, edge: None };
}

/// The latest edge of the encoder's signals.
///
/// The encoder rounds down: after an edge up to the count c the handle was at exactly c counts, after an edge down to c
/// at c + 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// How long before the sample it came, in 2^-16 samples, rounded down, saturating. Below [`Edge::SAMPLE`] it came
    /// since the last sample.
    pub age: u32,
    /// The count went up with it.
    pub up: bool,
}

impl Edge {
    /// Fractional bits of the age.
    pub const FRACTION_BITS: u32 = 16;
    /// Age of one sample.
    pub const SAMPLE: u32 = 1 << Self::FRACTION_BITS;
}

/// A sense beside the position that an estimator cannot do without.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sense {
    /// The force of the motor, [`Senses::force`].
    Force,
    /// The acceleration of the handle, [`Senses::acceleration`].
    Acceleration,
    /// The latest edge, [`Senses::edge`].
    Edge,
}

impl Sense {
    /// Its name, for people.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Force => "force",
            Self::Acceleration => "acceleration",
            Self::Edge => "edge times",
        }
    }
}
