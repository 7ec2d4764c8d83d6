//! The units of a scene: m and N at the handle, or rad and N m about the handle's axis.
//!
//! In memory all values are in m and N at the handle. A rotary scene is converted once, when it is read
//! ([`Units::to_handle`]). Files, figures and texts are converted once, when they are written.

use crate::notation::rounded;

/// Units of a scene, and of all results that are computed from it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Units {
    /// Positions in m, forces in N.
    #[default]
    Linear,
    /// Angles in rad and torques in N m. The handle has this radius.
    Rotary { radius_m: f64 },
}

/// A physical quantity in linear and in rotary scenes.
struct Quantity {
    /// The keys of this quantity end with this text in linear scenes. Empty if the quantity is only used in texts.
    linear: &'static str,
    rotary: &'static str,
    /// The rotary value is the linear value times `radius^power`.
    power: i32,
    /// The rotary unit that texts use. Angles are written in degrees.
    unit: &'static str,
    /// The linear units that texts use. Each has the factor that converts it to the SI unit.
    units: &'static [(&'static str, f64)],
}

const DEGREES: f64 = 180.0 / std::f64::consts::PI;

const fn quantity(
    [linear, rotary, unit]: [&'static str; 3],
    power: i32,
    units: &'static [(&'static str, f64)],
) -> Quantity {
    Quantity { linear, rotary, power, unit, units }
}

/// If a suffix is the end of a longer suffix, the longer suffix comes first.
const QUANTITIES: &[Quantity] = &[
    quantity(["mass_kg", "inertia_kg_m2", "kg m^2"], 2, &[("kg", 1.0), ("g", 1e-3)]),
    quantity(["n2_s_per_m2", "n2_m2_s_per_rad2", "N^2 m^2 s/rad^2"], 4, &[("N^2 s/m^2", 1.0)]),
    quantity(["", "", "N² m² s/rad²"], 4, &[("N² s/m²", 1.0), ("10^6 N² s/m²", 1e6)]),
    quantity(["n_per_m_s", "n_m_per_rad_s", ""], 2, &[]),
    quantity(["n_s_per_m", "n_m_s_per_rad", "N m s/rad"], 2, &[("N s/m", 1.0)]),
    quantity(
        ["n_per_m", "n_m_per_rad", "N m/rad"],
        2,
        &[("N/m", 1.0), ("kN/m", 1e3), ("MN/m", 1e6)],
    ),
    quantity(["n_per_v", "n_m_per_v", "N m/V"], 1, &[("N/V", 1.0)]),
    quantity(["n_per_a", "n_m_per_a", "N m/A"], 1, &[("N/A", 1.0)]),
    quantity(["m_per_s2", "rad_per_s2", ""], -1, &[]),
    quantity(["m_per_s", "rad_per_s", "deg/s"], -1, &[("mm/s", 1e-3 * DEGREES), ("m/s", DEGREES)]),
    quantity(["", "", "mN m"], 1, &[("mN", 1.0)]),
    quantity(["n", "n_m", "N m"], 1, &[("N", 1.0)]),
    quantity(["", "", "mdeg"], -1, &[("um", 1e-3 * DEGREES), ("µm", 1e-3 * DEGREES)]),
    quantity(["m", "rad", "deg"], -1, &[("mm", 1e-3 * DEGREES), ("m", DEGREES)]),
];

/// Finds the first unit in texts for which `is` returns true. Returns the unit, its quantity and its factor.
fn written(is: impl Fn(&'static str) -> bool) -> Option<(&'static str, &'static Quantity, f64)> {
    let each =
        |of: &'static Quantity| of.units.iter().map(move |&(unit, factor)| (unit, of, factor));
    QUANTITIES.iter().flat_map(each).find(|&(unit, ..)| is(unit))
}

/// The quantity of this key in linear scenes.
fn of_key(key: &str) -> Option<&'static Quantity> {
    QUANTITIES.iter().find(|of| !of.linear.is_empty() && ends(key, of.linear))
}

/// Significant digits of a value that is read. A value with so few digits does not change when one product is rounded.
const DIGITS_IN: usize = 15;
/// Significant digits of a value that is written.
const DIGITS_OUT: usize = 12;
/// Significant digits of a value in a text for people.
const DIGITS_READ: usize = 3;

/// Whether `key` ends with `suffix`, at a word boundary.
fn ends(key: &str, suffix: &str) -> bool {
    key.strip_suffix(suffix).is_some_and(|rest| rest.is_empty() || rest.ends_with(['_', '.']))
}

