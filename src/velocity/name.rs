//! Names of the estimators: as they are typed, stored in flash, written to the envelope and shown.
//!
//! A name fixes everything but two numbers: the *tuning*, the one parameter that trades speed for
//! accuracy, and for some a second one.

use super::{Sense, VelocitySettings};

/// An estimator by its name, which is also its name in the envelope.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EstimatorName {
    /// [`VelocitySettings::Butterworth`], not pre-warped.
    Butterworth,
    /// [`VelocitySettings::Butterworth`], pre-warped.
    ButterworthPrewarped,
    /// [`VelocitySettings::FirstOrder`], not pre-warped.
    FirstOrder,
    /// [`VelocitySettings::FirstOrder`], pre-warped.
    FirstOrderPrewarped,
    /// [`VelocitySettings::Difference`].
    Difference,
    /// [`VelocitySettings::Taylor`] of order 2.
    #[cfg(feature = "taylor")]
    Taylor2,
    /// [`VelocitySettings::Taylor`] of order 3.
    #[cfg(feature = "taylor")]
    Taylor3,
    /// [`VelocitySettings::LeastSquares`] of degree 1.
    #[cfg(feature = "least-squares")]
    LeastSquares1,
    /// [`VelocitySettings::LeastSquares`] of degree 2.
    #[cfg(feature = "least-squares")]
    LeastSquares2,
    /// [`VelocitySettings::TrackingLoop`].
    #[cfg(feature = "tracking-loop")]
    TrackingLoop,
    /// [`VelocitySettings::Observer`].
    #[cfg(feature = "observer")]
    Observer,
    /// [`VelocitySettings::TimeStamps`].
    #[cfg(feature = "time-stamps")]
    TimeStamps,
    /// [`VelocitySettings::Fusion`].
    #[cfg(feature = "fusion")]
    Fusion,
    /// [`VelocitySettings::Foaw`], the line through the ends.
    #[cfg(feature = "foaw")]
    FoawEnd,
    /// [`VelocitySettings::Foaw`], the least-squares slope.
    #[cfg(feature = "foaw")]
    FoawBest,
    /// [`VelocitySettings::Levant`], explicit.
    #[cfg(feature = "levant")]
    LevantExplicit,
    /// [`VelocitySettings::Levant`], implicit.
    #[cfg(feature = "levant")]
    LevantImplicit,
    /// [`VelocitySettings::Kalman2`].
    #[cfg(feature = "kalman")]
    Kalman2,
    /// [`VelocitySettings::Kalman3`].
    #[cfg(feature = "kalman")]
    Kalman3,
}

/// A parameter that is a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Its name, as in scenes but for the unit: `cutoff`, `window`.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// What it is when nothing else was said.
    pub default: f64,
}

impl Parameter {
    const CUTOFF: Self = Self { name: "cutoff", unit: "Hz", default: 1500.0 };
    #[cfg(any(feature = "least-squares", feature = "foaw"))]
    const WINDOW: Self = Self { name: "window", unit: "samples", default: 16.0 };
    #[cfg(any(feature = "tracking-loop", feature = "observer"))]
    const BANDWIDTH: Self = Self { name: "bandwidth", unit: "Hz", default: 500.0 };
    /// The default is the mass of the paper's device.
    #[cfg(feature = "observer")]
    const MASS: Self = Self { name: "mass", unit: "kg", default: 0.416 };
    #[cfg(feature = "time-stamps")]
    const SPAN: Self = Self { name: "span", unit: "samples", default: 8.0 };
    #[cfg(feature = "fusion")]
    const CROSSOVER: Self = Self { name: "crossover", unit: "Hz", default: 50.0 };
    #[cfg(feature = "foaw")]
    const NOISE: Self = Self { name: "noise", unit: "counts", default: 1.0 };
    #[cfg(feature = "levant")]
    const ACCELERATION_MAX: Self = Self { name: "acceleration_max", unit: "m/s^2", default: 20.0 };
    #[cfg(feature = "levant")]
    const LAMBDA_RATIO: Self = Self { name: "lambda_ratio", unit: "1", default: 1.0 };
    #[cfg(feature = "kalman")]
    const ACCELERATION_RMS: Self = Self { name: "acceleration_rms", unit: "m/s^2", default: 20.0 };
    #[cfg(feature = "kalman")]
    const JERK_RMS: Self = Self { name: "jerk_rms", unit: "m/s^3", default: 20_000.0 };

