//! Who may command: one page owns the board, the others watch. Control passes by what people do, never by itself.

use std::time::Duration;

/// A page that has not answered for so long is not there.
pub const ABSENT: Duration = Duration::from_secs(1);

/// What becomes of a request for control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// It owns the board now.
    Granted,
    /// The owner has been asked.
    Waiting,
}

/// The pages.
#[derive(Debug, Default)]
pub struct Seats {
    pages: Vec<u64>,
    last: u64,
    owner: Option<u64>,
    /// When the owner last answered.
    heard: Option<Duration>,
    asking: Option<u64>,
}

impl Seats {
    /// A page has come. It owns the board if nobody does.
    pub fn enter(&mut self, now: Duration) -> u64 {
        self.last += 1;
        self.pages.push(self.last);
        if self.owner.is_none() {
            self.own(self.last, now);
        }
        self.last
    }

    /// A page has gone; whether it was the owner.
    pub fn leave(&mut self, page: u64) -> bool {
        self.pages.retain(|other| *other != page);
        self.asking = self.asking.filter(|other| *other != page);
        let owned = self.owner == Some(page);
        if owned {
            (self.owner, self.heard) = (None, None);
        }
        owned
    }

    /// A page would like to command.
    pub fn ask(&mut self, page: u64, now: Duration) -> Asked {
        match self.owner {
            Some(owner) if owner != page => {
                self.asking = Some(page);
                Asked::Waiting
            }
            _ => {
                self.own(page, now);
                Asked::Granted
            }
        }
    }

    /// The owner gives control to the page that asked for it; whether it did.
    pub fn give(&mut self, page: u64, now: Duration) -> bool {
        let Some(next) = self.asking.filter(|_| self.owner == Some(page)) else { return false };
        self.own(next, now);
        true
    }

    fn own(&mut self, page: u64, now: Duration) {
        (self.owner, self.heard, self.asking) = (Some(page), Some(now), None);
    }

    /// A page has answered.
    pub fn hear(&mut self, page: u64, now: Duration) {
        if self.owner == Some(page) {
            self.heard = Some(now);
        }
    }

    /// Whether the owner is there: then the board may be told so.
    pub fn is_attended(&self, now: Duration) -> bool {
        self.heard.is_some_and(|heard| now.saturating_sub(heard) < ABSENT)
    }

    /// Whether that page may command.
    pub fn owns(&self, page: u64) -> bool {
        self.owner == Some(page)
    }

    /// The owner.
    pub fn owner(&self) -> Option<u64> {
        self.owner
    }

    /// The page that asks for control.
    pub fn asking(&self) -> Option<u64> {
        self.asking
    }

    /// How many pages there are.
    pub fn pages(&self) -> usize {
        self.pages.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_owns_the_others_watch_and_control_passes_by_an_act() {
        let now = Duration::from_secs(7);
        let mut seats = Seats::default();
        let [first, second, third] = [seats.enter(now), seats.enter(now), seats.enter(now)];
        assert!(seats.owns(first) && !seats.owns(second));
        assert!(!seats.give(first, now), "to nobody");
        assert_eq!(seats.ask(second, now), Asked::Waiting);
        assert!(!seats.give(second, now), "not its own");
        assert!(!seats.give(third, now));
        assert!(seats.owns(first));
        assert!(seats.give(first, now));
        assert!(seats.owns(second) && !seats.owns(first));
        // Who goes leaves it to nobody; a watcher has to ask.
        assert!(seats.leave(second));
        assert_eq!(seats.owner(), None);
        assert!(!seats.leave(first));
        assert_eq!(seats.ask(third, now), Asked::Granted);
        assert!(seats.owns(third));
    }

    #[test]
    fn an_owner_that_does_not_answer_is_absent() {
        let now = Duration::from_secs(7);
        let mut seats = Seats::default();
        assert!(!seats.is_attended(now));
        let first = seats.enter(now);
        let second = seats.enter(now);
        assert!(seats.is_attended(now + ABSENT / 2));
        seats.hear(second, now + ABSENT);
        assert!(!seats.is_attended(now + ABSENT));
        seats.hear(first, now + ABSENT);
        assert!(seats.is_attended(now + ABSENT));
        seats.leave(first);
        assert!(!seats.is_attended(now + ABSENT));
    }
}
