//! Which estimator, and its parameters in SI units. Every estimator but the finite difference and
//! the low-passes is a Cargo feature of its name; a build without it does not know it.

#[cfg(any(feature = "taylor", feature = "least-squares"))]
use super::Fir;
#[cfg(any(feature = "observer", feature = "fusion"))]
use super::ObserverDesign;
#[cfg(feature = "tracking-loop")]
use super::TrackingLoop;
use super::{Design, Estimator, FirstOrder};
#[cfg(feature = "time-stamps")]
use super::{SPAN_MAX, TimeStamps};
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
    /// Tracking loop (phase-locked loop), critically damped.
    #[cfg(feature = "tracking-loop")]
    TrackingLoop {
        /// Frequency of both its poles, Hz: 3.5e-5 to 0.25 of the rate.
        bandwidth_hz: f64,
    },
    /// Extended-state observer that knows the force.
    #[cfg(feature = "observer")]
    Observer {
        /// Frequency of its three poles, Hz: 1e-3 to 0.2 of the rate.
        bandwidth_hz: f64,
        /// Mass of the model, kg: 1e-3 to 100.
        mass_kg: f64,
    },
    /// Times of the encoder's edges.
    #[cfg(feature = "time-stamps")]
    TimeStamps {
        /// Shortest time that it measures over, samples: 1 to 62.
        span_samples: u32,
    },
    /// Position and acceleration.
    #[cfg(feature = "fusion")]
    Fusion {
        /// Frequency between position (below) and acceleration (above), Hz: 1e-3 to 0.2 of the rate.
        crossover_hz: f64,
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
            #[cfg(feature = "tracking-loop")]
            Self::TrackingLoop { bandwidth_hz } => {
                Estimator::LowPass(TrackingLoop::new(bandwidth_hz, rate_hz)?.quantise())
            }
            #[cfg(feature = "observer")]
            Self::Observer { bandwidth_hz, mass_kg } => Estimator::Observer(
                ObserverDesign::of_mass(bandwidth_hz, mass_kg, design)?.quantise(),
            ),
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps { span_samples } => {
                settings::within("span_samples", span_samples.into(), 1.0..=f64::from(SPAN_MAX))?;
                Estimator::TimeStamps(TimeStamps::over(span_samples))
            }
            #[cfg(feature = "fusion")]
            Self::Fusion { crossover_hz } => Estimator::Fusion(
                ObserverDesign::of_accelerometer(crossover_hz, rate_hz)?.quantise(),
            ),
        })
    }
}
