//! When a filter would do: what it adds is less than what the encoder leaves in the exact filter's output anyway.

use super::{
    LSB_PER_COUNT,
    filters::{Exact, Measured},
};

/// What a filter can miss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Criterion {
    /// Error of the response.
    Response,
    /// Error of the -3 dB frequency.
    Cutoff,
    /// DC bias.
    Bias,
    /// Noise.
    Noise,
    /// Limit cycle.
    Rest,
    /// Area.
    Area,
}

/// Largest `abs(H - H_exact)`: 1 %.
pub const RESPONSE: f64 = 0.01;
/// Largest relative error of the -3 dB frequency: 1 %, what the core accepts of itself.
pub const CUTOFF: f64 = 0.01;
/// Largest bias, noise or limit cycle, as a share of the RMS that the encoder leaves: noise then adds 0.5 % to it. One LSB
/// of the core's velocity is always allowed, since the wall gets no more digits.
pub const NOISE: f64 = 0.1;
/// Largest change of the area, beyond the spread of the exact filter's own area over the starts.
pub const AREA: f64 = 0.02;

const LSB: f64 = 1.0 / LSB_PER_COUNT;

impl Criterion {
    /// All.
    pub const ALL: [Self; 6] =
        [Self::Response, Self::Cutoff, Self::Bias, Self::Noise, Self::Rest, Self::Area];

    /// Name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Response => "response",
            Self::Cutoff => "-3 dB",
            Self::Bias => "bias",
            Self::Noise => "noise",
            Self::Rest => "limit cycle",
            Self::Area => "area",
        }
    }

    /// Whether it is missed.
    pub fn missed(self, measured: &Measured, exact: &Exact) -> bool {
        let beyond = |value: f64, limit: f64| value.is_nan() || value > limit;
        let at_rest = (NOISE * exact.encoder.at_rest).max(LSB);
        let in_motion = (NOISE * exact.encoder.in_motion).max(LSB);
        match self {
            Self::Response => beyond(measured.response.error, RESPONSE),
            // above 0.45 of the rate no sine is measured, and the response says it
            Self::Cutoff => {
                exact.has_cutoff
                    && measured.response.cutoff_error.is_none_or(|e| beyond(e.abs(), CUTOFF))
            }
            Self::Bias => beyond(measured.bias_counts(), in_motion),
            Self::Noise => {
                beyond(measured.noise.at_rest, at_rest)
                    || beyond(measured.noise.in_motion, in_motion)
            }
            Self::Rest => beyond(measured.rest_counts, at_rest),
            Self::Area => {
                let change = measured.area_change.unwrap_or(0.0);
                beyond(change.abs(), AREA + exact.area_spread)
            }
        }
    }
}
