use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::trigger::Trigger;

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum FromPage {
    /// A line for the console. Only the owner may send it. `stopped` is the number of stops that the page knows. If
    /// there were more stops, the line is refused.
    Command { line: String, stopped: Option<u64> },
    /// Switches the force off at once. Any page may send this message. The answer has the same `id`.
    Stop { id: u64 },
    /// Where the finger moves the handle, as a position of the board in m. `None` releases the handle. Only the owner
    /// may send this message, and only to a virtual board.
    Finger { target_m: Option<f64> },
    /// Opens or closes the emergency stop of a virtual board. Only the owner may send this message.
    EmergencyStop { open: bool },
    /// The page asks for control of the board.
    Ask {},
    /// The owner gives control to the page that has asked for control.
    Give {},
    /// Repeats the number of a state. Only the page's script can do so, and only after it has shown the state.
    Alive { number: u64 },
    /// Which rows to plot: their time span, the largest number of bins, and whether the view stands still (`paused`).
    View { span_s: f64, columns: u64, paused: bool },
    /// Sets the trigger that stops the view.
    Trigger { on: Trigger },
    /// Asks for the boundary that the simulator predicts.
    Predict(Question),
}

/// A page asks for the boundary that is predicted for this estimator.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Question {
    pub estimator: String,
    /// Cutoff of the estimator, or another frequency that tunes it, in Hz.
    pub cutoff_hz: f64,
}

impl FromPage {
    /// Reads a message. The key `type` gives the kind of message.
    ///
    /// # Errors
    /// The text is not a message, or a value is not allowed. The error is one line of text.
    pub fn read(text: &str) -> Result<Self, String> {
        // serde's tagged enums are not used here: they read numbers as maps if any crate of the build enables
        // serde_json's arbitrary precision
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
            Self::Stop { .. }
            | Self::EmergencyStop { .. }
            | Self::Ask {}
            | Self::Give {}
            | Self::Alive { .. } => false,
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
        assert_eq!(read(r#"{"type":"alive","number":7}"#), Ok(FromPage::Alive { number: 7 }));
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
            r#"{"type":"alive","number":-1}"#,
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
