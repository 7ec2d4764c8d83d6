//! Who may command: one page owns the board, the others watch. Control passes by what people do, never by itself.

use std::time::Duration;

/// A page that has not answered for so long is not there: the force goes off.
pub const ABSENT: Duration = Duration::from_secs(1);
/// After this time without an answer the page is gone, and its control with it, even if its socket is still open.
pub const GONE: Duration = Duration::from_secs(2);

#[derive(Debug, Default)]
pub struct Seats {
    /// Pages, and when each last answered.
    pub pages: Vec<(u64, Duration)>,
    last: u64,
    pub owner: Option<u64>,
    /// The page that asks for control.
    pub asking: Option<u64>,
}

impl Seats {
    /// A page has come. It owns the board if nobody does.
    pub fn enter(&mut self, now: Duration) -> u64 {
        self.last += 1;
        self.pages.push((self.last, now));
        if self.owner.is_none() {
            self.own(Some(self.last));
        }
        self.last
    }

    /// A page has gone; whether it was the owner. Then control goes to the page that asked for it, if one has.
    pub fn leave(&mut self, page: u64) -> bool {
        self.pages.retain(|(other, _)| *other != page);
        self.asking = self.asking.filter(|other| *other != page);
        let owned = self.owner == Some(page);
        if owned {
            self.own(self.asking);
        }
        owned
    }

    /// A page would like to command; whether it waits for the owner, who has been asked.
    pub fn ask(&mut self, page: u64) -> bool {
        let waits = self.owner.is_some_and(|owner| owner != page);
        match waits {
            true => self.asking = Some(page),
            false => self.own(Some(page)),
        }
        waits
    }

    /// The owner gives control to the page that asked for it; whether it did.
    pub fn give(&mut self, page: u64) -> bool {
        let gives = self.owns(page) && self.asking.is_some();
        if gives {
            self.own(self.asking);
        }
        gives
    }

    fn own(&mut self, page: Option<u64>) {
        (self.owner, self.asking) = (page, None);
    }

    /// A page has answered.
    pub fn hear(&mut self, page: u64, now: Duration) {
        self.pages.iter_mut().filter(|(other, _)| *other == page).for_each(|seat| seat.1 = now);
    }

    /// For how long the page has been silent; none: there is no such page.
    fn silence(&self, page: u64, now: Duration) -> Option<Duration> {
        let seat = self.pages.iter().find(|(other, _)| *other == page);
        seat.map(|(_, heard)| now.saturating_sub(*heard))
    }

    /// Whether the owner is there: then the board may be told so.
    pub fn is_attended(&self, now: Duration) -> bool {
        let silence = self.owner.and_then(|owner| self.silence(owner, now));
        silence.is_some_and(|silence| silence < ABSENT)
    }

    /// Whether that page is there no longer, though its socket may be open.
    pub fn is_gone(&self, page: u64, now: Duration) -> bool {
        self.silence(page, now).is_none_or(|silence| silence >= GONE)
    }

    /// Whether that page may command.
    pub fn owns(&self, page: u64) -> bool {
        self.owner == Some(page)
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
        assert!(!seats.give(first), "to nobody");
        assert!(seats.ask(second));
        assert!(!seats.give(second), "not its own");
        assert!(!seats.give(third));
        assert!(seats.owns(first));
        assert!(seats.give(first));
        assert!(seats.owns(second) && !seats.owns(first));
        // Who goes leaves it to who has asked, else to nobody.
        assert!(seats.ask(first));
        assert!(seats.leave(second));
        assert!(seats.owns(first));
        assert!(seats.leave(first));
        assert_eq!(seats.owner, None);
        assert!(!seats.ask(third));
        assert!(seats.owns(third));
    }

    #[test]
    fn a_page_that_does_not_answer_is_absent_and_then_gone() {
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
        seats.hear(second, now + GONE);
        assert!(!seats.is_gone(first, now + GONE), "it was heard later");
        assert!(seats.is_gone(first, now + ABSENT + GONE));
        assert!(!seats.is_gone(second, now + ABSENT + GONE));
        seats.leave(first);
        assert!(!seats.is_attended(now + GONE) && seats.is_gone(first, now));
    }
}
