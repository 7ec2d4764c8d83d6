//! The estimators, one row each. `rows.rs` turns the rows into types and functions.
//!
//! A new estimator needs a file in this folder and its rows here. The integer form of the estimator implements
//! [`Form`]. Console, settings in flash, scenes, comparison and tests read all estimators from the table.

use super::{parameter::Number, rows::estimators, *}; // what the rows name
use crate::{Design, SettingsError, units::Velocity};

/// Does nothing. A call marks the branch of a usual estimator as likely.
#[inline(always)]
const fn usual() {}

estimators! {
    if all(), usual, Form::sealed {
        forms {
            /// Finite difference and low-pass.
            LowPass(Biquad) keeps filter;
        }
        names {
            /// Finite difference followed by a second-order Butterworth low-pass. This is the paper's estimator.
            Butterworth = 1, "butterworth" {
                /// Cutoff in Hz, as in the paper's equation (2). The range is 3.5e-5 to 0.499 of the sample rate.
                cutoff_hz: f64 = ("cutoff", "Hz", 1500.0),
            } => |design| LowPass(Biquad::low_pass(2, cutoff_hz, design.rate_hz, false)?);
            /// Like `butterworth`, but pre-warped, so that the -3 dB frequency of the digital filter is exactly the
            /// cutoff.
            ButterworthPrewarped = 2, "butterworth-prewarped" {
                /// Cutoff in Hz. The range is 3.5e-5 to 0.38 of the sample rate.
                cutoff_hz: f64 = ("cutoff", "Hz", 1500.0),
            } => |design| LowPass(Biquad::low_pass(2, cutoff_hz, design.rate_hz, true)?);
            /// Finite difference followed by a first-order low-pass.
            FirstOrder = 4, "first-order" {
                /// Cutoff of the analog low-pass, in Hz. The range is 3.5e-5 to 0.499 of the sample rate.
                cutoff_hz: f64 = ("cutoff", "Hz", 1500.0),
            } => |design| LowPass(Biquad::low_pass(1, cutoff_hz, design.rate_hz, false)?);
            /// Like `first-order`, but pre-warped, so that the -3 dB frequency of the digital filter is exactly the
            /// cutoff.
            FirstOrderPrewarped = 5, "first-order-prewarped" {
                /// Cutoff in Hz. The range is 3.5e-5 to 0.38 of the sample rate.
                cutoff_hz: f64 = ("cutoff", "Hz", 1500.0),
            } => |design| LowPass(Biquad::low_pass(1, cutoff_hz, design.rate_hz, true)?);
        }
    }
    if all(), core::hint::cold_path, Form::sealed {
        forms {
            /// Finite difference without a filter.
            Difference(Difference) keeps nothing;
        }
        names {
            /// Finite difference. The velocity is the number of counts since the last sample.
            Difference = 3, "difference" {} => |_| Difference(Difference);
        }
    }
    if feature = "estimators", core::hint::cold_path, called {
        forms {
            /// Weighted sum of the last differences.
            Fir(Fir) keeps history;
            /// Observer that knows the force.
            Observer(Observer) keeps observer;
        }
        names {
            /// Derivative of the polynomial of order 2 through the last samples.
            Taylor2 = 6, "taylor-2" {} => |_| Fir(FirDesign::taylor(2)?.quantise()),
                weights FirDesign::taylor(2)?;
            /// Derivative of the polynomial of order 3 through the last samples.
            Taylor3 = 7, "taylor-3" {} => |_| Fir(FirDesign::taylor(3)?.quantise()),
                weights FirDesign::taylor(3)?;
            /// Derivative of the straight line that fits the last samples best.
            LeastSquares1 = 8, "least-squares-1" {
                /// Length of the fit, from its oldest to its newest sample. The range is 1 to 64 samples.
                window_samples: u32 = ("window", "samples", 16.0),
            } => |_| Fir(FirDesign::least_squares(1, window_samples)?.quantise()),
                weights FirDesign::least_squares(1, window_samples)?;
            /// Derivative of the parabola that fits the last samples best.
            LeastSquares2 = 9, "least-squares-2" {
                /// Length of the fit, from its oldest to its newest sample. The range is 2 to 64 samples.
                window_samples: u32 = ("window", "samples", 16.0),
            } => |_| Fir(FirDesign::least_squares(2, window_samples)?.quantise()),
                weights FirDesign::least_squares(2, window_samples)?;
            /// Tracking loop (phase-locked loop), critically damped.
            TrackingLoop = 30, "tracking-loop" {
                /// Frequency of the two poles, in Hz. The range is 3.5e-5 to 0.25 of the sample rate.
                bandwidth_hz: f64 = ("bandwidth", "Hz", 500.0),
            } => |design| LowPass(TrackingLoop::new(bandwidth_hz, design.rate_hz)?.quantise());
            /// Extended-state observer that knows the force.
            Observer = 31, "observer" {
                /// Frequency of the three poles, in Hz. The range is 1e-3 to 0.2 of the sample rate.
                bandwidth_hz: f64 = ("bandwidth", "Hz", 500.0),
                /// Mass of the model, in kg. The range is 1e-3 to 100. The default is the mass of the paper's device.
                mass_kg: f64 = ("mass", "kg", 0.416),
            } needs Force => |design| Observer(
                ObserverDesign::of_mass(bandwidth_hz, mass_kg, design)?.quantise()
            );
        }
    }
    if feature = "time-stamps", core::hint::cold_path, called {
        forms {
            /// Counts between two edges, divided by the time between them.
            TimeStamps(TimeStamps) keeps time_stamps;
        }
        names {
            /// Velocity from the times of the encoder's edges.
            TimeStamps = 32, "time-stamps" {
                /// Shortest time of a measurement, in samples. The range is 1 to 62.
                span_samples: u32 = ("span", "samples", 8.0),
            } needs Edge => |_| TimeStamps(TimeStamps::new(span_samples)?);
        }
    }
    if feature = "estimators", core::hint::cold_path, called {
        forms {
            /// Observer that knows the acceleration.
            Fusion(Fusion) shares observer;
            /// First-order adaptive windowing (FOAW).
            Foaw(Foaw) shares history;
            /// Levant's robust exact differentiator.
            Levant(Levant) keeps levant;
            /// Kalman filter with steady gains.
            Kalman(Kalman) keeps kalman;
            /// Counts in a window of samples, divided by the window's length.
            WindowDifference(WindowDifference) keeps window;
            /// Two biquads in series.
            Cascade(Cascade) keeps cascade;
        }
        names {
            /// Position and acceleration, combined by an observer.
            Fusion = 33, "fusion" {
                /// Crossover frequency, in Hz. The range is 1e-3 to 0.2 of the sample rate. Below it the position has
                /// more weight, and above it the acceleration has more.
                crossover_hz: f64 = ("crossover", "Hz", 50.0),
            } needs Acceleration => |design| Fusion(Fusion(
                ObserverDesign::of_accelerometer(crossover_hz, design.rate_hz)?.quantise()
            ));
            /// First-order adaptive windowing. The velocity is the slope through both ends of the longest window whose
            /// samples lie on a line within the noise.
            FoawEnd = 10, "foaw-end" {
                /// Length of the longest window, from its oldest to its newest sample. The range is 1 to 32 samples.
                window_samples: u32 = ("window", "samples", 16.0),
                /// Largest distance of a sample from the line, in counts. The range is 0 to 1000, in steps of 1/16.
                noise_counts: f64 = ("noise", "counts", 1.0),
            } => |_| Foaw(Foaw::new(false, window_samples, noise_counts)?);
            /// First-order adaptive windowing. The velocity is the window's least-squares slope.
            FoawBest = 11, "foaw-best" {
                /// Length of the longest window, from its oldest to its newest sample. The range is 1 to 32 samples.
                window_samples: u32 = ("window", "samples", 16.0),
                /// Largest distance of a sample from the line, in counts. The range is 0 to 1000, in steps of 1/16.
                noise_counts: f64 = ("noise", "counts", 1.0),
            } => |_| Foaw(Foaw::new(true, window_samples, noise_counts)?);
            /// Levant's robust exact differentiator, discretised by the explicit Euler method.
            LevantExplicit = 12, "levant-explicit" {
                /// Largest acceleration C of the handle, in m/s^2. It must lie in 1e-6 to 1e4 counts per sample^2.
                acceleration_max_m_per_s2: f64 = ("acceleration_max", "m/s^2", 20.0),
                /// Gain of the square root, divided by sqrt(C). The range is 0.5 to 3.
                lambda_ratio: f64 = ("lambda_ratio", "1", 1.0),
            } => |design| Levant(
                LevantDesign::new(acceleration_max_m_per_s2, lambda_ratio, design)?.quantise(false)
            );
            /// Levant's robust exact differentiator, discretised by the implicit Euler method.
            LevantImplicit = 13, "levant-implicit" {
                /// Largest acceleration C of the handle, in m/s^2. It must lie in 1e-6 to 1e4 counts per sample^2.
                acceleration_max_m_per_s2: f64 = ("acceleration_max", "m/s^2", 20.0),
                /// Gain of the square root, divided by sqrt(C). The range is 0.5 to 3.
                lambda_ratio: f64 = ("lambda_ratio", "1", 1.0),
            } => |design| Levant(
                LevantDesign::new(acceleration_max_m_per_s2, lambda_ratio, design)?.quantise(true)
            );
            /// Steady-state Kalman filter with two states: position and velocity.
            Kalman2 = 14, "kalman-2" {
                /// RMS of the acceleration, which is assumed to differ from sample to sample, in m/s^2. Its range
                /// follows from sample rate and resolution.
                acceleration_rms_m_per_s2: f64 = ("acceleration_rms", "m/s^2", 20.0),
            } => |design| Kalman(
                KalmanDesign::two_states(acceleration_rms_m_per_s2, design)?.quantise()
            );
            /// Steady-state Kalman filter with three states: position, velocity and acceleration.
            Kalman3 = 15, "kalman-3" {
                /// RMS of the jerk, which is assumed to differ from sample to sample, in m/s^3. Its range follows from
                /// sample rate and resolution.
                jerk_rms_m_per_s3: f64 = ("jerk_rms", "m/s^3", 20_000.0),
            } => |design| Kalman(KalmanDesign::three_states(jerk_rms_m_per_s3, design)?.quantise());
            /// Finite difference followed by a low-pass of second order of any damping.
            SecondOrder = 17, "second-order" {
                /// Cutoff in Hz, without pre-warping. The range is 3.5e-5 to 0.499 of the sample rate. An undamped
                /// filter would resonate at this frequency.
                cutoff_hz: f64 = ("cutoff", "Hz", 1500.0),
                /// Quality factor Q, 0.3 to 2. Q = 0.707 gives a Butterworth filter, Q = 0.5 gives two equal poles.
                quality: f64 = ("quality", "1", 0.5),
            } => |design| LowPass(Biquad::second_order(cutoff_hz, quality, design.rate_hz)?);
            /// Finite difference and exponential smoothing, `y += (1 - p) (x - y)`, once or twice.
            Smoothing = 19, "smoothing" {
                /// Frequency of the slower pole p, in Hz. The range is 3.5e-5 to 0.25 of the sample rate.
                cutoff_hz: f64 = ("cutoff", "Hz", 500.0),
                /// Frequency of the second pole, divided by the frequency of pole p. The range is 1 to 1e6. At 1e6
                /// there is no second pole.
                ratio: f64 = ("ratio", "1", 1.0),
            } => |design| LowPass(
                TrackingLoop::smoothing(cutoff_hz, ratio, design.rate_hz)?.quantise()
            );
            /// Tracking loop whose output leads or lags.
            TrackingLead = 20, "tracking-lead" {
                /// Frequency of the two poles, in Hz. The range is 3.5e-5 to 0.25 of the sample rate.
                bandwidth_hz: f64 = ("bandwidth", "Hz", 500.0),
                /// Number of samples by which the output is extrapolated from its last change. The lowest value, -1, is
                /// a lag of one sample.
                lead: f64 = ("lead", "1", 0.0),
            } => |design| LowPass(TrackingLoop::led(bandwidth_hz, lead, design.rate_hz)?.quantise());
            /// Finite difference and a biquad that is designed for a device, with two poles, a lead and a second zero.
            Biquad = 21, "biquad" {
                /// Frequency of the poles, in Hz. The range is 3.5e-5 to 0.2 of the sample rate.
                frequency_hz: f64 = ("frequency", "Hz", 700.0),
                /// Damping ratio of the poles, 0.02 to 4.
                damping: f64 = ("damping", "1", 0.5),
                /// Time by which the velocity of a slow motion leads, in s. The range follows from the other
                /// parameters.
                lead_s: f64 = ("lead", "s", 0.0),
                /// Position of the second zero in the z plane, -1 to 0.98. At -1 the zero suppresses half the sample
                /// rate. At 0 there is no zero.
                zero: f64 = ("zero", "1", 0.0),
            } => |design| LowPass(
                BiquadDesign::new(frequency_hz, damping, lead_s, zero, design.rate_hz)?.quantise()
            );
            /// Like `biquad`, but a second biquad follows the first.
            Biquad2 = 22, "biquad-2" {
                /// Frequency of the first section's poles, in Hz. The range is 3.5e-5 to 0.2 of the sample rate.
                frequency_hz: f64 = ("frequency", "Hz", 700.0),
                /// Damping ratio of the first section's poles, 0.02 to 4.
                damping: f64 = ("damping", "1", 0.5),
                /// Time by which the first section leads in a slow motion, in s. The range follows from the other
                /// parameters.
                lead_s: f64 = ("lead", "s", 0.0),
                /// Position of the first section's second zero in the z plane, -1 to 0.98.
                zero: f64 = ("zero", "1", 0.0),
                /// Frequency of the second section's poles, divided by the frequency of the first section's poles.
                second_ratio: f64 = ("second_ratio", "1", 1.0),
                /// Damping ratio of the second section's poles, 0.02 to 4.
                second_damping: f64 = ("second_damping", "1", 1.0),
                /// Time by which the second section leads in a slow motion, in s.
                second_lead_s: f64 = ("second_lead", "s", 0.0),
                /// Position of the second section's second zero in the z plane, -1 to 0.98.
                second_zero: f64 = ("second_zero", "1", 0.0),
            } => |design| Cascade(
                CascadeDesign::new(
                    [frequency_hz, damping, lead_s, zero],
                    [second_ratio, second_damping, second_lead_s, second_zero],
                    design.rate_hz,
                )?.quantise()
            );
            /// Counts in a window of samples, divided by its time.
            WindowDifference = 18, "window-difference" {
                /// Samples of the window, 1 to 255.
                window_samples: u32 = ("window", "samples", 16.0),
            } => |_| WindowDifference(WindowDifference::new(window_samples)?);
        }
    }
}
