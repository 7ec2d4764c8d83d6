//! The parameters of the estimators, and the types of their values.

/// Name, unit and default of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Name of the parameter, for example `cutoff` or `window`. With the unit added, it is the key in a scene.
    pub name: &'static str,
    /// Unit of the parameter, such as `Hz` or `samples`.
    pub unit: &'static str,
    /// Default of the parameter.
    pub default: f64,
}

impl Parameter {
    /// Whether the parameter is a frequency. The command `cutoff` can set it, and a sweep over cutoffs can vary it.
    pub fn is_frequency(&self) -> bool {
        self.unit == "Hz"
    }

    /// Whether the parameter is a whole number.
    pub fn is_whole(&self) -> bool {
        self.unit == "samples"
    }

    /// Returns the parameters, each at its index.
    pub(super) fn all(parameters: &[Self]) -> [Option<Self>; PARAMETERS] {
        core::array::from_fn(|place| parameters.get(place).copied())
    }
}

/// The largest number of parameters of an estimator.
pub const PARAMETERS: usize = 8;

/// The values of an estimator's parameters, by index. A value is 0 if there is no parameter at its index.
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
    /// Converts a number. If it is not whole or is outside `u32`, it becomes 0, which the check of the range then
    /// refuses.
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
