//! Criteria for a filter. A filter is good enough if its own error in the output is smaller than the error that the
//! encoder causes there.

use super::{LSB_PER_COUNT, drift, larger, noise::Noise, response::Response};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    pub response: Response,
    /// DC drift over `drift::SAMPLES`, in counts.
    pub drift_counts: f64,
    /// RMS distance of the output from the exact filter's output, in counts per sample.
    pub noise: Noise,
    /// Largest output after a stop, in counts per sample.
    pub rest_counts: f64,
    /// Largest speed without overflow, in counts per sample. `None` if other errors of the filter hide the overflow.
    pub headroom_counts: Option<f64>,
    /// Mean area under the boundary, in N^2 s/m^2.
    pub area: Option<f64>,
    /// Relative difference of this area from the area with the exact filter. `None` if the exact filter has no area.
    pub area_change: Option<f64>,
}

impl Measured {
    /// Mean error at a constant speed, in counts per sample. The ripple of the counts adds 10^-6.
    pub fn bias_counts(&self) -> f64 {
        self.drift_counts / f64::from(drift::SAMPLES)
    }
}

/// Reference values of all filters at one cutoff.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exact {
    /// Nominal cutoff of the filters, in Hz.
    pub cutoff_hz: f64,
    /// Whether the -3 dB frequency is low enough to be measured.
    pub has_cutoff: bool,
    /// Noise of the encoder in the output of the exact filter, in counts per sample.
    pub encoder: Noise,
    /// Mean area with the filter in `f64`, in N^2 s/m^2.
    pub area: f64,
    /// Spread of the area over the start positions, relative to the mean area.
    pub area_spread: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Criterion {
    /// Error of the response.
    Response,
    /// Error of the -3 dB frequency.
    Cutoff,
    /// Mean error at a constant speed.
    Bias,
    Noise,
    /// The limit cycle that remains after a stop.
    Rest,
    Area,
}

/// Largest allowed `abs(H - H_exact)`: 1 %.
pub const RESPONSE: f64 = 0.01;
/// Largest allowed relative error of the -3 dB frequency: 1 %. The core has the same limit for its own filter.
pub const CUTOFF: f64 = 0.01;
/// Largest allowed bias, noise or limit cycle, as a share of the RMS that the encoder causes. Noise of this size
/// increases that RMS by 0.5 %. One LSB of the core's velocity is always allowed, because the wall gets no finer
/// velocity.
pub const NOISE: f64 = 0.1;
/// Largest allowed change of the area. The spread of the exact filter's area is added to this limit.
pub const AREA: f64 = 0.02;

const LSB: f64 = 1.0 / LSB_PER_COUNT;

/// The allowed error if the encoder causes an RMS of `encoder`. Error and RMS are in counts per sample.
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

    /// The error divided by the allowed error. Above 1, the filter exceeds the criterion. The quotient is infinite if
    /// the filter diverges. `None` if the -3 dB frequency is above the measured band, or if the exact filter has no
    /// area.
    pub fn share(self, measured: &Measured, exact: &Exact) -> Option<f64> {
        // NaN counts as an infinite error.
        let of = |error: f64, allowed: f64| larger(0.0, error.abs() / allowed);
        let at_rest = allowed_noise(exact.encoder.at_rest);
        let in_motion = allowed_noise(exact.encoder.in_motion);
        match self {
            Self::Response => Some(of(measured.response.error, RESPONSE)),
            // Sines are measured up to 0.45 of the rate. Above this, only the error of the response is known.
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

    /// Whether the filter exceeds this criterion.
    pub fn missed(self, measured: &Measured, exact: &Exact) -> bool {
        self.share(measured, exact).is_some_and(|share| share > 1.0)
    }
}
