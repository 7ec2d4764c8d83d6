//! EstimatorChoice estimators as a scene names them, and as the linear analysis sees them.

use serde::{Deserialize, Serialize};
use zwidth::{
    Design, SettingsError, VelocitySettings,
    velocity::{FirDesign, KalmanDesign, ObserverDesign, Sense, TrackingLoop, true_cutoff_hz},
};

use crate::analysis::linear::{Order, TransferFunction};

/// EstimatorChoice estimator. Where it is tuned by a cutoff, that comes from the command line or from
/// `[sweep]`; every other parameter stands here.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "estimator", rename_all = "kebab-case", deny_unknown_fields)]
pub enum EstimatorChoice {
    /// Finite difference and second-order Butterworth.
    Butterworth {
        /// Pre-warp the cutoff.
        #[serde(default)]
        prewarp: bool,
    },
    /// Finite difference and first-order low-pass.
    FirstOrder {
        /// Pre-warp the cutoff.
        #[serde(default)]
        prewarp: bool,
    },
    /// Finite difference.
    Difference {},
    /// Backward difference of a higher order.
    Taylor {
        /// 2 or 3.
        order: u32,
    },
    /// Least-squares fit of a polynomial.
    LeastSquares {
        /// Degree, 1 or 2.
        degree: u32,
        /// Samples from the oldest to the newest, up to 64.
        window_samples: u32,
    },
    /// Tracking loop; the cutoff is its bandwidth.
    TrackingLoop {},
    /// Extended-state observer under the commanded force; the cutoff is its bandwidth.
    Observer {
        /// Mass of its model, kg.
        mass_kg: f64,
    },
    /// Times of the encoder's edges.
    TimeStamps {
        /// Shortest time that it measures over, samples, up to 62.
        span_samples: u32,
    },
    /// Position and acceleration; the cutoff is the crossover. Needs a table `[accelerometer]`.
    Fusion {},
    /// First-order adaptive windowing, the line through the window's ends.
    FoawEnd {
        /// Longest window: samples from the oldest to the newest, 1 to 32.
        window_samples: u32,
        /// Largest distance of a sample from the line, counts, 0 to 1000.
        #[serde(default = "one")]
        noise_counts: f64,
    },
    /// First-order adaptive windowing, the window's least-squares slope.
    FoawBest {
        /// Longest window: samples from the oldest to the newest, 1 to 32.
        window_samples: u32,
        /// Largest distance of a sample from the line, counts, 0 to 1000.
        #[serde(default = "one")]
        noise_counts: f64,
    },
    /// Levant's differentiator, explicit Euler.
    LevantExplicit {
        /// Largest acceleration C of the handle, m/s^2.
        acceleration_max_m_per_s2: f64,
        /// Gain of the square root over sqrt(C), 0.5 to 3.
        #[serde(default = "one")]
        lambda_ratio: f64,
    },
    /// Levant's differentiator, implicit Euler.
    LevantImplicit {
        /// Largest acceleration C of the handle, m/s^2.
        acceleration_max_m_per_s2: f64,
        /// Gain of the square root over sqrt(C), 0.5 to 3.
        #[serde(default = "one")]
        lambda_ratio: f64,
    },
    /// Steady-state Kalman filter of position and velocity.
    #[serde(rename = "kalman-2")]
    Kalman2 {
        /// Acceleration that differs from sample to sample, RMS, m/s^2.
        acceleration_rms_m_per_s2: f64,
    },
    /// Steady-state Kalman filter of position, velocity and acceleration.
    #[serde(rename = "kalman-3")]
    Kalman3 {
        /// Jerk that differs from sample to sample, RMS, m/s^3.
        jerk_rms_m_per_s3: f64,
    },
}

fn one() -> f64 {
    1.0
}

impl EstimatorChoice {
    /// The core's settings; `cutoff_hz` is for estimators that have a cutoff.
    pub fn settings(self, cutoff_hz: f64) -> VelocitySettings {
        match self {
            Self::Butterworth { prewarp } => VelocitySettings::Butterworth { cutoff_hz, prewarp },
            Self::FirstOrder { prewarp } => VelocitySettings::FirstOrder { cutoff_hz, prewarp },
            Self::Difference {} => VelocitySettings::Difference,
            Self::Taylor { order } => VelocitySettings::Taylor { order },
            Self::LeastSquares { degree, window_samples } => {
                VelocitySettings::LeastSquares { degree, window_samples }
            }
            Self::TrackingLoop {} => VelocitySettings::TrackingLoop { bandwidth_hz: cutoff_hz },
            Self::Observer { mass_kg } => {
                VelocitySettings::Observer { bandwidth_hz: cutoff_hz, mass_kg }
            }
            Self::TimeStamps { span_samples } => VelocitySettings::TimeStamps { span_samples },
            Self::Fusion {} => VelocitySettings::Fusion { crossover_hz: cutoff_hz },
            Self::FoawEnd { window_samples, noise_counts } => {
                VelocitySettings::Foaw { best: false, window_samples, noise_counts }
            }
            Self::FoawBest { window_samples, noise_counts } => {
                VelocitySettings::Foaw { best: true, window_samples, noise_counts }
            }
            Self::LevantExplicit { acceleration_max_m_per_s2, lambda_ratio } => {
                let implicit = false;
                VelocitySettings::Levant { implicit, acceleration_max_m_per_s2, lambda_ratio }
            }
            Self::LevantImplicit { acceleration_max_m_per_s2, lambda_ratio } => {
                let implicit = true;
                VelocitySettings::Levant { implicit, acceleration_max_m_per_s2, lambda_ratio }
            }
            Self::Kalman2 { acceleration_rms_m_per_s2 } => {
                VelocitySettings::Kalman2 { acceleration_rms_m_per_s2 }
            }
            Self::Kalman3 { jerk_rms_m_per_s3 } => VelocitySettings::Kalman3 { jerk_rms_m_per_s3 },
        }
    }

