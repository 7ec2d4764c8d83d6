//! Which estimator, and its parameters in SI units. Every estimator but the finite difference and
//! the low-passes is a Cargo feature of its name; a build without it does not know it.

#[cfg(any(feature = "taylor", feature = "least-squares"))]
use super::FirDesign;
#[cfg(feature = "foaw")]
use super::Foaw;
#[cfg(feature = "kalman")]
use super::KalmanDesign;
#[cfg(feature = "levant")]
use super::LevantDesign;
#[cfg(any(feature = "observer", feature = "fusion"))]
use super::ObserverDesign;
#[cfg(feature = "time-stamps")]
use super::SPAN_MAX;
#[cfg(feature = "time-stamps")]
use super::TimeStamps;
#[cfg(feature = "tracking-loop")]
use super::TrackingLoop;
use super::{ButterworthDesign, Estimator, FirstOrder};
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
    /// First-order adaptive windowing: the longest window that a line fits to within the noise.
    #[cfg(feature = "foaw")]
    Foaw {
        /// The slope is the least-squares fit of the window (best fit), not the line through its ends.
        best: bool,
        /// Longest window: samples from its oldest to its newest, 1 to 32.
        window_samples: u32,
        /// Largest distance of a sample from the line, counts, 0 to 1000; rounded to 1/16.
        noise_counts: f64,
    },
    /// Levant's robust exact differentiator.
    #[cfg(feature = "levant")]
    Levant {
        /// Discretised by the implicit, not the explicit Euler method.
        implicit: bool,
        /// Largest acceleration C of the handle, m/s^2.
        acceleration_max_m_per_s2: f64,
        /// Gain of the square root over sqrt(C), 0.5 to 3.
        lambda_ratio: f64,
    },
    /// Steady-state Kalman filter with two states: position and velocity.
    #[cfg(feature = "kalman")]
    Kalman2 {
        /// Acceleration that differs from sample to sample, RMS, m/s^2.
        acceleration_rms_m_per_s2: f64,
    },
    /// Steady-state Kalman filter with three states: position, velocity and acceleration.
    #[cfg(feature = "kalman")]
    Kalman3 {
        /// Jerk that differs from sample to sample, RMS, m/s^3.
        jerk_rms_m_per_s3: f64,
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
                Estimator::LowPass(ButterworthDesign::new(cutoff_hz, rate_hz, prewarp)?.quantise())
            }
            Self::FirstOrder { cutoff_hz, prewarp } => {
                Estimator::LowPass(FirstOrder::new(cutoff_hz, rate_hz, prewarp)?.quantise())
            }
            Self::Difference => Estimator::Difference,
            #[cfg(feature = "taylor")]
            Self::Taylor { order } => {
                settings::within("order", f64::from(order), 2.0..=3.0)?;
                Estimator::Fir(FirDesign::taylor(order)?.quantise())
            }
            #[cfg(feature = "least-squares")]
            Self::LeastSquares { degree, window_samples } => {
                Estimator::Fir(FirDesign::least_squares(degree, window_samples)?.quantise())
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
            #[cfg(feature = "foaw")]
            Self::Foaw { best, window_samples, noise_counts } => {
                Estimator::Foaw(Foaw::new(best, window_samples, noise_counts)?)
            }
            #[cfg(feature = "levant")]
            Self::Levant { implicit, acceleration_max_m_per_s2, lambda_ratio } => {
                let sizes = LevantDesign::new(acceleration_max_m_per_s2, lambda_ratio, design)?;
                Estimator::Levant(sizes.quantise(implicit))
            }
            #[cfg(feature = "kalman")]
            Self::Kalman2 { acceleration_rms_m_per_s2 } => Estimator::Kalman(
                KalmanDesign::two_states(acceleration_rms_m_per_s2, design)?.quantise(),
            ),
            #[cfg(feature = "kalman")]
            Self::Kalman3 { jerk_rms_m_per_s3 } => {
                Estimator::Kalman(KalmanDesign::three_states(jerk_rms_m_per_s3, design)?.quantise())
            }
        })
    }
}
