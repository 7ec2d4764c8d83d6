//! When a filter would do: what it adds is less than what the encoder leaves in the exact filter's output anyway.

use super::{LSB_PER_COUNT, drift, larger, noise::Noise, response::Response};

/// What was measured of a filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    pub response: Response,
    /// DC drift over `drift::SAMPLES`, counts.
    pub drift_counts: f64,
    /// Distance from the exact filter, counts per sample.
    pub noise: Noise,
    /// Largest output after a stop, counts per sample.
    pub rest_counts: f64,
    /// Largest speed without overflow, counts per sample; `None` if the filter is too wrong to tell.
    pub headroom_counts: Option<f64>,
    /// Mean area, N^2 s/m^2.
    pub area: Option<f64>,
    /// Against the exact filter's, relative; `None` where that has none.
    pub area_change: Option<f64>,
}

impl Measured {
    /// Mean error of a constant speed, counts per sample; 10^-6 of it is the ripple of the counts.
    pub fn bias_counts(&self) -> f64 {
        self.drift_counts / f64::from(drift::SAMPLES)
    }
}

/// What all filters of one cutoff are held against.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exact {
    /// Nominal cutoff of the filters, Hz.
    pub cutoff_hz: f64,
    /// The -3 dB frequency is in the band that is measured.
    pub has_cutoff: bool,
    /// What the encoder leaves in the exact filter's output, counts per sample.
    pub encoder: Noise,
    /// Mean area with the filter in `f64`, N^2 s/m^2.
    pub area: f64,
    /// Its spread over the starts, relative.
    pub area_spread: f64,
}

/// What a filter can miss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Criterion {
    /// Error of the response.
    Response,
    /// Error of the -3 dB frequency.
    Cutoff,
    /// Mean error of a constant speed.
    Bias,
    Noise,
    /// Limit cycle after a stop.
    Rest,
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

/// What is allowed where the encoder leaves an RMS of `encoder`, both in counts per sample.
pub fn allowed_noise(encoder: f64) -> f64 {
    (NOISE * encoder).max(LSB)
}

impl Criterion {
    pub const ALL: [Self; 6] =
        [Self::Response, Self::Cutoff, Self::Bias, Self::Noise, Self::Rest, Self::Area];

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

    /// The error over what is allowed: missed above 1, infinite if the filter has blown up. `None` where the criterion does not
    /// apply: the -3 dB frequency is above the band that is measured, or the exact filter has no area.
    pub fn share(self, measured: &Measured, exact: &Exact) -> Option<f64> {
        // no number is as bad as it gets
        let of = |error: f64, allowed: f64| larger(0.0, error.abs() / allowed);
        let at_rest = allowed_noise(exact.encoder.at_rest);
        let in_motion = allowed_noise(exact.encoder.in_motion);
        match self {
            Self::Response => Some(of(measured.response.error, RESPONSE)),
            // above 0.45 of the rate no sine is measured, and the response says it
            Self::Cutoff => exact
                .has_cutoff
                .then(|| of(measured.response.cutoff_error.unwrap_or(f64::INFINITY), CUTOFF)),
            Self::Bias => Some(of(measured.bias_counts(), in_motion)),
            Self::Noise => Some(larger(
                of(measured.noise.at_rest, at_rest),
                of(measured.noise.in_motion, in_motion),
            )),
            Self::Rest => Some(of(measured.rest_counts, at_rest)),
            Self::Area => measured.area_change.map(|change| of(change, AREA + exact.area_spread)),
        }
    }

    /// Whether it is missed.
    pub fn missed(self, measured: &Measured, exact: &Exact) -> bool {
        self.share(measured, exact).is_some_and(|share| share > 1.0)
    }
}
