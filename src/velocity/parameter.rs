//! Parameters of the estimators, and the types that they have.

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
    /// It is a frequency: `cutoff` sets it and a sweep over cutoffs goes along it.
    pub fn is_frequency(&self) -> bool {
        self.unit == "Hz"
    }

    /// It is a whole number.
    pub fn is_whole(&self) -> bool {
        self.unit == "samples"
    }

    /// At most two, by their places.
    pub(super) const fn two(parameters: &[Self]) -> [Option<Self>; 2] {
        match *parameters {
            [] => [None, None],
            [tuning] => [Some(tuning), None],
            [tuning, second, ..] => [Some(tuning), Some(second)],
        }
    }
}

/// At most two numbers, 0 where there is none.
#[inline]
pub(super) fn two(numbers: &[f64]) -> [f64; 2] {
    [0, 1].map(|place| numbers.get(place).copied().unwrap_or_default())
}

/// A parameter's type.
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
    /// What is no whole number, or beyond `u32`, becomes 0 and is refused as such.
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
