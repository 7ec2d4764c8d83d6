//! The senses that an estimator may use in addition to the position.

use crate::units::{Acceleration, Force};

/// What the senses read at a sample, apart from the position. The board or the simulator fills in the senses that it
/// has. It does not offer an estimator that needs another [`Sense`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Senses {
    /// Mean force on the handle since the last sample, as the controller knows it. It is the commanded force after
    /// saturation. This force is held constant, and is assumed to act without delay.
    pub force: Force,
    /// Mean measured acceleration of the handle since the last sample.
    pub acceleration: Acceleration,
    /// The latest edge of the encoder's signals, or `None` before the first edge.
    pub edge: Option<Edge>,
}

impl Senses {
    /// The values if there is no sense apart from the position.
    pub const NONE: Self =
        Self { force: Force::ZERO, acceleration: Acceleration::ZERO, edge: None };
}

/// The latest edge of the encoder's signals.
///
/// The encoder rounds down. After an edge up to the count c the handle was at exactly c counts. After an edge down to c
/// the handle was at exactly c + 1 counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Time from the edge to the sample, in 2^-16 samples. It is rounded down, and saturates. If it is below
    /// [`Edge::SAMPLE`], the edge came after the last sample.
    pub age: u32,
    /// Whether the count went up with the edge.
    pub up: bool,
}

impl Edge {
    /// Fractional bits of the age.
    pub const FRACTION_BITS: u32 = 16;
    /// The age of an edge that came exactly one sample ago.
    pub const SAMPLE: u32 = 1 << Self::FRACTION_BITS;
}

/// A sense, apart from the position, that an estimator may need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sense {
    /// The force of the motor, see [`Senses::force`].
    Force,
    /// The acceleration of the handle, see [`Senses::acceleration`].
    Acceleration,
    /// The time of the encoder's latest edge, see [`Senses::edge`].
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
