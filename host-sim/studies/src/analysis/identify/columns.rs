//! Finds the columns of a log for time, command and position. The names and units in the header tell which they are.
//!
//! A header is a quantity and its unit, such as `voltage_v`, `Voltage (V)` or `time [ms]`. Capital letters, blanks,
//! brackets and signs are ignored. docs/identification.md has the table.

use std::fmt;

use crate::scene::Units;

/// What the command in a log is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Drive {
    /// Voltage at the amplifier's input, in V. The gain is in N/V.
    #[default]
    Voltage,
    /// Force at the handle in N, or torque at the axis in N m. There is no gain.
    Force,
    /// Current of the motor, in A. The gain is in N/A.
    Current,
}

impl Drive {
    /// The command in words, as in "force per volt".
    pub fn per(self) -> &'static str {
        match self {
            Self::Voltage => "volt",
            Self::Force => "newton",
            Self::Current => "ampere",
        }
    }

    pub fn unit(self) -> &'static str {
        match self {
            Self::Voltage => "V",
            Self::Force => "N",
            Self::Current => "A",
        }
    }
}

impl fmt::Display for Drive {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Voltage => "voltage",
            Self::Force => "force",
            Self::Current => "current",
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Quantity {
    Time,
    Command(Drive),
    Torque,
    Length,
    Angle,
    Counts,
}
use Quantity::{Angle, Command, Counts, Length, Time, Torque};

/// Accepted names, and the quantities that each may stand for.
const NAMES: [(&str, &[Quantity]); 13] = [
    ("time", &[Time]),
    ("t", &[Time]),
    ("timestamp", &[Time]),
    ("voltage", &[Command(Drive::Voltage)]),
    ("force", &[Command(Drive::Force)]),
    ("torque", &[Torque]),
    ("current", &[Command(Drive::Current)]),
    ("position", &[Length, Angle, Counts]),
    ("x", &[Length]),
    ("angle", &[Angle]),
    ("theta", &[Angle]),
    ("q", &[Angle]),
    ("encoder", &[Counts]),
];

/// Accepted units. Each has its quantity and its factor to the SI unit.
const UNITS: [(&str, Quantity, f64); 26] = [
    ("s", Time, 1.0),
    ("sec", Time, 1.0),
    ("ms", Time, 1e-3),
    ("us", Time, 1e-6),
    ("v", Command(Drive::Voltage), 1.0),
    ("mv", Command(Drive::Voltage), 1e-3),
    ("n", Command(Drive::Force), 1.0),
    ("mn", Command(Drive::Force), 1e-3),
    ("n_m", Torque, 1.0),
    ("nm", Torque, 1.0),
    ("mn_m", Torque, 1e-3),
    ("mnm", Torque, 1e-3),
    ("a", Command(Drive::Current), 1.0),
    ("ma", Command(Drive::Current), 1e-3),
    ("m", Length, 1.0),
    ("cm", Length, 1e-2),
    ("mm", Length, 1e-3),
    ("um", Length, 1e-6),
    ("rad", Angle, 1.0),
    ("mrad", Angle, 1e-3),
    ("deg", Angle, std::f64::consts::PI / 180.0),
    ("°", Angle, std::f64::consts::PI / 180.0),
    ("counts", Counts, 1.0),
    ("count", Counts, 1.0),
    ("ticks", Counts, 1.0),
    ("cts", Counts, 1.0),
];

/// Reads the quantity of a header and its factor to SI units. Returns `None` if the name is unknown. Returns an error
/// if the unit is missing or belongs to another quantity.
fn meant(header: &str) -> Option<Result<(Quantity, f64), String>> {
    let lower = header.to_lowercase().replace(['µ', 'μ'], "u");
    let words: Vec<&str> = lower
        .split(|c: char| !(c.is_alphanumeric() || c == '°'))
        .filter(|w| !w.is_empty())
        .collect();
    let (name, unit) = words.split_first()?;
    let (_, quantities) = NAMES.iter().find(|(known, _)| known == name)?;
    let unit = unit.join("_");
    let known = UNITS.iter().filter(|(_, quantity, _)| quantities.contains(quantity));
    let found = known.clone().find(|(known, ..)| *known == unit);
    Some(found.map(|(_, quantity, factor)| (*quantity, *factor)).ok_or_else(|| {
        let allowed: Vec<&str> = known.map(|(known, ..)| *known).collect();
        format!("`{header}` has no unit that is known, allowed {name} with {}", allowed.join(", "))
    }))
}

pub(super) fn is_time(header: &str) -> bool {
    matches!(meant(header), Some(Ok((Time, _))))
}

#[derive(Debug, PartialEq)]
pub(super) struct Columns<'a> {
    /// Header and factor of three columns. The factors convert the time to s, the command to the unit of `drive`, and
    /// the position to m.
    pub of: [(&'a str, f64); 3],
    pub drive: Drive,
}

impl<'a> Columns<'a> {
    /// Finds the columns in a header. A count is `resolution_m` long, if the sensor has counts.
    ///
    /// # Errors
    /// The message has one line. It says which column is missing, appears twice or has no unit.
    pub(super) fn find(
        header: &'a [String],
        units: Units,
        resolution_m: f64,
    ) -> Result<Self, String> {
        let (rotary, radius_m) = match units {
            Units::Linear => (false, 1.0),
            Units::Rotary { radius_m } => (true, radius_m),
        };
        let mut found = [None; 3];
        let mut drive = Drive::Voltage;
        let mut wrong = None;
        for name in header {
            let (role, factor) = match meant(name) {
                None => continue,
                Some(Err(error)) => {
                    wrong.get_or_insert(error);
                    continue;
                }
                Some(Ok((Time, factor))) => (0, factor),
                Some(Ok((Command(which), factor))) => {
                    drive = which;
                    (1, factor)
                }
                Some(Ok((Torque, factor))) if rotary => {
                    drive = Drive::Force;
                    (1, factor / radius_m)
                }
                Some(Ok((Angle, factor))) if rotary => (2, factor * radius_m),
                Some(Ok((Length, factor))) if !rotary => (2, factor),
                Some(Ok((Counts, factor))) => {
                    if resolution_m == 0.0 {
                        return Err(format!(
                            "`{name}` needs the size of a count: give it as --resolution, or the scene of the device as \
                             --base"
                        ));
                    }
                    (2, factor * resolution_m)
                }
                Some(Ok(_)) => {
                    let device = if rotary { "rotary" } else { "linear" };
                    let other = if rotary {
                        "linear scene, such as paper-1um"
                    } else {
                        "rotary scene, such as hapkit"
                    };
                    wrong.get_or_insert(format!(
                        "`{name}` does not fit the base scene, which is {device}: give a {other}, as --base"
                    ));
                    continue;
                }
            };
            if let Some((before, _)) = found[role].replace((name.as_str(), factor)) {
                return Err(match before == name {
                    true => format!("several columns {name}, allowed one"),
                    false => format!("the columns {before} and {name} say the same, allowed one"),
                });
            }
        }
        let needed = ["time_s", "voltage_v", if rotary { "position_rad" } else { "position_m" }];
        let missing = found.iter().zip(needed).find(|(found, _)| found.is_none());
        if let Some((_, column)) = missing {
            let why = wrong.map_or_else(String::new, |wrong| format!("; {wrong}"));
            let (has, needed) = (header.join(","), needed.join(","));
            return Err(format!("no column {column} in `{has}`, needed {needed}{why}"));
        }
        Ok(Self { of: found.map(Option::unwrap_or_default), drive })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROTARY: Units = Units::Rotary { radius_m: 0.1 };

    fn find(header: &str, units: Units) -> Result<([f64; 3], Drive), String> {
        let header: Vec<String> = header.split(',').map(str::to_owned).collect();
        let found = Columns::find(&header, units, 1e-6)?;
        Ok((found.of.map(|(_, factor)| factor), found.drive))
    }

    #[test]
    fn a_column_is_a_quantity_and_its_unit() {
        for (header, units, factors, drive) in [
            ("time_s,voltage_v,position_m", Units::Linear, [1.0, 1.0, 1.0], Drive::Voltage),
            ("Time (ms),Force [N],Position (mm)", Units::Linear, [1e-3, 1.0, 1e-3], Drive::Force),
            ("t/us,current_mA,x (µm)", Units::Linear, [1e-6, 1e-3, 1e-6], Drive::Current),
            (
                "Timestamp s,Voltage/mV,encoder ticks",
                Units::Linear,
                [1.0, 1e-3, 1e-6],
                Drive::Voltage,
            ),
            ("time_s,torque_n_m,position_rad", ROTARY, [1.0, 10.0, 0.1], Drive::Force),
            (
                "t (s),Torque (N·m),theta (rad),velocity (m/s)",
                ROTARY,
                [1.0, 10.0, 0.1],
                Drive::Force,
            ),
            ("time_s,torque_mNm,position_counts", ROTARY, [1.0, 0.01, 1e-6], Drive::Force),
        ] {
            let (found, which) = find(header, units).unwrap_or_else(|e| panic!("{header}: {e}"));
            assert_eq!(which, drive, "{header}");
            for (found, wanted) in found.into_iter().zip(factors) {
                assert!((found / wanted - 1.0).abs() < 1e-12, "{header}: {found} not {wanted}");
            }
        }
        let degrees = find("time_s,torque_n_m,angle (deg)", ROTARY).unwrap().0[2];
        assert!((degrees - 0.1 * std::f64::consts::PI / 180.0).abs() < 1e-15);
    }

    #[test]
    fn what_is_missing_is_named_with_its_cause() {
        for (header, units, wanted) in [
            (
                "time_s,voltage_v,position",
                Units::Linear,
                "`position` has no unit that is known, allowed position with m, cm",
            ),
            ("time (h),voltage_v,position_m", Units::Linear, "allowed time with s, sec, ms, us"),
            (
                "time_s,voltage_v,position_rad",
                Units::Linear,
                "no column position_m in `time_s,voltage_v,position_rad`, needed time_s,voltage_v,position_m; `position_rad` does not fit the base scene, which is linear: give a rotary scene, \
                 such as hapkit, as --base",
            ),
            ("time_s,voltage_v,position_m", ROTARY, "no column position_rad"),
            ("time_s,torque_n_m,position_m", Units::Linear, "`torque_n_m` does not fit"),
            (
                "time_s,voltage_v,force_n,position_m",
                Units::Linear,
                "the columns voltage_v and force_n say the same, allowed one",
            ),
            (
                "time_s,time_s,voltage_v,position_m",
                Units::Linear,
                "several columns time_s, allowed one",
            ),
            (
                "a,b,c",
                Units::Linear,
                "no column time_s in `a,b,c`, needed time_s,voltage_v,position_m",
            ),
        ] {
            let error = find(header, units).unwrap_err();
            assert!(error.contains(wanted), "{header}: {error}");
        }
        let header = ["time_s", "voltage_v", "position_counts"].map(str::to_owned);
        let error = Columns::find(&header, Units::Linear, 0.0).unwrap_err();
        assert!(error.contains("needs the size of a count"), "{error}");
    }
}
