//! What a page may say, in JSON.

use serde::Deserialize;

use crate::trigger::Trigger;

/// A message from a page.
#[derive(Clone, Debug, PartialEq)]
pub enum FromPage {
    /// A line for the console. The owner's only.
    Command {
        /// The line without its end.
        line: String,
        /// How many stops the page knows of, where it is not to come behind another.
        stopped: Option<u64>,
    },
    /// Force off, at once; from any page.
    Stop {
        /// To know the answer by.
        id: u64,
    },
    /// Where the finger wants the handle, m; none: it lets go. The owner's only; of a virtual board.
    Finger {
        /// In the board's positions.
        target_m: Option<f64>,
    },
    /// The switch of the emergency stop. The owner's only; of a virtual board.
    EmergencyStop { open: bool },
    /// This page would like to command.
    Ask,
    /// The owner gives control to the page that asked.
    Give,
    /// Part of the rows to plot.
    View {
        /// Length of the plot, s.
        span_s: f64,
        /// Number of bins at most.
        columns: u64,
        /// Not to go on with time.
        paused: bool,
    },
    /// When to stop and look.
    Trigger(Trigger),
    /// The boundary that the simulator predicts.
    Predict {
        estimator: String,
        /// Tuning of the estimator, Hz.
        cutoff_hz: f64,
    },
}

/// All keys that a message may have, flat: of tagged enums serde makes maps of what is to be a number where any crate of
/// the build asks serde_json for arbitrary precision.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Keys {
    r#type: String,
    line: Option<String>,
    stopped: Option<u64>,
    id: Option<u64>,
    target_m: Option<f64>,
    open: Option<bool>,
    span_s: Option<f64>,
    columns: Option<u64>,
    paused: Option<bool>,
    on: Option<String>,
    signal: Option<usize>,
    level: Option<i32>,
    rising: Option<bool>,
    estimator: Option<String>,
    cutoff_hz: Option<f64>,
}

impl Keys {
    fn message(self) -> Option<FromPage> {
        let Self { line, id, target_m, open, span_s, columns, paused, .. } = self;
        Some(match self.r#type.as_str() {
            "command" => FromPage::Command { line: line?, stopped: self.stopped },
            "stop" => FromPage::Stop { id: id? },
            "finger" => FromPage::Finger { target_m },
            "emergency_stop" => FromPage::EmergencyStop { open: open? },
            "ask" => FromPage::Ask,
            "give" => FromPage::Give,
            "view" => FromPage::View { span_s: span_s?, columns: columns?, paused: paused? },
            "trigger" => FromPage::Trigger(match self.on?.as_str() {
                "off" => Trigger::Off,
                "contact" => Trigger::Contact,
                "fault" => Trigger::Fault,
                "level" => Trigger::Level {
                    signal: self.signal?,
                    level: self.level?,
                    rising: self.rising?,
                },
                _ => return None,
            }),
            "predict" => {
                FromPage::Predict { estimator: self.estimator?, cutoff_hz: self.cutoff_hz? }
            }
            _ => return None,
        })
    }
}

impl FromPage {
    /// Reads a message.
    ///
    /// # Errors
    /// It is none, or has a value that cannot be; one line.
    pub fn read(text: &str) -> Result<Self, String> {
        let keys: Keys = serde_json::from_str(text).map_err(|error| error.to_string())?;
        let message = keys.message().ok_or("a message without a type or with a key missing")?;
        let bad = match &message {
            Self::Command { line, .. } => line.len() > 64 || line.chars().any(char::is_control),
            Self::Finger { target_m } => target_m.is_some_and(|m| !(-1.0..=1.0).contains(&m)),
            Self::View { span_s, columns, .. } => {
                !(0.001..=110.0).contains(span_s) || !(10..=4000).contains(columns)
            }
            Self::Trigger(trigger) => !trigger.is_valid(),
            Self::Predict { estimator, cutoff_hz } => {
                estimator.len() > 40 || !(0.1..=1e5).contains(cutoff_hz)
            }
            Self::Stop { .. } | Self::EmergencyStop { .. } | Self::Ask | Self::Give => false,
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
        let trigger = r#"{"type":"trigger","on":"level","signal":2,"level":5,"rising":true}"#;
        let level = Trigger::Level { signal: 2, level: 5, rising: true };
        assert_eq!(read(trigger), Ok(FromPage::Trigger(level)));
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
            r#"{"type":"trigger","on":"level","signal":3,"level":5,"rising":true}"#,
        ] {
            assert!(read(bad).is_err(), "{bad}");
        }
        assert!(read(&format!(r#"{{"type":"command","line":"{}"}}"#, "k".repeat(65))).is_err());
        assert!(read(&"[".repeat(4000)).is_err());
    }
}