    /// It is a frequency: `cutoff` sets it and a sweep over cutoffs goes along it.
    pub fn is_frequency(&self) -> bool {
        self.unit == "Hz"
    }
}

impl EstimatorName {
    /// All of this build.
    pub const ALL: &[Self] = &[
        Self::Butterworth,
        Self::ButterworthPrewarped,
        Self::FirstOrder,
        Self::FirstOrderPrewarped,
        Self::Difference,
        #[cfg(feature = "taylor")]
        Self::Taylor2,
        #[cfg(feature = "taylor")]
        Self::Taylor3,
        #[cfg(feature = "least-squares")]
        Self::LeastSquares1,
        #[cfg(feature = "least-squares")]
        Self::LeastSquares2,
        #[cfg(feature = "tracking-loop")]
        Self::TrackingLoop,
        #[cfg(feature = "observer")]
        Self::Observer,
        #[cfg(feature = "time-stamps")]
        Self::TimeStamps,
        #[cfg(feature = "fusion")]
        Self::Fusion,
        #[cfg(feature = "foaw")]
        Self::FoawEnd,
        #[cfg(feature = "foaw")]
        Self::FoawBest,
        #[cfg(feature = "levant")]
        Self::LevantExplicit,
        #[cfg(feature = "levant")]
        Self::LevantImplicit,
        #[cfg(feature = "kalman")]
        Self::Kalman2,
        #[cfg(feature = "kalman")]
        Self::Kalman3,
    ];

