//! An action of a session on a board. A script has one action per line.

use std::{fmt, str::FromStr};

use serde::{Serialize, Serializer};

#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Type these lines at once, and wait for the replies.
    Say(String),
    /// Type these lines at once, and do not wait for the replies.
    Type(String),
    /// Wait for this number of samples.
    Wait(u64),
    /// Wait for this number of cycles of the core. So the next action can happen in the middle of a sample.
    Cycles(u64),
    /// Move the handle by hand. The first number is the speed in m/s, the second the number of samples. Then hold the
    /// handle.
    Lead(f64, u64),
    /// Hold the handle at its present position.
    Hold,
    /// Release the handle.
    Free,
    /// Move the handle at once by this distance in m. Then hold the handle.
    Jump(f64),
    /// Open the emergency stop, or close it.
    Stop(bool),
    /// Set the supply voltage, in mV.
    Supply(u32),
    /// Reset the board by its reset pin.
    Reset,
    /// Switch the supply off and on.
    Power,
}

/// Writes the action as a line of a script.
impl Serialize for Action {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Say(text) => write!(f, "> {}", text.escape_default()),
            Self::Type(text) => write!(f, "~ {}", text.escape_default()),
            Self::Wait(samples) => write!(f, "wait {samples}"),
            Self::Cycles(cycles) => write!(f, "cycles {cycles}"),
            Self::Lead(speed, samples) => write!(f, "lead {speed} {samples}"),
            Self::Hold => f.write_str("hold"),
            Self::Free => f.write_str("free"),
            Self::Jump(metres) => write!(f, "jump {metres}"),
            Self::Stop(true) => f.write_str("emergency open"),
            Self::Stop(false) => f.write_str("emergency closed"),
            Self::Supply(mv) => write!(f, "supply {mv}"),
            Self::Reset => f.write_str("reset"),
            Self::Power => f.write_str("power"),
        }
    }
}

/// Allowed forms of a script's lines.
pub const FORMS: &str = "> LINE, ~ LINE, wait SAMPLES, cycles CYCLES, lead M_PER_S SAMPLES, hold, free, jump METRES, \
                         emergency open|closed, supply MILLIVOLTS, reset, power";

/// Longest duration of one action, in samples. It is ten minutes.
const LONGEST: u64 = 6_000_000;

impl FromStr for Action {
    type Err = ();

    fn from_str(line: &str) -> Result<Self, ()> {
        if let Some(text) = line.strip_prefix("> ") {
            return unescape(text).map(Self::Say).ok_or(());
        }
        if let Some(text) = line.strip_prefix("~ ") {
            return unescape(text).map(Self::Type).ok_or(());
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        let whole =
            |word: &str, most: u64| word.parse().ok().filter(|value| *value <= most).ok_or(());
        let real = |word: &str, most: f64| {
            word.parse().ok().filter(|value: &f64| value.abs() <= most).ok_or(())
        };
        Ok(match words[..] {
            ["wait", samples] => Self::Wait(whole(samples, LONGEST)?),
            ["cycles", cycles] => Self::Cycles(whole(cycles, 1_000_000_000)?),
            ["lead", speed, samples] => Self::Lead(real(speed, 10.0)?, whole(samples, LONGEST)?),
            ["hold"] => Self::Hold,
            ["free"] => Self::Free,
            ["jump", metres] => Self::Jump(real(metres, 1.0)?),
            ["emergency", "open"] => Self::Stop(true),
            ["emergency", "closed"] => Self::Stop(false),
            ["supply", mv] => Self::Supply(u32::try_from(whole(mv, 5_000)?).map_err(|_| ())?),
            ["reset"] => Self::Reset,
            ["power"] => Self::Power,
            _ => return Err(()),
        })
    }
}

fn unescape(text: &str) -> Option<String> {
    let mut plain = String::new();
    let mut rest = text.chars();
    while let Some(character) = rest.next() {
        if character != '\\' {
            plain.push(character);
            continue;
        }
        plain.push(match rest.next()? {
            'n' => '\n',
            't' => '\t',
            'r' => '\r',
            'u' => {
                let digits: String = rest.by_ref().take_while(|c| *c != '}').skip(1).collect();
                char::from_u32(u32::from_str_radix(&digits, 16).ok()?)?
            }
            other => other,
        });
    }
    Some(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_says_what_was_done() {
        for action in [
            Action::Say("k 2000\nb 5\r\n\t\u{1b}[A é \\ '".into()),
            Action::Type("arm".into()),
            Action::Wait(12),
            Action::Cycles(17_999),
            Action::Lead(-0.05, 300),
            Action::Hold,
            Action::Free,
            Action::Jump(0.0007),
            Action::Stop(true),
            Action::Stop(false),
            Action::Supply(2500),
            Action::Reset,
            Action::Power,
        ] {
            assert_eq!(action.to_string().parse(), Ok(action));
        }
        for bad in
            ["", "wait", "wait -1", "wait 1e9", "jump nan", "supply 6000", "reset now", "k 5"]
        {
            assert_eq!(bad.parse::<Action>(), Err(()), "{bad}");
        }
    }
}
