//! A low-pass beside a position that the unfiltered difference extrapolates: where the handle will be some samples later,
//! if it goes on as since the last sample.
//!
//! ```text
//! d = x[n] - x[n-1],   velocity = low-pass of d,   offset = lead d
//! ```
//!
//! To the wall that is a second damper, behind no filter: `K (x + lead d) + B v = K x + K lead T (d/T) + B v`. So a
//! stiffer wall is damped more, by a velocity that is neither late nor smooth. A windowing estimator that divides by the
//! wrong time does the same (docs/estimators-measured.md, *The published order*).

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Biquad, Form, Senses, biquad::BiquadState};
use crate::{
    range::{SettingsError, within},
    units::{Offset, Velocity},
};

/// Longest lead that is accepted, samples.
pub const AHEAD_MAX: f64 = 100.0;

/// Low-pass and lead; made by [`new`](Self::new).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ahead {
    filter: Biquad,
    /// Samples, 16 fractional bits.
    lead: i32,
}

impl Ahead {
    /// Beside that filter, for a lead of 0 to [`AHEAD_MAX`] samples, rounded to 2^-16 of one.
    ///
    /// # Errors
    /// Names the parameter and its range.
    #[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
    pub fn new(filter: Biquad, lead: f64) -> Result<Self, SettingsError> {
        within("lead", lead, 0.0..=AHEAD_MAX)?;
        #[expect(clippy::cast_possible_truncation, reason = "at most 100 x 2^16")]
        let lead = libm::round(lead * f64::from(1u32 << Offset::FRACTION_BITS)) as i32;
        Ok(Self { filter, lead })
    }

    /// The low-pass.
    pub const fn filter(&self) -> &Biquad {
        &self.filter
    }

    /// The lead, LSB of an [`Offset`] per count of the last difference.
    pub const fn lead_bits(&self) -> i32 {
        self.lead
    }
}

impl Form for Ahead {
    type State = BiquadState;
    const REST: BiquadState = Biquad::REST;

    fn at(&self, velocity: Velocity) -> BiquadState {
        self.filter.at(velocity)
    }

    #[inline]
    fn step(&self, state: &mut BiquadState, difference: i32, senses: &Senses) -> Velocity {
        self.filter.step(state, difference, senses)
    }

    fn offset(&self, state: &BiquadState) -> Offset {
        let moved = i64::from(state.input()) * i64::from(self.lead);
        Offset::saturating_from_bits(moved >> Velocity::FRACTION_BITS)
    }
}
