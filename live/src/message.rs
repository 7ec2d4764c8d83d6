//! What a page may say, in JSON.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::trigger::Trigger;

/// A message from a page.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum FromPage {
    /// A line for the console. The owner's only. `stopped`: how many stops the page knows of, where it is not to come behind
    /// another.
    Command { line: String, stopped: Option<u64> },
    /// Force off, at once; from any page. `id`: to know the answer by.
    Stop { id: u64 },
    /// Where the finger wants the handle, m, in the board's positions; none: it lets go. The owner's only; of a virtual board.
    Finger { target_m: Option<f64> },
    /// The switch of the emergency stop. The owner's only; of a virtual board.
    EmergencyStop { open: bool },
    /// This page would like to command.
    Ask {},
    /// The owner gives control to the page that asked.
    Give {},
    /// Part of the rows to plot: its length, the number of bins at most, and not to go on with time.
    View { span_s: f64, columns: u64, paused: bool },
    /// When to stop and look.
    Trigger { on: Trigger },
    /// The boundary that the simulator predicts.
    Predict(Question),
}

/// The boundary that a page wants to know.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Question {
    pub estimator: String,
    /// Tuning of the estimator, Hz.
    pub cutoff_hz: f64,
}

impl FromPage {
    /// Reads a message: its keys, and `type`, which says what it is.
    ///
    /// # Errors
    /// It is none, or has a value that cannot be; one line.
    pub fn read(text: &str) -> Result<Self, String> {
        // Not as serde's tagged enum: that makes maps of what is to be a number where any crate of the build asks
        // serde_json for arbitrary precision.
        let mut keys: Map<String, Value> =
            serde_json::from_str(text).map_err(|error| error.to_string())?;
        let Some(Value::String(kind)) = keys.remove("type") else {
            return Err("a message without a type".to_owned());
        };
        let message = Value::Object(Map::from_iter([(kind, keys.into())]));
        let message = serde_json::from_value(message).map_err(|error| error.to_string())?;
        let bad = match &message {
            Self::Command { line, .. } => line.len() > 64 || line.chars().any(char::is_control),
            Self::Finger { target_m } => target_m.is_some_and(|m| !(-1.0..=1.0).contains(&m)),
            Self::View { span_s, columns, .. } => {
                !(0.001..=110.0).contains(span_s) || !(10..=4000).contains(columns)
            }
            Self::Trigger { on } => !on.is_valid(),
            Self::Predict(Question { estimator, cutoff_hz }) => {
                estimator.len() > 40 || !(0.1..=1e5).contains(cutoff_hz)
            }
            Self::Stop { .. } | Self::EmergencyStop { .. } | Self::Ask {} | Self::Give {} => false,
        };
        if bad { Err("a value that cannot be".to_owned()) } else { Ok(message) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_read_or_refused() {
        let read = FromPage::read;
        assert_eq!(read(r#"{"type":"stop","id":7}"#), Ok(FromPage::Stop { id: 7 }));
        let trigger = r#"{"type":"trigger","on":{"level":{"signal":2,"level":5,"rising":true}}}"#;
        let level = Trigger::Level { signal: 2, level: 5, rising: true };
        assert_eq!(read(trigger), Ok(FromPage::Trigger { on: level }));
        let finger = r#"{"type":"finger","target_m":0.0625}"#;
        assert_eq!(read(finger), Ok(FromPage::Finger { target_m: Some(0.0625) }));
        let gone = r#"{"type":"finger","target_m":null}"#;
        assert_eq!(read(gone), Ok(FromPage::Finger { target_m: None }));
        for bad in [
            "",
            "{}",
            "[]",
            "null",
            "7",
            r#"{"type":"nothing"}"#,
            r#"{"type":"stop"}"#,
            r#"{"type":"command","line":"k 1\ndisarm"}"#,
            r#"{"type":"finger","target_m":7}"#,
            r#"{"type":"finger","target_m":1e999}"#,
            r#"{"type":"view","span_s":0,"columns":9,"paused":true}"#,
            r#"{"type":"trigger","on":{"level":{"signal":3,"level":5,"rising":true}}}"#,
        ] {
            assert!(read(bad).is_err(), "{bad}");
        }
        assert!(read(&format!(r#"{{"type":"command","line":"{}"}}"#, "k".repeat(65))).is_err());
        assert!(read(&"[".repeat(4000)).is_err());
    }
}
