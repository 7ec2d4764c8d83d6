//! Functions for all rows of the [table](super::table). They find estimators by name or number, and parameters by
//! index.

use core::{fmt, str::FromStr};

#[cfg(feature = "estimators")]
use super::{BiquadDesign, damped_cutoff_hz};
use super::{EstimatorName, PARAMETERS, Parameter, Sense, VelocitySettings, true_cutoff_hz};

/// Numbers and names of removed estimators, each with its replacement. These numbers and names never get a new meaning.
/// An image without the feature never had these estimators.
const RETIRED: &[(u32, &str, &str)] = if cfg!(feature = "estimators") {
    &[
        (16, "central-difference", "window-difference with window_samples = 2"),
        (23, "algebraic-1", "least-squares-1"),
        (24, "algebraic-2", "least-squares-2"),
        (25, "levant-kalman", "kalman-3"),
        (26, "dual-rate", "window-difference"),
        (27, "kalman-2-position", "kalman-2"),
        (28, "kalman-3-position", "kalman-3"),
        (29, "foaw-best-position", "foaw-best"),
        (34, "observer-position", "observer"),
        (35, "fusion-position", "fusion"),
        (36, "first-order-position", "first-order"),
    ]
} else {
    &[]
};

/// No estimator of this build has this name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownEstimator {
    /// The replacement, if there once was an estimator of this name.
    pub replaced_by: Option<&'static str>,
}

impl fmt::Display for UnknownEstimator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(other) = self.replaced_by {
            return write!(f, "this estimator is no more: use {other}");
        }
        f.write_str("unknown estimator, allowed")?;
        EstimatorName::ALL.iter().try_for_each(|name| write!(f, " {}", name.text()))
    }
}

impl FromStr for EstimatorName {
    type Err = UnknownEstimator;

    fn from_str(text: &str) -> Result<Self, UnknownEstimator> {
        let named = |name: &&Self| text.eq_ignore_ascii_case(name.text());
        let unknown = || UnknownEstimator { replaced_by: Self::replacing(text) };
        Self::ALL.iter().find(named).copied().ok_or_else(unknown)
    }
}

impl EstimatorName {
    /// The estimator with this number, if this build has it.
    pub fn from_id(id: u32) -> Option<Self> {
        Self::ALL.iter().copied().find(|name| name.id() == id)
    }

    /// The replacement of the estimator with this number, if there once was one.
    pub fn replacing_id(id: u32) -> Option<&'static str> {
        RETIRED.iter().find(|(number, ..)| *number == id).map(|(.., other)| *other)
    }

    /// The replacement of the estimator with this name, if there once was one.
    pub fn replacing(text: &str) -> Option<&'static str> {
        let named = |(_, name, _): &&(u32, &str, &str)| text.eq_ignore_ascii_case(name);
        RETIRED.iter().find(named).map(|(.., other)| *other)
    }

    /// Returns the sense that this estimator needs, if `senses` does not contain it.
    pub fn missing(self, senses: &[Sense]) -> Option<Sense> {
        self.sense().filter(|needed| !senses.contains(needed))
    }

    /// Returns the settings of this estimator when it replaces `before`. The cutoff stays. All other parameters get
    /// their defaults.
    pub fn following(self, before: &VelocitySettings) -> VelocitySettings {
        let settings = self.defaults();
        match (before.tuning(), settings.tuning()) {
            (Some((old, value)), Some((new, _))) if old == new => settings.with_tuning(value),
            _ => settings,
        }
    }

    /// Settings of this estimator with every parameter at its default.
    pub fn defaults(self) -> VelocitySettings {
        self.settings(self.parameters().map(|p| p.map_or(0.0, |parameter| parameter.default)))
    }
}

impl VelocitySettings {
    /// Name of the estimator.
    pub fn name(&self) -> EstimatorName {
        EstimatorName::of(self).0
    }

    /// The parameter that trades speed for accuracy, and its value.
    pub fn tuning(&self) -> Option<(Parameter, f64)> {
        self.parameter(0)
    }

    /// The frequency that tunes the estimator, in Hz. It is a cutoff, a bandwidth or a crossover.
    pub fn cutoff_hz(&self) -> Option<f64> {
        self.tuning().filter(|(parameter, _)| parameter.is_frequency()).map(|(_, hz)| hz)
    }

    /// The real -3 dB frequency, in Hz, of a low-pass or a `biquad` with this nominal cutoff. Half the sample rate, if
    /// the gain of a `biquad` is nowhere below -3 dB. For other filters it is the cutoff itself.
    pub fn true_cutoff_hz(&self, rate_hz: f64) -> Option<f64> {
        match *self {
            Self::Butterworth { cutoff_hz } | Self::FirstOrder { cutoff_hz } => {
                Some(true_cutoff_hz(cutoff_hz, rate_hz, false))
            }
            #[cfg(feature = "estimators")]
            Self::SecondOrder { cutoff_hz, quality } => {
                Some(damped_cutoff_hz(cutoff_hz, quality, rate_hz))
            }
            #[cfg(feature = "estimators")]
            Self::Biquad { frequency_hz, damping, lead_s, zero } => {
                match BiquadDesign::new(frequency_hz, damping, lead_s, zero, rate_hz) {
                    Ok(design) => Some(design.half_power_hz(rate_hz).unwrap_or(0.5 * rate_hz)),
                    Err(_) => Some(frequency_hz),
                }
            }
            _ => self.cutoff_hz(),
        }
    }