/// Whether a key is a phase. A phase is an angle in linear scenes too.
fn is_phase(key: &str) -> bool {
    ends(key, "phase_rad")
}

impl Units {
    fn factor(self, power: i32) -> f64 {
        match self {
            Self::Linear => 1.0,
            Self::Rotary { radius_m } => radius_m.powi(power),
        }
    }

    /// Radius of the handle in m. It is 0 in linear scenes.
    pub fn radius_m(self) -> f64 {
        match self {
            Self::Linear => 0.0,
            Self::Rotary { radius_m } => radius_m,
        }
    }

    pub fn is_rotary(self) -> bool {
        self != Self::Linear
    }

    /// The rotary key for the linear `key`, or `None` if both are the same.
    pub fn rotary_key(key: &str) -> Option<String> {
        let found = of_key(key)?;
        Some(format!("{}{}", key.strip_suffix(found.linear)?, found.rotary))
    }

    /// Converts a rotary key and its value to linear ones. Returns `None` if they stay the same.
    pub fn to_handle(self, key: &str, value: f64) -> Option<(String, f64)> {
        let is = |of: &&Quantity| !of.rotary.is_empty() && ends(key, of.rotary);
        let found = QUANTITIES.iter().find(is).filter(|_| !is_phase(key))?;
        let key = format!("{}{}", key.strip_suffix(found.rotary)?, found.linear);
        Some((key, rounded(value / self.factor(found.power), DIGITS_IN)))
    }

    /// A stiffness K that a user typed in these units, converted to N/m.
    pub fn stiffness_n_per_m(self, typed: f64) -> f64 {
        self.typed(2, typed)
    }

    /// A damping B that a user typed in these units, converted to N s/m.
    pub fn damping_n_s_per_m(self, typed: f64) -> f64 {
        self.typed(2, typed)
    }

    fn typed(self, power: i32, typed: f64) -> f64 {
        match self {
            Self::Linear => typed,
            Self::Rotary { .. } => rounded(typed / self.factor(power), DIGITS_IN),
        }
    }

    /// The key that a result has in these units, and the factor for its numbers. `None` if key and numbers stay the
    /// same.
    pub fn key(self, key: &str) -> Option<(String, f64)> {
        if self == Self::Linear {
            return None;
        }
        Some((Self::rotary_key(key)?, self.factor(of_key(key)?.power)))
    }

    /// A number of a result in the units of the output: `value * factor`, rounded to 12 digits. `factor` is from
    /// [`key`](Self::key).
    pub fn told(value: f64, factor: f64) -> f64 {
        if factor == 1.0 { value } else { rounded(value * factor, DIGITS_OUT) }
    }

    /// Writes a value at the handle as text for a board's console, with the console's fifteen digits. The name of `key`
    /// determines the quantity.
    pub fn command(self, key: &str, at_handle: f64) -> String {
        match self.key(key) {
            Some((_, factor)) => rounded(at_handle * factor, DIGITS_IN).to_string(),
            None => at_handle.to_string(),
        }
    }

    /// Converts a number from a board's console to the value at the handle.
    pub fn from_reply(self, key: &str, said: f64) -> f64 {
        self.key(key).map_or(said, |(_, factor)| said / factor)
    }

    /// The unit that replaces the linear `unit` in texts, and the factor for its numbers.
    pub fn written(self, unit: &'static str) -> (&'static str, f64) {
        match written(|known| known == unit).filter(|_| self.is_rotary()) {
            Some((_, of, factor)) => (of.unit, factor * self.factor(of.power)),
            None => (unit, 1.0),
        }
    }

    /// Writes a value at the handle as text for people, with three digits and a unit. `unit` is the linear unit. A unit
    /// that begins with N gets an SI prefix, such as kN. From 1000 um or mdeg on, the unit is mm or deg. Other large and
    /// small numbers have an exponent.
    pub fn said(self, at_handle: f64, unit: &'static str) -> String {
        let (unit, factor) = self.written(unit);
        let value = rounded(at_handle * factor, DIGITS_READ);
        if unit.starts_with('N') && !unit.starts_with("N^2") {
            let (prefix, times) = match value.abs() {
                v if v >= 1e6 => ("M", 1e-6),
                v if v >= 1e3 => ("k", 1e-3),
                v if v >= 0.1 || v == 0.0 => ("", 1.0),
                v if v >= 1e-4 => ("m", 1e3),
                _ => ("u", 1e6),
            };
            return format!("{} {prefix}{unit}", rounded(value * times, DIGITS_READ));
        }
        let (value, unit) = match unit {
            "um" | "µm" if value.abs() >= 1e3 => (rounded(value * 1e-3, DIGITS_READ), "mm"),
            "mdeg" if value.abs() >= 1e3 => (rounded(value * 1e-3, DIGITS_READ), "deg"),
            _ => (value, unit),
        };
        match value.abs() {
            v if v >= 1e5 || (v > 0.0 && v < 1e-3) => format!("{value:e} {unit}"),
            _ => format!("{value} {unit}"),
        }
    }