    /// What the estimator cannot do without, beside the position.
    pub fn sense(self) -> Option<Sense> {
        self.settings(0.0).name().sense()
    }

    /// The scene's form of those settings, and their cutoff if they have one.
    pub fn of(settings: &VelocitySettings) -> (Self, Option<f64>) {
        match *settings {
            VelocitySettings::Butterworth { cutoff_hz, prewarp } => {
                (Self::Butterworth { prewarp }, Some(cutoff_hz))
            }
            VelocitySettings::FirstOrder { cutoff_hz, prewarp } => {
                (Self::FirstOrder { prewarp }, Some(cutoff_hz))
            }
            VelocitySettings::Difference => (Self::Difference {}, None),
            VelocitySettings::Taylor { order } => (Self::Taylor { order }, None),
            VelocitySettings::LeastSquares { degree, window_samples } => {
                (Self::LeastSquares { degree, window_samples }, None)
            }
            VelocitySettings::TrackingLoop { bandwidth_hz } => {
                (Self::TrackingLoop {}, Some(bandwidth_hz))
            }
            VelocitySettings::Observer { bandwidth_hz, mass_kg } => {
                (Self::Observer { mass_kg }, Some(bandwidth_hz))
            }
            VelocitySettings::TimeStamps { span_samples } => {
                (Self::TimeStamps { span_samples }, None)
            }
            VelocitySettings::Fusion { crossover_hz } => (Self::Fusion {}, Some(crossover_hz)),
            VelocitySettings::Foaw { best: false, window_samples, noise_counts } => {
                (Self::FoawEnd { window_samples, noise_counts }, None)
            }
            VelocitySettings::Foaw { best: true, window_samples, noise_counts } => {
                (Self::FoawBest { window_samples, noise_counts }, None)
            }
            VelocitySettings::Levant {
                implicit: false,
                acceleration_max_m_per_s2,
                lambda_ratio,
            } => (Self::LevantExplicit { acceleration_max_m_per_s2, lambda_ratio }, None),
            VelocitySettings::Levant {
                implicit: true,
                acceleration_max_m_per_s2,
                lambda_ratio,
            } => (Self::LevantImplicit { acceleration_max_m_per_s2, lambda_ratio }, None),
            VelocitySettings::Kalman2 { acceleration_rms_m_per_s2 } => {
                (Self::Kalman2 { acceleration_rms_m_per_s2 }, None)
            }
            VelocitySettings::Kalman3 { jerk_rms_m_per_s3 } => {
                (Self::Kalman3 { jerk_rms_m_per_s3 }, None)
            }
        }
    }

    /// Whether it is tuned by a cutoff.
    pub fn has_cutoff(self) -> bool {
        self.settings(0.0).tuning().is_some_and(|(parameter, _)| parameter.is_frequency())
    }

    /// Name in reports and in the envelope.
    pub fn name(self) -> &'static str {
        self.settings(0.0).name().text()
    }

    /// Name and cutoff, for people.
    pub fn describe(self, cutoff_hz: f64, rate_hz: f64) -> String {
        let name = self.name();
        let parameter = match self.settings(cutoff_hz).tuning() {
            Some((parameter, _)) if parameter.is_frequency() => parameter.name,
            _ => return name.into(),
        };
        let true_hz = self.true_cutoff_hz(cutoff_hz, rate_hz);
        if true_hz == cutoff_hz {
            format!("{name}, {parameter} {cutoff_hz} Hz")
        } else {
            format!("{name}, {parameter} {cutoff_hz} Hz nominal (-3 dB at {true_hz:.1} Hz)")
        }
    }

    /// -3 dB frequency of the digital filter of that nominal cutoff, Hz; the cutoff itself where the
    /// estimator is no such filter.
    pub fn true_cutoff_hz(self, cutoff_hz: f64, rate_hz: f64) -> f64 {
        match self {
            Self::Butterworth { prewarp } | Self::FirstOrder { prewarp } => {
                true_cutoff_hz(cutoff_hz, rate_hz, prewarp)
            }
            _ => cutoff_hz,
        }
    }
}

