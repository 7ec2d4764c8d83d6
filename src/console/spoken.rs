//! The units of the numbers that the console reads and prints. They are m and N at the handle. For a rotary device they
//! are rad and N m about its axis.
//!
//! All internal values are in m and N. A number is converted only where it is typed and where it is printed. An
//! estimator's own parameters are not converted, because they are in m and N in every scene.

use core::fmt;

use super::{Decimal, Limit, number};
use crate::{SettingsError, device::Device};

/// Units of one device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spoken {
    /// Distance of the handle from the axis, in m. It is 0 for a linear device.
    radius_m: f64,
}

/// A quantity, such as a force. It has its word in a command's usage, its unit, and the suffix of its parameters'
/// names. In each array the first text is for a linear device, the second for a rotary one.
struct Kind {
    typed: [&'static str; 2],
    unit: [&'static str; 2],
    suffix: [&'static str; 2],
    /// The exponent `n` of the conversion: value about the axis = value at the handle * radius^`n`.
    power: i8,
}

/// All quantities. If a suffix is the end of a longer suffix, the longer suffix comes first, so that it is found first.
const KINDS: [Kind; 5] = [
    Kind {
        typed: ["N_S_PER_M", "N_M_S_PER_RAD"],
        unit: ["N s/m", "N m s/rad"],
        suffix: ["n_s_per_m", "n_m_s_per_rad"],
        power: 2,
    },
    Kind {
        typed: ["N_PER_M", "N_M_PER_RAD"],
        unit: ["N/m", "N m/rad"],
        suffix: ["n_per_m", "n_m_per_rad"],
        power: 2,
    },
    Kind {
        typed: ["NEWTONS", "NEWTON_METRES"],
        unit: ["N", "N m"],
        suffix: ["_n", "_n_m"],
        power: 1,
    },
    Kind { typed: ["METRES", "RADIANS"], unit: ["m", "rad"], suffix: ["_m", "_rad"], power: -1 },
    Kind {
        typed: ["", ""],
        unit: ["N^2 s/m^2", "N^2 m^2 s/rad^2"],
        suffix: ["n2_s_per_m2", "n2_m2_s_per_rad2"],
        power: 4,
    },
];

impl Kind {
    /// Returns the command's name if `usage` ends in this kind of number. It does not use the search functions of
    /// `str`, because these can panic.
    fn name(&self, usage: &'static str) -> Option<&'static str> {
        usage.strip_suffix(self.typed[0])?.strip_suffix(" ")
    }
}

impl Spoken {
    /// Metres and newtons at the handle.
    pub const AT_HANDLE: Self = Self { radius_m: 0.0 };

    /// Units of this device.
    pub const fn of(device: &Device<'_>) -> Self {
        Self { radius_m: device.radius_m }
    }

    fn is_rotary(self) -> bool {
        self.radius_m > 0.0
    }

    /// Factor from the value at the handle to the value about the axis.
    fn factor(self, kind: &Kind) -> f64 {
        let r = self.radius_m;
        match kind.power {
            -1 => 1.0 / r,
            1 => r,
            2 => r * r,
            _ => r * r * r * r,
        }
    }

    fn kind(self, is: impl Fn(&Kind) -> bool) -> Option<&'static Kind> {
        KINDS.iter().find(|kind| self.is_rotary() && is(kind))
    }

    /// Converts a typed number to the handle. The last word of `usage` names the quantity.
    pub(super) fn at_handle(self, usage: &'static str, typed: f64) -> f64 {
        let kind = self.kind(|kind| kind.name(usage).is_some());
        kind.map_or(typed, |kind| number::rounded(typed / self.factor(kind)))
    }

    pub(super) fn usage(self, usage: &'static str) -> Usage {
        let kind = self.kind(|kind| kind.name(usage).is_some());
        match kind.and_then(|kind| Some((kind.name(usage)?, kind))) {
            Some((name, kind)) => Usage(name, Some(kind.typed[1])),
            None => Usage(usage, None),
        }
    }

    /// A number for a reply. `value` is in `unit` at the handle, and is printed in the units of this device.
    pub(super) fn number(self, value: f64, unit: &'static str) -> Said {
        match self.kind(|kind| kind.unit[0] == unit) {
            Some(kind) => Said(value * self.factor(kind), kind.unit[1]),
            None => Said(value, unit),
        }
    }

    /// Like [`number`](Self::number), but without the unit.
    pub(super) fn bare(self, value: f64, unit: &'static str) -> Decimal {
        Decimal(self.number(value, unit).0)
    }

    /// Both ends of an allowed range, for a reply. They are given in `unit` at the handle, and are rounded towards the
    /// inside of the range.
    pub(super) fn limits(self, [low, high]: [f64; 2], unit: &'static str) -> [Limit; 2] {
        let kind = self.kind(|kind| kind.unit[0] == unit);
        self.inwards([low, high], kind)
    }

    fn inwards(self, [low, high]: [f64; 2], kind: Option<&Kind>) -> [Limit; 2] {
        let factor = kind.map_or(1.0, |kind| self.factor(kind));
        [Limit::Low(low * factor), Limit::High(high * factor)]
    }

    pub(super) fn refusal(self, error: &SettingsError) -> OutOfRange<'_> {
        OutOfRange(error, self)
    }
}

pub(super) struct Usage(&'static str, Option<&'static str>);

impl fmt::Display for Usage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)?;
        self.1.map_or(Ok(()), |word| write!(f, " {word}"))
    }
}

pub(super) struct Said(f64, &'static str);

impl fmt::Display for Said {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", Decimal(self.0), self.1)
    }
}

/// An error about a number that is not allowed, printed in the units of the console.
pub(super) struct OutOfRange<'a>(&'a SettingsError, Spoken);