    /// Converts the numbers of a text to these units. The function finds the forms `NUMBER UNIT`,
    /// `NUMBER to NUMBER UNIT`, `NUMBER +- NUMBER UNIT`, and `KEY is NUMBER, allowed NUMBER to NUMBER`.
    pub fn text(self, text: &str) -> String {
        if !self.is_rotary() {
            return text.to_owned();
        }
        let lines: Vec<String> = text.split('\n').map(|line| self.line(line)).collect();
        lines.join("\n")
    }

    fn line(self, line: &str) -> String {
        if let Some(refusal) = self.refusal(line) {
            return refusal;
        }
        let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        for word in &mut words {
            let key = word.trim_end_matches([';', ',', ':']);
            if let Some(rotary) = Self::rotary_key(key).filter(|_| key.contains('.')) {
                *word = format!("{rotary}{}", &word[key.len()..]);
            }
        }
        let mut at = 1;
        while at < words.len() {
            let rest = words[at..].join(" ");
            let is_end =
                |tail: &str| !tail.starts_with(|c: char| c.is_alphanumeric() || "/^*".contains(c));
            let found = written(|unit| {
                rest.strip_prefix(unit).is_some_and(|tail| {
                    is_end(tail) && !tail.starts_with(" m/") && !tail.starts_with(" s/")
                })
            });
            let before = words[at - 1].trim_start_matches(['(', '[']).parse::<f64>();
            if let (Some((unit, &Quantity { unit: rotary, power, .. }, factor)), Ok(_)) =
                (found, before)
            {
                let factor = factor * self.factor(power);
                scale(&mut words[at - 1], factor);
                if at > 2 && ["to", "+-"].contains(&words[at - 2].as_str()) {
                    scale(&mut words[at - 3], factor);
                }
                let tail = rest[unit.len()..].to_owned();
                words.truncate(at);
                words.push(format!("{rotary}{tail}"));
                let whole = words.join(" ");
                words = whole.split(' ').map(str::to_owned).collect();
                at += rotary.split(' ').count();
            }
            at += 1;
        }
        words.join(" ")
    }

    /// Converts a line `KEY is VALUE, allowed LOW to HIGH`. Returns `None` for other lines.
    fn refusal(self, line: &str) -> Option<String> {
        let (before, range) = line.split_once(", allowed ")?;
        let (key, value) = before.rsplit_once(" is ")?;
        let (low, high) = range.split_once(" to ")?;
        let (origin, bare) =
            key.rsplit_once(' ').map_or(("", key), |(origin, bare)| (origin, bare));
        let (renamed, factor) = match bare {
            "--stiffness" | "--stiffnesses" => (bare.to_owned(), self.factor(2)),
            "--damping" | "--dampings" => (bare.to_owned(), self.factor(2)),
            "--gain" => (bare.to_owned(), self.factor(1)),
            bare => self.key(bare)?,
        };
        let number = |text: &str| Some(Self::told(text.parse().ok()?, factor));
        let space = if origin.is_empty() { "" } else { " " };
        let [low, high] = zwidth::ends(&(number(low)?..=number(high)?));
        let value = zwidth::shorten(number(value)?);
        Some(format!("{origin}{space}{renamed} is {value}, allowed {low} to {high}"))
    }
}

/// Multiplies the number in a word. The number keeps its number of digits, but has at least four.
fn scale(word: &mut String, factor: f64) {
    let bare = word.trim_start_matches(['(', '[']);
    let Ok(value) = bare.parse::<f64>() else { return };
    let digits = bare.split(['e', 'E']).next().unwrap_or_default();
    let digits =
        digits.trim_start_matches(['-', '0', '.']).chars().filter(char::is_ascii_digit).count();
    let start = word.len() - bare.len();
    let scaled = rounded(value * factor, digits.clamp(4, DIGITS_OUT));
    let text = match bare.contains('e') {
        true => format!("{scaled:.4e}"),
        false => scaled.to_string(),
    };
    word.replace_range(start.., &text);
}

#[cfg(test)]
mod tests {
    use super::*;

    const PADDLE: Units = Units::Rotary { radius_m: 0.25 };