    /// As it is typed.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Butterworth => "butterworth",
            Self::ButterworthPrewarped => "butterworth-prewarped",
            Self::FirstOrder => "first-order",
            Self::FirstOrderPrewarped => "first-order-prewarped",
            Self::Difference => "difference",
            #[cfg(feature = "taylor")]
            Self::Taylor2 => "taylor-2",
            #[cfg(feature = "taylor")]
            Self::Taylor3 => "taylor-3",
            #[cfg(feature = "least-squares")]
            Self::LeastSquares1 => "least-squares-1",
            #[cfg(feature = "least-squares")]
            Self::LeastSquares2 => "least-squares-2",
            #[cfg(feature = "tracking-loop")]
            Self::TrackingLoop => "tracking-loop",
            #[cfg(feature = "observer")]
            Self::Observer => "observer",
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps => "time-stamps",
            #[cfg(feature = "fusion")]
            Self::Fusion => "fusion",
            #[cfg(feature = "foaw")]
            Self::FoawEnd => "foaw-end",
            #[cfg(feature = "foaw")]
            Self::FoawBest => "foaw-best",
            #[cfg(feature = "levant")]
            Self::LevantExplicit => "levant-explicit",
            #[cfg(feature = "levant")]
            Self::LevantImplicit => "levant-implicit",
            #[cfg(feature = "kalman")]
            Self::Kalman2 => "kalman-2",
            #[cfg(feature = "kalman")]
            Self::Kalman3 => "kalman-3",
        }
    }

    /// Its number in a settings record. A number is never given a new meaning.
    pub const fn number(self) -> u32 {
        match self {
            Self::Butterworth => 1,
            Self::ButterworthPrewarped => 2,
            Self::Difference => 3,
            Self::FirstOrder => 4,
            Self::FirstOrderPrewarped => 5,
            #[cfg(feature = "taylor")]
            Self::Taylor2 => 6,
            #[cfg(feature = "taylor")]
            Self::Taylor3 => 7,
            #[cfg(feature = "least-squares")]
            Self::LeastSquares1 => 8,
            #[cfg(feature = "least-squares")]
            Self::LeastSquares2 => 9,
            #[cfg(feature = "tracking-loop")]
            Self::TrackingLoop => 30,
            #[cfg(feature = "observer")]
            Self::Observer => 31,
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps => 32,
            #[cfg(feature = "fusion")]
            Self::Fusion => 33,
            #[cfg(feature = "foaw")]
            Self::FoawEnd => 10,
            #[cfg(feature = "foaw")]
            Self::FoawBest => 11,
            #[cfg(feature = "levant")]
            Self::LevantExplicit => 12,
            #[cfg(feature = "levant")]
            Self::LevantImplicit => 13,
            #[cfg(feature = "kalman")]
            Self::Kalman2 => 14,
            #[cfg(feature = "kalman")]
            Self::Kalman3 => 15,
        }
    }

    /// The estimator of that number, if this build has it.
    pub fn of_number(number: u32) -> Option<Self> {
        Self::ALL.iter().copied().find(|name| name.number() == number)
    }

    /// The estimator of that name, if this build has it.
    pub fn of_text(text: &[u8]) -> Option<Self> {
        Self::ALL.iter().copied().find(|name| text.eq_ignore_ascii_case(name.text().as_bytes()))
    }

    /// Its parameters: the tuning, and the second one.
    pub const fn parameters(self) -> [Option<Parameter>; 2] {
        match self {
            Self::Butterworth
            | Self::ButterworthPrewarped
            | Self::FirstOrder
            | Self::FirstOrderPrewarped => [Some(Parameter::CUTOFF), None],
            Self::Difference => [None, None],
            #[cfg(feature = "taylor")]
            Self::Taylor2 | Self::Taylor3 => [None, None],
            #[cfg(feature = "least-squares")]
            Self::LeastSquares1 | Self::LeastSquares2 => [Some(Parameter::WINDOW), None],
            #[cfg(feature = "tracking-loop")]
            Self::TrackingLoop => [Some(Parameter::BANDWIDTH), None],
            #[cfg(feature = "observer")]
            Self::Observer => [Some(Parameter::BANDWIDTH), Some(Parameter::MASS)],
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps => [Some(Parameter::SPAN), None],
            #[cfg(feature = "fusion")]
            Self::Fusion => [Some(Parameter::CROSSOVER), None],
            #[cfg(feature = "foaw")]
            Self::FoawEnd | Self::FoawBest => [Some(Parameter::WINDOW), Some(Parameter::NOISE)],
            #[cfg(feature = "levant")]
            Self::LevantExplicit | Self::LevantImplicit => {
                [Some(Parameter::ACCELERATION_MAX), Some(Parameter::LAMBDA_RATIO)]
            }
            #[cfg(feature = "kalman")]
            Self::Kalman2 => [Some(Parameter::ACCELERATION_RMS), None],
            #[cfg(feature = "kalman")]
            Self::Kalman3 => [Some(Parameter::JERK_RMS), None],
        }
    }

    /// What it cannot do without, beside the position.
    pub const fn sense(self) -> Option<Sense> {
        match self {
            #[cfg(feature = "observer")]
            Self::Observer => Some(Sense::Force),
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps => Some(Sense::Edge),
            #[cfg(feature = "fusion")]
            Self::Fusion => Some(Sense::Acceleration),
            _ => None,
        }
    }

    /// What it needs that is not among those `senses`.
    pub fn missing(self, senses: &[Sense]) -> Option<Sense> {
        self.sense().filter(|needed| !senses.contains(needed))
    }

    /// The name of those settings, and their parameters; 0 where there is none.
    pub const fn of(settings: &VelocitySettings) -> (Self, [f64; 2]) {
        match *settings {
            VelocitySettings::Butterworth { cutoff_hz, prewarp: false } => {
                (Self::Butterworth, [cutoff_hz, 0.0])
            }
            VelocitySettings::Butterworth { cutoff_hz, prewarp: true } => {
                (Self::ButterworthPrewarped, [cutoff_hz, 0.0])
            }
            VelocitySettings::FirstOrder { cutoff_hz, prewarp: false } => {
                (Self::FirstOrder, [cutoff_hz, 0.0])
            }
            VelocitySettings::FirstOrder { cutoff_hz, prewarp: true } => {
                (Self::FirstOrderPrewarped, [cutoff_hz, 0.0])
            }
            VelocitySettings::Difference => (Self::Difference, [0.0; 2]),
            #[cfg(feature = "taylor")]
            VelocitySettings::Taylor { order } => {
                (if order == 2 { Self::Taylor2 } else { Self::Taylor3 }, [0.0; 2])
            }
            #[cfg(feature = "least-squares")]
            VelocitySettings::LeastSquares { degree, window_samples } => {
                let name = if degree == 1 { Self::LeastSquares1 } else { Self::LeastSquares2 };
                (name, [window_samples as f64, 0.0])
            }
            #[cfg(feature = "tracking-loop")]
            VelocitySettings::TrackingLoop { bandwidth_hz } => {
                (Self::TrackingLoop, [bandwidth_hz, 0.0])
            }
            #[cfg(feature = "observer")]
            VelocitySettings::Observer { bandwidth_hz, mass_kg } => {
                (Self::Observer, [bandwidth_hz, mass_kg])
            }
            #[cfg(feature = "time-stamps")]
            VelocitySettings::TimeStamps { span_samples } => {
                (Self::TimeStamps, [span_samples as f64, 0.0])
            }
            #[cfg(feature = "fusion")]
            VelocitySettings::Fusion { crossover_hz } => (Self::Fusion, [crossover_hz, 0.0]),
            #[cfg(feature = "foaw")]
            VelocitySettings::Foaw { best, window_samples, noise_counts } => {
                let name = if best { Self::FoawBest } else { Self::FoawEnd };
                (name, [window_samples as f64, noise_counts])
            }
            #[cfg(feature = "levant")]
            VelocitySettings::Levant { implicit, acceleration_max_m_per_s2, lambda_ratio } => {
                let name = if implicit { Self::LevantImplicit } else { Self::LevantExplicit };
                (name, [acceleration_max_m_per_s2, lambda_ratio])
            }
            #[cfg(feature = "kalman")]
            VelocitySettings::Kalman2 { acceleration_rms_m_per_s2 } => {
                (Self::Kalman2, [acceleration_rms_m_per_s2, 0.0])
            }
            #[cfg(feature = "kalman")]
            VelocitySettings::Kalman3 { jerk_rms_m_per_s3 } => {
                (Self::Kalman3, [jerk_rms_m_per_s3, 0.0])
            }
        }
    }

    /// Its settings with those parameters; whether they are in range is for
    /// [`VelocitySettings::build`] to say.
    pub fn settings(self, [tuning, second]: [f64; 2]) -> VelocitySettings {
        let _ = second; // not every build has an estimator with a second parameter
        match self {
            Self::Butterworth => {
                VelocitySettings::Butterworth { cutoff_hz: tuning, prewarp: false }
            }
            Self::ButterworthPrewarped => {
                VelocitySettings::Butterworth { cutoff_hz: tuning, prewarp: true }
            }
            Self::FirstOrder => VelocitySettings::FirstOrder { cutoff_hz: tuning, prewarp: false },
            Self::FirstOrderPrewarped => {
                VelocitySettings::FirstOrder { cutoff_hz: tuning, prewarp: true }
            }
            Self::Difference => VelocitySettings::Difference,
            #[cfg(feature = "taylor")]
            Self::Taylor2 => VelocitySettings::Taylor { order: 2 },
            #[cfg(feature = "taylor")]
            Self::Taylor3 => VelocitySettings::Taylor { order: 3 },
            #[cfg(feature = "least-squares")]
            Self::LeastSquares1 => {
                VelocitySettings::LeastSquares { degree: 1, window_samples: whole(tuning) }
            }
            #[cfg(feature = "least-squares")]
            Self::LeastSquares2 => {
                VelocitySettings::LeastSquares { degree: 2, window_samples: whole(tuning) }
            }
            #[cfg(feature = "tracking-loop")]
            Self::TrackingLoop => VelocitySettings::TrackingLoop { bandwidth_hz: tuning },
            #[cfg(feature = "observer")]
            Self::Observer => VelocitySettings::Observer { bandwidth_hz: tuning, mass_kg: second },
            #[cfg(feature = "time-stamps")]
            Self::TimeStamps => VelocitySettings::TimeStamps { span_samples: whole(tuning) },
            #[cfg(feature = "fusion")]
            Self::Fusion => VelocitySettings::Fusion { crossover_hz: tuning },
            #[cfg(feature = "foaw")]
            Self::FoawEnd | Self::FoawBest => VelocitySettings::Foaw {
                best: self == Self::FoawBest,
                window_samples: whole(tuning),
                noise_counts: second,
            },
            #[cfg(feature = "levant")]
            Self::LevantExplicit | Self::LevantImplicit => VelocitySettings::Levant {
                implicit: self == Self::LevantImplicit,
                acceleration_max_m_per_s2: tuning,
                lambda_ratio: second,
            },
            #[cfg(feature = "kalman")]
            Self::Kalman2 => VelocitySettings::Kalman2 { acceleration_rms_m_per_s2: tuning },
            #[cfg(feature = "kalman")]
            Self::Kalman3 => VelocitySettings::Kalman3 { jerk_rms_m_per_s3: tuning },
        }
    }

    /// Its settings when it takes over from `before`: a cutoff stays, the rest is at its default.
    pub fn following(self, before: &VelocitySettings) -> VelocitySettings {
        let settings = self.defaults();
        match (before.tuning(), settings.tuning()) {
            (Some((old, value)), Some((new, _))) if old == new => settings.with_tuning(value),
            _ => settings,
        }
    }

    /// Its settings with every parameter at its default.
    pub fn defaults(self) -> VelocitySettings {
        self.settings(self.parameters().map(|p| p.map_or(0.0, |parameter| parameter.default)))
    }
}

