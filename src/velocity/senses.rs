//! Senses that an estimator may use beside the position.

use crate::units::{Acceleration, Force};

/// Values of the senses beside the position at a sample. The board or the simulator fills in the senses that it has. An
/// estimator that needs another sense is not offered ([`Sense`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Senses {
    /// Mean force on the handle since the last sample, as the controller knows it: saturated, held, and assumed to act
    /// since then.
    pub force: Force,
    /// Mean measured acceleration of the handle since the last sample.
    pub acceleration: Acceleration,
    /// The latest edge of the encoder's signals; `None` before the first edge.
    pub edge: Option<Edge>,
}

impl Senses {
    /// No sense but the position.
    pub const NONE: Self =
        Self { force: Force::ZERO, acceleration: Acceleration::ZERO, edge: None };
}

/// The latest edge of the encoder's signals.
///
/// The encoder rounds down. After an edge up to the count c the handle was at exactly c counts. After an edge down to c
/// the handle was at exactly c + 1 counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Time from the edge to the sample, 2^-16 samples, rounded down, saturating. Below [`Edge::SAMPLE`] the edge came
    /// since the last sample.
    pub age: u32,
    /// Whether the count went up with the edge.
    pub up: bool,
}

impl Edge {
    /// Fractional bits of the age.
    pub const FRACTION_BITS: u32 = 16;
    /// Age of one sample.
    pub const SAMPLE: u32 = 1 << Self::FRACTION_BITS;
}

/// A sense beside the position that an estimator needs.
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
    /// Name of the sense for people.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Force => "force",
            Self::Acceleration => "acceleration",
            Self::Edge => "edge times",
        }
    }
}
