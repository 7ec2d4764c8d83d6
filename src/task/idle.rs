//! `idle`: the task that runs when no other task does.

use core::sync::atomic::Ordering::Relaxed;

use super::FLAGS;
use zwidth::{
    contract::Watchdog as _,
    image::{Pass, RIGHT},
    safety::Fault,
};

use crate::board::{self, Watchdog};

/// The task `idle`. Only this task feeds the watchdog, except while `link` writes flash or tests the board, with the
/// force off. It also checks the image in flash.
pub struct Idle {
    watchdog: Watchdog,
    /// The flags `rendered` and `links` when the watchdog was last fed. Both must have changed before it is fed again.
    fed: [u32; 2],
    pass: Pass<'static>,
    checked: u32,
}

impl Idle {
    pub(super) fn new(watchdog: Watchdog, pass: Pass<'static>) -> Self {
        Self { watchdog, fed: [0; 2], pass, checked: 0 }
    }

    /// Checks a slice of the image, then sleeps until the next interrupt. Feeds the watchdog only if `render` and
    /// `link` have both run since the last time. `render` runs only after `sample`.
    pub fn run(&mut self) {
        let now = [FLAGS.rendered.load(Relaxed), FLAGS.links.load(Relaxed)];
        if now[0] != self.fed[0] && now[1] != self.fed[1] {
            self.watchdog.feed();
            self.fed = now;
        }
        if let Some(found) = self.pass.go_on() {
            // The task `link` accepts this sum only if each pass adds the right checksum.
            self.checked = self.checked.wrapping_add(found);
            FLAGS.checked.store(self.checked, Relaxed);
            if found != RIGHT {
                board::end(Fault::Image);
            }
        }
        board::sleep();
    }
}
