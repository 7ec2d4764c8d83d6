//! The equations of all estimators. The twin runs these equations, and linear theory uses their frequency responses.

use zwidth::{
    Design, SettingsError, VelocitySettings,
    velocity::{
        BiquadDesign, ButterworthDesign, CascadeDesign, FirDesign, FirstOrder, KalmanDesign,
        LevantDesign, ObserverDesign, TrackingLoop,
    },
};

use super::{foaw::Foaw, levant::Levant};

/// The equation of an estimator. Its inputs are differences of counts, its output is a velocity. The state is stored
/// separately.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "copied once per run")]
pub enum Equation {
    LowPass(LowPass),
    Cascade([LowPass; 2]),
    /// Weighted sum of the last differences.
    Sum(FirDesign),
    /// Change of the count over a window, divided by the window's number of samples. The variant's value is this
    /// number.
    Ends(u32),
    Tracking(TrackingLoop),
    Kalman(KalmanDesign),
    /// Observer that gets the force.
    Observer(ObserverDesign),
    /// Observer that gets the acceleration.
    Fusion(ObserverDesign),
    /// Time stamping. The variant's value is the shortest time between the two edges, in samples.
    TimeStamps(u32),
    Foaw(Foaw),
    Levant(Levant),
}

/// `y = b[0] x + b[1] x1 + b[2] x2 - a[0] y1 - a[1] y2`: all common estimators have this form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass {
    pub b: [f64; 3],
    pub a: [f64; 2],
    /// Number of past samples that the equation uses. Coefficients of older samples are 0.
    pub order: usize,
}

impl LowPass {
    /// The low-pass that returns its input, the difference, without filtering.
    const NOTHING: Self = Self { b: [1.0, 0.0, 0.0], a: [0.0; 2], order: 0 };
}

impl From<ButterworthDesign> for LowPass {
    fn from(ButterworthDesign { b0, a1, a2, .. }: ButterworthDesign) -> Self {
        Self { b: [b0, 2.0 * b0, b0], a: [a1, a2], order: 2 }
    }
}

impl From<FirstOrder> for LowPass {
    fn from(FirstOrder { b0, a1 }: FirstOrder) -> Self {
        Self { b: [b0, b0, 0.0], a: [a1, 0.0], order: 1 }
    }
}

impl From<BiquadDesign> for LowPass {
    fn from(BiquadDesign { b, a, .. }: BiquadDesign) -> Self {
        Self { b, a, order: 2 }
    }
}

impl Equation {
    pub fn of(settings: &VelocitySettings, design: &Design) -> Result<Self, SettingsError> {
        use VelocitySettings as V;
        settings.build(design)?; // checks the ranges
        let rate_hz = design.rate_hz;
        let butterworth = |cutoff_hz, prewarp| {
            Ok(Self::LowPass(ButterworthDesign::new(cutoff_hz, rate_hz, prewarp)?.into()))
        };
        let first_order = |cutoff_hz, prewarp| {
            Ok(Self::LowPass(FirstOrder::new(cutoff_hz, rate_hz, prewarp)?.into()))
        };
        let levant = |c, lambda_ratio, implicit| {
            let sizes = LevantDesign::new(c, lambda_ratio, design)?;
            Ok(Self::Levant(Levant { implicit, sizes }))
        };
        Ok(match *settings {
            V::Butterworth { cutoff_hz } => return butterworth(cutoff_hz, false),
            V::ButterworthPrewarped { cutoff_hz } => return butterworth(cutoff_hz, true),
            V::FirstOrder { cutoff_hz } => return first_order(cutoff_hz, false),
            V::FirstOrderPrewarped { cutoff_hz } => return first_order(cutoff_hz, true),
            V::SecondOrder { cutoff_hz, quality } => {
                Self::LowPass(ButterworthDesign::damped(cutoff_hz, quality, rate_hz)?.into())
            }
            V::Difference {} => Self::LowPass(LowPass::NOTHING),
            V::Biquad { frequency_hz, damping, lead_s, zero } => {
                let design = BiquadDesign::new(frequency_hz, damping, lead_s, zero, rate_hz)?;
                Self::LowPass(design.into())
            }
            V::Biquad2 {
                frequency_hz,
                damping,
                lead_s,
                zero,
                second_ratio,
                second_damping,
                second_lead_s,
                second_zero,
            } => {
                let first = [frequency_hz, damping, lead_s, zero];
                let second = [second_ratio, second_damping, second_lead_s, second_zero];
                let CascadeDesign { sections } = CascadeDesign::new(first, second, rate_hz)?;
                Self::Cascade(sections.map(LowPass::from))
            }
            V::WindowDifference { window_samples } => Self::Ends(window_samples),
            V::TrackingLoop { bandwidth_hz } => {
                Self::Tracking(TrackingLoop::new(bandwidth_hz, rate_hz)?)
            }
            V::TrackingLead { bandwidth_hz, lead } => {
                Self::Tracking(TrackingLoop::led(bandwidth_hz, lead, rate_hz)?)
            }
            V::Smoothing { cutoff_hz, ratio } => {
                Self::Tracking(TrackingLoop::smoothing(cutoff_hz, ratio, rate_hz)?)
            }
            V::Kalman2 { acceleration_rms_m_per_s2 } => {
                Self::Kalman(KalmanDesign::two_states(acceleration_rms_m_per_s2, design)?)
            }
            V::Kalman3 { jerk_rms_m_per_s3 } => {
                Self::Kalman(KalmanDesign::three_states(jerk_rms_m_per_s3, design)?)
            }
            V::Observer { bandwidth_hz, mass_kg } => {
                Self::Observer(ObserverDesign::of_mass(bandwidth_hz, mass_kg, design)?)
            }
            V::Fusion { crossover_hz } => {
                Self::Fusion(ObserverDesign::of_accelerometer(crossover_hz, rate_hz)?)
            }
            V::TimeStamps { span_samples } => Self::TimeStamps(span_samples),
            V::FoawEnd { window_samples, noise_counts } => {
                Self::Foaw(Foaw::new(false, window_samples, noise_counts))
            }
            V::FoawBest { window_samples, noise_counts } => {
                Self::Foaw(Foaw::new(true, window_samples, noise_counts))
            }
            V::LevantExplicit { acceleration_max_m_per_s2, lambda_ratio } => {
                return levant(acceleration_max_m_per_s2, lambda_ratio, false);
            }
            V::LevantImplicit { acceleration_max_m_per_s2, lambda_ratio } => {
                return levant(acceleration_max_m_per_s2, lambda_ratio, true);
            }
            _ => Self::Sum(settings.weights(design)?.ok_or(SettingsError {
                parameter: "estimators without a form in f64",
                value: 1.0,
                range: 0.0..=0.0,
            })?),
        })
    }
}
