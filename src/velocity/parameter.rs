//! Parameters of the estimators, and their number types.

/// A parameter that is a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Name of the parameter: the key of a scene without the unit, for example `cutoff` or `window`.
    pub name: &'static str,
    /// Unit of the parameter, such as `Hz` or `samples`.
    pub unit: &'static str,
    /// Default of the parameter.
    pub default: f64,
}

impl Parameter {
    /// Whether the parameter is a frequency. `cutoff` sets a frequency, and a sweep over cutoffs varies it.
    pub fn is_frequency(&self) -> bool {
        self.unit == "Hz"
    }

    /// Whether the parameter is a whole number.
    pub fn is_whole(&self) -> bool {
        self.unit == "samples"
    }

    /// The parameters by their index.
    pub(super) fn all(parameters: &[Self]) -> [Option<Self>; PARAMETERS] {
        core::array::from_fn(|place| parameters.get(place).copied())
    }
}

/// Most parameters of an estimator.
pub const PARAMETERS: usize = 8;

/// Parameters of one estimator by index; 0 if there is none at an index.
pub type Numbers = [f64; PARAMETERS];

#[inline]
pub(super) fn numbers(numbers: &[f64]) -> Numbers {
    core::array::from_fn(|place| numbers.get(place).copied().unwrap_or_default())
}

pub(super) trait Number {
    fn of(number: f64) -> Self;
    fn value(self) -> f64;
}

impl Number for f64 {
    fn of(number: f64) -> Self {
        number
    }

    fn value(self) -> f64 {
        self
    }
}

impl Number for u32 {
    /// A number that is not whole or is outside `u32` becomes 0. The range check refuses 0.
    fn of(number: f64) -> Self {
        if number >= 0.0 && number <= f64::from(u32::MAX) && libm::trunc(number) == number {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "within u32 by the line above"
            )]
            let whole = number as u32;
            whole
        } else {
            0
        }
    }

    fn value(self) -> f64 {
        self.into()
    }
}
