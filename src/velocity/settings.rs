//! Which estimator, and its parameters in SI units. Every estimator but the finite difference and
//! the low-passes is a Cargo feature of its name; a build without it does not know it.

#[cfg(any(feature = "taylor", feature = "least-squares"))]
use super::Fir;
use super::{Design, Estimator, FirstOrder};
use crate::settings::{self, SettingsError};

/// Which estimator, and its parameters in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VelocitySettings {
    /// Finite difference followed by a second-order Butterworth low-pass; the paper's estimator.
    Butterworth {
        /// Cutoff in Hz, as it stands in the paper's equation (2).
        cutoff_hz: f64,
        /// Pre-warp, so that the -3 dB frequency of the digital filter is the cutoff itself.
        prewarp: bool,
    },
    /// Finite difference followed by a first-order low-pass.
    FirstOrder {
        /// Cutoff in Hz of the analog low-pass.
        cutoff_hz: f64,
        /// Pre-warp, so that the -3 dB frequency of the digital filter is the cutoff itself.
        prewarp: bool,
    },
    /// Finite difference: the counts since the last sample.
    Difference,
    /// Derivative of the polynomial through the last samples.
    #[cfg(feature = "taylor")]
    Taylor {
        /// Order of the polynomial, 2 or 3.
        order: u32,
    },
    /// Derivative of the polynomial that fits the last samples best.
    #[cfg(feature = "least-squares")]
    LeastSquares {
        /// Degree of the polynomial, 1 or 2.
        degree: u32,
        /// Samples between the oldest and the newest of the fit, `degree` to 64.
        window_samples: u32,
    },
}

impl VelocitySettings {
    /// The estimator's integer form for that device.
    ///
    /// # Errors
    /// Names the parameter that is out of range, and the range.
    pub fn build(&self, design: &settings::Design) -> Result<Estimator, SettingsError> {
        let rate_hz = design.rate_hz;
        Ok(match *self {
            Self::Butterworth { cutoff_hz, prewarp } => {
                Estimator::LowPass(Design::new(cutoff_hz, rate_hz, prewarp)?.quantise())
            }
            Self::FirstOrder { cutoff_hz, prewarp } => {
                Estimator::LowPass(FirstOrder::new(cutoff_hz, rate_hz, prewarp)?.quantise())
            }
            Self::Difference => Estimator::Difference,
            #[cfg(feature = "taylor")]
            Self::Taylor { order } => {
                settings::within("order", f64::from(order), 2.0..=3.0)?;
                Estimator::Fir(Fir::taylor(order)?)
            }
            #[cfg(feature = "least-squares")]
            Self::LeastSquares { degree, window_samples } => {
                Estimator::Fir(Fir::least_squares(degree, window_samples)?)
            }
        })
    }
}
