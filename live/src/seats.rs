//! Which page controls the board: one page is the owner, and the others watch. The owner changes only if a person acts,
//! or when the owner's page is closed or falls silent. A page is silent if its script does not answer. After a silent
//! owner control waits for a person: a page that comes back does not take it by itself.

use std::time::Duration;

/// Time without an answer from the script of the owner's page after which the force is switched off.
pub const ABSENT: Duration = Duration::from_secs(1);
/// Time without an answer after which a page is treated as closed and loses control, even if its socket is still open.
pub const GONE: Duration = Duration::from_secs(2);

#[derive(Debug, Default)]
pub struct Seats {
    /// The number of each open page, and the time of its last answer.
    pub pages: Vec<(u64, Duration)>,
    last: u64,
    pub owner: Option<u64>,
    /// The page that has asked for control.
    pub asking: Option<u64>,
    /// Whether the last owner fell silent, and nobody has taken control since.
    lost: bool,
}

impl Seats {
    /// Adds a page. The page becomes the owner if there is no owner, unless the last owner fell silent.
    pub fn enter(&mut self, now: Duration) -> u64 {
        self.last += 1;
        self.pages.push((self.last, now));
        if self.owner.is_none() && !self.lost {
            self.own(Some(self.last));
        }
        self.last
    }

    /// Removes a page. If the owner is removed, the page that has asked for control becomes the owner, and whether the
    /// owner fell silent is returned. If no page has asked, there is no owner.
    pub fn leave(&mut self, page: u64, now: Duration) -> Option<bool> {
        let silent = self.is_gone(page, now);
        self.pages.retain(|(other, _)| *other != page);
        self.asking = self.asking.filter(|other| *other != page);
        self.owns(page).then(|| {
            self.own(self.asking);
            self.lost = silent && self.owner.is_none();
            silent
        })
    }

    /// Notes that a page asks for control. Returns whether the page must wait for the owner.
    pub fn ask(&mut self, page: u64) -> bool {
        let waits = self.owner.is_some_and(|owner| owner != page);
        match waits {
            true => self.asking = Some(page),
            false => self.own(Some(page)),
        }
        waits
    }

    /// Passes control from the owner to the page that has asked for control. Returns whether the owner has changed.
    pub fn give(&mut self, page: u64) -> bool {
        let gives = self.owns(page) && self.asking.is_some();
        if gives {
            self.own(self.asking);
        }
        gives
    }

    fn own(&mut self, page: Option<u64>) {
        (self.owner, self.asking, self.lost) = (page, None, false);
    }

    pub fn hear(&mut self, page: u64, now: Duration) {
        self.pages.iter_mut().filter(|(other, _)| *other == page).for_each(|seat| seat.1 = now);
    }

    /// Time of the page's last answer. `None` if there is no such page.
    fn heard(&self, page: u64) -> Option<Duration> {
        self.pages.iter().find(|(other, _)| *other == page).map(|(_, heard)| *heard)
    }

    /// The owner is treated as present until this time, so the board may get `alive` until then. It is 0 without an
    /// owner.
    pub fn attended_until(&self) -> Duration {
        self.owner
            .and_then(|owner| self.heard(owner))
            .map_or(Duration::ZERO, |heard| heard + ABSENT)
    }

    /// Whether the page is treated as closed, even if its socket is open.
    pub fn is_gone(&self, page: u64, now: Duration) -> bool {
        self.heard(page).is_none_or(|heard| now.saturating_sub(heard) >= GONE)
    }

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
        // The control of the closed page passes to the page that has asked for it. If no page has asked, there is no
        // owner.
        assert!(seats.ask(first));
        assert_eq!(seats.leave(second, now), Some(false));
        assert!(seats.owns(first));
        assert_eq!(seats.leave(first, now), Some(false));
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
        assert_eq!(seats.leave(first, now + ABSENT + GONE), Some(true));
        assert!(seats.attended_until().is_zero() && seats.is_gone(first, now));
        let back = seats.enter(now);
        assert_eq!(seats.owner, None, "what was lost by silence is taken by an act");
        assert!(!seats.ask(back) && seats.owns(back));
        assert_eq!(seats.leave(back, now), Some(false));
        let next = seats.enter(now);
        assert!(seats.owns(next), "the owner was closed");
    }
}
