//! The finite difference. Its velocity is the number of counts since the last sample.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Form, Senses};
use crate::units::Velocity;

/// The finite difference. It has no coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Difference;

impl Form for Difference {
    type State = ();
    const REST: () = ();

    fn at(&self, _: Velocity) {}

    #[inline]
    fn step(&self, (): &mut (), difference: i32, _: &Senses) -> Velocity {
        Velocity::saturating_from_counts(difference)
    }
}