impl fmt::Display for OutOfRange<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(SettingsError { parameter, value, range }, spoken) = self;
        let kind = spoken.kind(|kind| parameter.ends_with(kind.suffix[0]));
        let [low, high] = spoken.inwards([*range.start(), *range.end()], kind);
        match kind {
            Some(kind) => {
                let name = parameter.strip_suffix(kind.suffix[0]).unwrap_or(parameter);
                let value = Decimal(value * spoken.factor(kind));
                write!(f, "{name}{} is {value}", kind.suffix[1])?;
            }
            None => write!(f, "{parameter} is {}", Decimal(*value))?,
        }
        write!(f, ", allowed {low} to {high}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        console::usages,
        velocity::{EstimatorName, Parameter},
    };
    use std::{
        format,
        string::{String, ToString},
        vec::Vec,
    };

    const ROTARY: Spoken = Spoken { radius_m: 0.25 };

    #[test]
    fn a_device_that_moves_straight_speaks_as_it_always_did() {
        let straight = Spoken::AT_HANDLE;
        for usage in usages() {
            assert_eq!(straight.usage(usage).to_string(), usage);
            assert_eq!(straight.at_handle(usage, 3.0), 3.0);
        }
        assert_eq!(straight.number(2000.0, "N/m").to_string(), "2000 N/m");
        let error = SettingsError { parameter: "push_n", value: 9.0, range: 0.0..=5.0 };
        assert_eq!(straight.refusal(&error).to_string(), "push_n is 9, allowed 0 to 5");
    }

    #[test]
    fn numbers_of_every_kind_are_said_about_the_axis() {
        for (value, unit, said) in [
            (16.0, "N/m", "1 N m/rad"),
            (16.0, "N s/m", "1 N m s/rad"),
            (16.0, "N", "4 N m"),
            (1.0, "m", "4 rad"),
            (256.0, "N^2 s/m^2", "1 N^2 m^2 s/rad^2"),
            (3.0, "Hz", "3 Hz"),
            (3.0, "s", "3 s"),
            (20.0, "m/s^2", "20 m/s^2"),
        ] {
            assert_eq!(ROTARY.number(value, unit).to_string(), said);
        }
    }

    #[test]
    fn what_is_typed_is_taken_to_the_handle_and_comes_back() {
        for (usage, said, typed, at_handle) in [
            ("k N_PER_M", "k N_M_PER_RAD", 1.0, 16.0),
            ("bstep N_S_PER_M", "bstep N_M_S_PER_RAD", 1.0, 16.0),
            ("push NEWTONS", "push NEWTON_METRES", 4.0, 16.0),
            ("wall METRES", "wall RADIANS", 4.0, 1.0),
            ("settle SECONDS", "settle SECONDS", 4.0, 4.0),
            ("help", "help", 4.0, 4.0),
        ] {
            assert_eq!(ROTARY.usage(usage).to_string(), said);
            assert_eq!(ROTARY.at_handle(usage, typed), at_handle);
        }
        let odd = Spoken { radius_m: 0.0793 };
        for typed in [5.0, 0.3, 1e-7, 123.456] {
            let k = odd.at_handle("k N_PER_M", typed);
            assert_eq!(odd.number(k, "N/m").to_string(), format!("{} N m/rad", Decimal(typed)));
        }
    }

    #[test]
    fn every_command_with_a_length_or_a_force_is_converted() {
        let said: Vec<_> = usages().map(|usage| ROTARY.usage(usage).to_string()).collect();
        let straight = |text: &String| {
            ["N_PER_M", "N_S_PER_M", " NEWTONS", "METRES"].iter().any(|word| text.ends_with(word))
                && !text.ends_with("NEWTON_METRES")
        };
        assert!(!said.iter().any(straight), "{said:?}");
        assert_eq!(usages().zip(&said).filter(|(usage, said)| usage != said).count(), 15);
    }

    #[test]
    fn refusals_name_what_was_typed_and_what_they_allow_is_taken() {
        for (parameter, said) in [
            ("stiffness_n_per_m", "stiffness_n_m_per_rad"),
            ("damping_max_n_s_per_m", "damping_max_n_m_s_per_rad"),
            ("full_scale_n", "full_scale_n_m"),
            ("start_m", "start_rad"),
        ] {
            for radius_m in [0.25, 0.0793, 0.011] {
                let spoken = Spoken { radius_m };
                let error = SettingsError { parameter, value: 7e7, range: 0.003..=1e7 };
                let text = spoken.refusal(&error).to_string();
                let (name, allowed) = text.split_once(" is ").unwrap();
                assert_eq!(name, said);
                let (_, allowed) = allowed.split_once(", allowed ").unwrap();
                let unit = KINDS.iter().find(|kind| parameter.ends_with(kind.suffix[0])).unwrap();
                for end in allowed.split(" to ") {
                    let usage = usages().find(|usage| unit.name(usage).is_some()).unwrap();
                    let at_handle = spoken.at_handle(usage, end.parse().unwrap());
                    assert!(error.range.contains(&at_handle), "{text}: {at_handle}");
                }
            }
        }
        let error = SettingsError { parameter: "cutoff_hz", value: 7.0, range: 10.0..=20.0 };
        assert_eq!(ROTARY.refusal(&error).to_string(), "cutoff_hz is 7, allowed 10 to 20");
    }

    #[test]
    fn no_parameter_of_an_estimator_is_taken_for_a_length_or_a_force() {
        for name in EstimatorName::ALL {
            for Parameter { name, unit, .. } in name.parameters().into_iter().flatten() {
                assert!(KINDS.iter().all(|kind| kind.unit[0] != unit), "{name} {unit}");
            }
        }
    }
}
