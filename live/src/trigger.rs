//! Triggers stop the view after an event.

use serde::Deserialize;
use zwidth::telemetry::Flags;

use crate::history::{History, Row, SIGNALS};

#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Trigger {
    #[default]
    Off,
    /// The handle enters the wall.
    Contact,
    Fault,
    /// A signal crosses a level.
    Level {
        /// Index of the signal: 0 is position, 1 is velocity, 2 is force.
        signal: usize,
        /// The level as an integer of the control loop.
        level: i32,
        /// Whether the signal must rise through the level. If false, the signal must fall through the level.
        rising: bool,
    },
}

impl Trigger {
    /// Whether the values of the trigger are allowed.
    pub fn is_valid(&self) -> bool {
        !matches!(self, Self::Level { signal, .. } if *signal >= SIGNALS)
    }

    fn is_met(&self, before: &Row, now: &Row) -> bool {
        let enters = |flag: Flags| before.flags & flag.bits() == 0 && now.flags & flag.bits() != 0;
        match *self {
            Self::Off => false,
            Self::Contact => enters(Flags::CONTACT),
            Self::Fault => enters(Flags::FAULT),
            Self::Level { signal, level, rising } => {
                let [a, b] = [before, now].map(|row| row.values.get(signal).copied());
                let (Some(a), Some(b)) = (a, b) else { return false };
                if rising { a < level && b >= level } else { a > level && b <= level }
            }
        }
    }
}

/// Looks for the event in each row, once.
#[derive(Clone, Copy, Debug, Default)]
pub struct Watch {
    trigger: Trigger,
    next: u64,
    /// Number of the row in which the event was found.
    pub met: Option<u64>,
}

impl Watch {
    pub fn arm(&mut self, trigger: Trigger, history: &History) {
        *self = Self { trigger, next: history.rows()[1], met: None };
    }

    pub fn look(&mut self, history: &History) {
        let [begin, end] = history.rows();
        if self.next > end {
            self.next = end; // the board was reset
        }
        self.next = self.next.max(begin + 1);
        while self.met.is_none() && self.trigger != Trigger::Off && self.next < end {
            let rows = (history.row(self.next - 1), history.row(self.next));
            if let (Some(before), Some(now)) = rows
                && self.trigger.is_met(&before, &now)
            {
                self.met = Some(self.next);
            }
            self.next += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(force: i32, flags: Flags) -> Row {
        Row { values: [0, 0, force], flags: flags.bits() }
    }

    #[test]
    fn it_is_met_once_at_the_first_row_that_does() {
        let mut history = History::default();
        let flag = |n: u64| if n % 100 >= 50 { Flags::CONTACT } else { Flags::default() };
        let push = |history: &mut History, numbers: std::ops::Range<u64>| {
            for n in numbers {
                history.push(n, &row(i32::try_from(n % 60).unwrap(), flag(n)));
            }
        };
        push(&mut history, 0..70);
        let level = Trigger::Level { signal: 2, level: 30, rising: true };
        let falling = Trigger::Level { signal: 2, level: 30, rising: false };
        for (trigger, wanted) in [
            (Trigger::Contact, Some(150)),
            (level, Some(90)),
            (falling, Some(120)),
            (Trigger::Fault, None),
            (Trigger::Off, None),
        ] {
            let mut history = History::default();
            push(&mut history, 0..70);
            let mut watch = Watch::default();
            watch.arm(trigger, &history);
            push(&mut history, 70..300);
            watch.look(&history);
            assert_eq!(watch.met, wanted, "{trigger:?}");
        }
        assert!(!Trigger::Level { signal: 3, level: 0, rising: true }.is_valid());
    }
}