    /// The parameter with the index `place`, and its value.
    pub fn parameter(&self, place: usize) -> Option<(Parameter, f64)> {
        let (name, numbers) = EstimatorName::of(self);
        let parameter = name.parameters().get(place).copied().flatten()?;
        Some((parameter, *numbers.get(place)?))
    }

    /// Returns the same estimator, with the value `number` for the parameter with the index `place`.
    #[must_use]
    pub fn with_parameter(&self, place: usize, number: f64) -> Self {
        let (name, mut numbers) = EstimatorName::of(self);
        if let Some(at) = numbers.get_mut(place) {
            *at = number;
        }
        name.settings(numbers)
    }

    /// The second parameter, and its value.
    pub fn second(&self) -> Option<(Parameter, f64)> {
        self.parameter(1)
    }

    /// The same estimator with this second parameter.
    #[must_use]
    pub fn with_second(&self, second: f64) -> Self {
        self.with_parameter(1, second)
    }

    /// Whether all parameters except the first, the tuning, have their defaults.
    pub fn differs_by_tuning_only(&self) -> bool {
        let mut further = (1..PARAMETERS).filter_map(|place| self.parameter(place));
        further.all(|(parameter, value)| value == parameter.default)
    }

    /// The same estimator with this tuning.
    #[must_use]
    pub fn with_tuning(&self, tuning: f64) -> Self {
        self.with_parameter(0, tuning)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::tests::DESIGN;
    use std::{collections::BTreeSet, vec::Vec};

    /// The tables of the book rely on this: the defaults can be built, and an impossible value is refused with its key.
    #[test]
    fn every_parameter_is_refused_by_its_key() {
        for &name in EstimatorName::ALL {
            let defaults = name.parameters().map(|p| p.map_or(0.0, |parameter| parameter.default));
            name.settings(defaults).build(&DESIGN).unwrap();
            for (place, key) in name.keys().iter().enumerate() {
                for value in [-2.0, f64::NAN] {
                    let mut refused = defaults;
                    refused[place] = value;
                    let error = name.settings(refused).build(&DESIGN).unwrap_err();
                    assert_eq!(error.parameter, *key);
                }
            }
        }
    }

    #[test]
    fn names_numbers_and_settings_lead_there_and_back() {
        for &name in EstimatorName::ALL {
            assert_eq!(name.text().parse(), Ok(name));
            assert_eq!(EstimatorName::from_id(name.id()), Some(name));
            let settings = name.defaults();
            let (same, parameters) = EstimatorName::of(&settings);
            assert_eq!(same, name);
            assert_eq!(same.settings(parameters), settings);
            assert_eq!(name.keys().len(), name.parameters().iter().flatten().count());
            for (key, parameter) in name.keys().iter().zip(name.parameters().iter().flatten()) {
                let unit = parameter.unit.replace('/', "_per_").replace('^', "").to_lowercase();
                let unit =
                    if unit == "1" { unit.replace('1', "") } else { std::format!("_{unit}") };
                assert_eq!(*key, std::format!("{}{unit}", parameter.name));
            }
            if let Some((parameter, value)) = settings.tuning() {
                assert_eq!(value, parameter.default);
                assert_eq!(settings.with_tuning(20.0).tuning(), Some((parameter, 20.0)));
            }
        }
        let numbers: Vec<u32> = EstimatorName::ALL.iter().map(|name| name.id()).collect();
        assert_eq!(numbers.iter().collect::<BTreeSet<_>>().len(), numbers.len());
        assert_eq!(EstimatorName::from_id(0), None);
        assert_eq!("BUTTERWORTH".parse(), Ok(EstimatorName::Butterworth));
        assert!("butterwort".parse::<EstimatorName>().is_err());
    }

    /// No name or number is used again, and each replacement exists.
    #[test]
    #[cfg(feature = "estimators")]
    fn what_is_no_more_says_what_replaces_it() {
        for &(id, name, other) in RETIRED {
            assert_eq!(
                (EstimatorName::from_id(id), EstimatorName::replacing_id(id)),
                (None, Some(other))
            );
            let error = name.to_uppercase().parse::<EstimatorName>().unwrap_err();
            assert_eq!(error.replaced_by, Some(other));
            let text = std::format!("this estimator is no more: use {other}");
            assert_eq!(std::string::ToString::to_string(&error), text);
            assert!(other.split(' ').next().unwrap().parse::<EstimatorName>().is_ok(), "{other}");
        }
        assert_eq!(EstimatorName::replacing_id(EstimatorName::Butterworth.id()), None);
        let error = "butterwort".parse::<EstimatorName>().unwrap_err();
        assert_eq!(error.replaced_by, None);
    }

    #[test]
    #[cfg(feature = "estimators")]
    fn a_number_of_samples_is_whole() {
        let of =
            |window| EstimatorName::LeastSquares1.defaults().with_tuning(window).build(&DESIGN);
        assert!(of(64.0).is_ok());
        for window in [64.4, 63.6, 16.5, f64::NAN] {
            assert!(of(window).is_err(), "{window}");
        }
    }
}