impl VelocitySettings {
    /// Name of the estimator.
    pub const fn name(&self) -> EstimatorName {
        EstimatorName::of(self).0
    }

    /// The parameter that trades speed for accuracy, and its value.
    pub const fn tuning(&self) -> Option<(Parameter, f64)> {
        let (name, [value, _]) = EstimatorName::of(self);
        match name.parameters() {
            [Some(parameter), _] => Some((parameter, value)),
            _ => None,
        }
    }

    /// The second parameter, and its value.
    pub const fn second(&self) -> Option<(Parameter, f64)> {
        let (name, [_, value]) = EstimatorName::of(self);
        match name.parameters() {
            [_, Some(parameter)] => Some((parameter, value)),
            _ => None,
        }
    }

    /// The same estimator with that second parameter.
    #[must_use]
    pub fn with_second(&self, second: f64) -> Self {
        let (name, [tuning, _]) = EstimatorName::of(self);
        name.settings([tuning, second])
    }

    /// The same estimator with that tuning.
    #[must_use]
    pub fn with_tuning(&self, tuning: f64) -> Self {
        let (name, [_, second]) = EstimatorName::of(self);
        name.settings([tuning, second])
    }
}

/// The nearest whole number; what is none, or beyond `u32`, becomes 0 and is refused as such.
#[cfg(any(feature = "least-squares", feature = "foaw", feature = "time-stamps"))]
fn whole(value: f64) -> u32 {
    if value >= 0.0 && value <= f64::from(u32::MAX) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within u32 by the line above"
        )]
        let whole = libm::round(value) as u32;
        whole
    } else {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{collections::BTreeSet, vec::Vec};

    #[test]
    fn names_numbers_and_settings_lead_there_and_back() {
        for &name in EstimatorName::ALL {
            assert_eq!(EstimatorName::of_text(name.text().as_bytes()), Some(name));
            assert_eq!(EstimatorName::of_number(name.number()), Some(name));
            let settings = name.defaults();
            let (same, parameters) = EstimatorName::of(&settings);
            assert_eq!(same, name);
            assert_eq!(same.settings(parameters), settings);
            if let Some((parameter, value)) = settings.tuning() {
                assert_eq!(value, parameter.default);
                assert_eq!(settings.with_tuning(20.0).tuning(), Some((parameter, 20.0)));
            }
        }
        let numbers: Vec<u32> = EstimatorName::ALL.iter().map(|name| name.number()).collect();
        assert_eq!(numbers.iter().collect::<BTreeSet<_>>().len(), numbers.len());
        assert_eq!(EstimatorName::of_number(0), None);
    }
}
