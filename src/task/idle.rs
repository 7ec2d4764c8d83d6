//! `idle`: what is left of the time.

use core::sync::atomic::Ordering::Relaxed;

use super::FLAGS;
use zwidth::contract::Watchdog as _;

use crate::board::{self, Watchdog};

/// The idle task. It alone feeds the watchdog, but while `link` writes flash or tests the board, with the force off.
pub struct Idle {
    watchdog: Watchdog,
    /// `rendered` and `links` when the watchdog was last fed.
    fed: [u32; 2],
}

impl Idle {
    pub(super) fn new(watchdog: Watchdog) -> Self {
        Self { watchdog, fed: [0; 2] }
    }

    /// Sleeps until the next interrupt. Feeds only if `render` (hence `sample`) and `link` have
    /// both run since the last time.
    pub fn run(&mut self) {
        let now = [FLAGS.rendered.load(Relaxed), FLAGS.links.load(Relaxed)];
        if now[0] != self.fed[0] && now[1] != self.fed[1] {
            self.watchdog.feed();
            self.fed = now;
        }
        board::sleep();
    }
}