    #[test]
    fn keys_and_values_go_to_the_handle_and_back() {
        for (rotary, value, linear, at_handle) in [
            ("wall.position_rad", 0.5, "wall.position_m", 0.125),
            ("stiffness_n_m_per_rad", 1.0, "stiffness_n_per_m", 16.0),
            ("damping_start_n_m_s_per_rad", 1.0, "damping_start_n_s_per_m", 16.0),
            ("integral_n_m_per_rad_s", 1.0, "integral_n_per_m_s", 16.0),
            ("push_n_m", 1.0, "push_n", 4.0),
            ("speed_max_rad_per_s", 4.0, "speed_max_m_per_s", 1.0),
            ("inertia_kg_m2", 0.0625, "mass_kg", 1.0),
        ] {
            let found = PADDLE.to_handle(rotary, value).unwrap();
            assert_eq!(found, (linear.to_owned(), at_handle), "{rotary}");
            let (key, factor) = PADDLE.key(linear).unwrap();
            assert_eq!((key.as_str(), at_handle * factor), (rotary, value));
            assert_eq!(Units::rotary_key(linear).as_deref(), Some(rotary));
            assert_eq!(Units::Linear.key(linear), None);
        }
        for same in ["phase_rad", "cutoff_hz", "settle_s", "saturated_fraction", "gain", "hits"] {
            assert_eq!(PADDLE.to_handle(same, 1.0), None, "{same}");
            assert_eq!(PADDLE.key(same), None, "{same}");
        }
        assert_eq!(Units::Rotary { radius_m: 0.07 }.to_handle("a_rad", 1.2).unwrap().1, 0.084);
    }

    #[test]
    fn a_number_in_a_sentence_has_three_digits_and_its_unit_with_a_prefix() {
        for (at_handle, unit, linear, rotary) in [
            (0.25, "um", "0.25 um", "0.0573 mdeg"),
            (50_000.0, "um", "50 mm", "11.5 deg"),
            (1.0 / 3.0, "mm", "0.333 mm", "0.0764 deg"),
            (11.812, "N", "11.8 N", "2.95 N m"),
            (0.05906, "N", "59.1 mN", "14.8 mN m"),
            (-0.00008, "N", "-80 uN", "-20 uN m"),
            (999.96, "N/m", "1 kN/m", "62.5 N m/rad"),
            (54_000.0, "N/m", "54 kN/m", "3.38 kN m/rad"),
            (7.96e6, "N^2 s/m^2", "7.96e6 N^2 s/m^2", "31100 N^2 m^2 s/rad^2"),
            (0.416, "kg", "0.416 kg", "0.026 kg m^2"),
            (1.76e-4, "kg", "1.76e-4 kg", "1.1e-5 kg m^2"),
            (100.0, "N s/m", "100 N s/m", "6.25 N m s/rad"),
            (0.0, "m", "0 m", "0 deg"),
        ] {
            assert_eq!(Units::Linear.said(at_handle, unit), linear);
            assert_eq!(PADDLE.said(at_handle, unit), rotary);
        }
    }

    #[test]
    fn what_people_read_is_in_the_scenes_units() {
        for (linear, rotary) in [
            (
                "K = 1600 N/m, B = 16 N s/m, butterworth",
                "K = 100 N m/rad, B = 1 N m s/rad, butterworth",
            ),
            ("area 2.5600e2 N^2 s/m^2 with", "area 1.0000e0 N^2 m^2 s/rad^2 with"),
            ("force only from 0 to 250 mm, start", "force only from 0 to 57.3 deg, start"),
            ("mass: 1.600e1 +- 1.6e0 kg; longer", "mass: 1.0000e0 +- 1.0000e-1 kg m^2; longer"),
            ("a handle of 16 g: 3 good ones", "a handle of 0.001 kg m^2: 3 good ones"),
            ("off above 0.25 m/s; a hit", "off above 57.3 deg/s; a hit"),
            ("5.906 N at full command, 4 N for ever", "1.476 N m at full command, 1 N m for ever"),
            (
                "x: wall.position_m is 2, allowed -1 to 1",
                "x: wall.position_rad is 8, allowed -4 to 4",
            ),
            ("--stiffness is 32, allowed 0 to 16", "--stiffness is 2, allowed 0 to 1"),
            (
                "B reached walk.damping_max_n_s_per_m; cut",
                "B reached walk.damping_max_n_m_s_per_rad; cut",
            ),
            ("2 mistakes, 3 Newtons, 4 Hz", "2 mistakes, 3 Newtons, 4 Hz"),
        ] {
            assert_eq!(PADDLE.text(linear), rotary);
            assert_eq!(Units::Linear.text(linear), linear);
        }
    }
}