/// The estimator from position to velocity, m/s per m; `None` if it is not linear, or if it looks
/// at more than the position.
///
/// # Errors
/// A parameter is out of range.
pub fn transfer_function(
    settings: &VelocitySettings,
    design: &Design,
) -> Result<Option<TransferFunction>, SettingsError> {
    settings.build(design)?;
    let rate_hz = design.rate_hz;
    let difference = TransferFunction::finite_difference(rate_hz);
    let low_pass = |order, cutoff_hz, prewarp| {
        difference.then(&TransferFunction::butterworth(rate_hz, cutoff_hz, order, prewarp))
    };
    Ok(Some(match *settings {
        VelocitySettings::Butterworth { cutoff_hz, prewarp } => {
            low_pass(Order::Second, cutoff_hz, prewarp)
        }
        VelocitySettings::FirstOrder { cutoff_hz, prewarp } => {
            low_pass(Order::First, cutoff_hz, prewarp)
        }
        VelocitySettings::Difference => difference,
        VelocitySettings::Taylor { order } => difference.then(&weights(&FirDesign::taylor(order)?)),
        VelocitySettings::LeastSquares { degree, window_samples } => {
            difference.then(&weights(&FirDesign::least_squares(degree, window_samples)?))
        }
        VelocitySettings::TrackingLoop { bandwidth_hz } => {
            let TrackingLoop { kp, ki, .. } = TrackingLoop::new(bandwidth_hz, rate_hz)?;
            let double_pole = vec![1.0, kp + ki - 2.0, 1.0 - kp];
            difference.then(&TransferFunction { num: vec![ki], den: double_pole })
        }
        VelocitySettings::Observer { .. }
        | VelocitySettings::TimeStamps { .. }
        | VelocitySettings::Fusion { .. } => return Ok(None),
        VelocitySettings::Kalman2 { acceleration_rms_m_per_s2 } => {
            kalman(&KalmanDesign::two_states(acceleration_rms_m_per_s2, design)?, &difference)
        }
        VelocitySettings::Kalman3 { jerk_rms_m_per_s3 } => {
            kalman(&KalmanDesign::three_states(jerk_rms_m_per_s3, design)?, &difference)
        }
        VelocitySettings::Foaw { .. } | VelocitySettings::Levant { .. } => return Ok(None),
    }))
}

/// What the estimator makes of the position when it knows nothing else: the observers with a known
/// acceleration of 0. Adaptive windowing with its longest window in use, time stamps with an edge in
/// every sample. `None` for Levant's differentiator, which is linear nowhere.
///
/// # Errors
/// A parameter is out of range.
pub fn position_response(
    settings: &VelocitySettings,
    design: &Design,
) -> Result<Option<TransferFunction>, SettingsError> {
    settings.build(design)?;
    let rate_hz = design.rate_hz;
    let difference = TransferFunction::finite_difference(rate_hz);
    let observer = |design: ObserverDesign| {
        // the same recursion, its disturbance in the place of the acceleration
        let [alpha, beta, gamma] = design.gains;
        kalman(&KalmanDesign { alpha, beta, gamma }, &difference)
    };
    let ends = |samples: u32| {
        let mut num = vec![0.0; samples as usize + 1];
        num[0] = rate_hz / f64::from(samples);
        num[samples as usize] = -num[0];
        TransferFunction { num, den: vec![1.0] }
    };
    Ok(Some(match *settings {
        VelocitySettings::Observer { bandwidth_hz: hz, .. }
        | VelocitySettings::Fusion { crossover_hz: hz } => {
            observer(ObserverDesign::of_accelerometer(hz, rate_hz)?)
        }
        VelocitySettings::TimeStamps { span_samples } => ends(span_samples),
        VelocitySettings::Foaw { best: false, window_samples, .. } => ends(window_samples),
        VelocitySettings::Foaw { best: true, window_samples, .. } => {
            difference.then(&weights(&FirDesign::least_squares(1, window_samples)?))
        }
        _ => return transfer_function(settings, design),
    }))
}

/// From the difference to the velocity, of the core's recursion (its module has it): with
/// `q = z^-1`, `v = (beta (1-q) + gamma q) / D` and
/// `D = (1-q)^2 (1 - q + alpha q) + q (1-q) (beta + gamma/2) + gamma q^2`; with gamma = 0 a factor
/// `1 - q` is common.
fn kalman(gains: &KalmanDesign, difference: &TransferFunction) -> TransferFunction {
    let KalmanDesign { alpha, beta, gamma } = *gains;
    let (num, den) = if gamma == 0.0 {
        (vec![beta], vec![1.0, alpha + beta - 2.0, 1.0 - alpha])
    } else {
        let slope = beta + gamma / 2.0;
        let den = vec![1.0, alpha - 3.0 + slope, 3.0 - 2.0 * alpha - slope + gamma, alpha - 1.0];
        (vec![beta, gamma - beta], den)
    };
    difference.then(&TransferFunction { num, den })
}

fn weights(design: &FirDesign) -> TransferFunction {
    TransferFunction { num: design.weights().to_vec(), den: vec![1.0] }
}
