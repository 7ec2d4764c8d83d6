//! Control of the board: one page owns the board, and the others watch. Control changes only by a person's action or
//! when a page leaves.

use std::time::Duration;

/// A page without an answer for so long counts as absent: the force goes off.
pub const ABSENT: Duration = Duration::from_secs(1);
/// A page without an answer for so long counts as gone and loses control, even if its socket is still open.
pub const GONE: Duration = Duration::from_secs(2);

#[derive(Debug, Default)]
pub struct Seats {
    /// Pages, and the time of each page's last answer.
    pub pages: Vec<(u64, Duration)>,
    last: u64,
    pub owner: Option<u64>,
    /// The page that has asked for control.
    pub asking: Option<u64>,
}

impl Seats {
    /// Adds a page. It owns the board if no other page does.
    pub fn enter(&mut self, now: Duration) -> u64 {
        self.last += 1;
        self.pages.push((self.last, now));
        if self.owner.is_none() {
            self.own(Some(self.last));
        }
        self.last
    }

    /// Removes a page. Returns whether it was the owner. If it was, the page that asked for control becomes
    /// the owner. If no page asked, there is no owner.
    pub fn leave(&mut self, page: u64) -> bool {
        self.pages.retain(|(other, _)| *other != page);
        self.asking = self.asking.filter(|other| *other != page);
        let owned = self.owner == Some(page);
        if owned {
            self.own(self.asking);
        }
        owned
    }

    /// Notes that a page asks for control. Returns whether it has to wait for the owner.
    pub fn ask(&mut self, page: u64) -> bool {
        let waits = self.owner.is_some_and(|owner| owner != page);
        match waits {
            true => self.asking = Some(page),
            false => self.own(Some(page)),
        }
        waits
    }

    /// Gives control from the owner to the page that has asked for it. Returns whether it changed.
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

    /// Notes an answer of a page.
    pub fn hear(&mut self, page: u64, now: Duration) {
        self.pages.iter_mut().filter(|(other, _)| *other == page).for_each(|seat| seat.1 = now);
    }

    /// Time of the page's last answer; none: there is no such page.
    fn heard(&self, page: u64) -> Option<Duration> {
        self.pages.iter().find(|(other, _)| *other == page).map(|(_, heard)| *heard)
    }

    /// Time until which the owner counts as there, so that the board may get `alive`; 0 without an owner.
    pub fn attended_until(&self) -> Duration {
        self.owner
            .and_then(|owner| self.heard(owner))
            .map_or(Duration::ZERO, |heard| heard + ABSENT)
    }

    /// Whether the page is gone, even if its socket is open.
    pub fn is_gone(&self, page: u64, now: Duration) -> bool {
        self.heard(page).is_none_or(|heard| now.saturating_sub(heard) >= GONE)
    }

    /// Whether the page owns the board.
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
        // A page that leaves passes control to the page that has asked for it. Otherwise no page owns the board.
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
        assert_eq!(seats.attended_until(), Duration::ZERO);
        let first = seats.enter(now);
        let second = seats.enter(now);
        seats.hear(second, now + ABSENT);
        assert_eq!(seats.attended_until(), now + ABSENT, "the owner was not heard again");
        seats.hear(first, now + ABSENT);
        assert_eq!(seats.attended_until(), now + 2 * ABSENT);
        seats.hear(second, now + GONE);
        assert!(!seats.is_gone(first, now + GONE), "it was heard later");
        assert!(seats.is_gone(first, now + ABSENT + GONE));
        assert!(!seats.is_gone(second, now + ABSENT + GONE));
        seats.leave(first);
        assert!(seats.attended_until().is_zero() && seats.is_gone(first, now));
    }
}
