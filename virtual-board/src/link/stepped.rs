//! A virtual board for a web page. It runs only when it is called. It has no threads and only one clock.

use std::sync::Arc;

use super::wires::{Slices, Wires};
use crate::{
    session::{Failed, Session},
    world::World,
};

pub struct SteppedBoard {
    world: World<'static>,
    slices: Slices,
    pub wires: Arc<Wires>,
}

impl SteppedBoard {
    /// Switches a board on. The zero was set at the scene's position 0, where a hand has just released the handle. The
    /// memory of the board and of the table of log messages is never freed, since a page has one of each.
    ///
    /// # Errors
    /// The image is not of this firmware, or refuses a command.
    pub fn start(session: Session) -> Result<Self, Failed> {
        let world = Box::leak(Box::new(session)).boot_and_let_go()?;
        let wires = Arc::new(Wires::default());
        Ok(Self { world, slices: Slices::new(Arc::clone(&wires)), wires })
    }

    /// Runs the board for 1 ms. `speed` is the number of simulated seconds per real second. It is only displayed.
    ///
    /// # Errors
    /// The program ended.
    pub fn millisecond(&mut self, speed: f64) -> Result<(), Failed> {
        self.slices.run(&mut self.world)?;
        self.wires.look(&self.world, speed);
        Ok(())
    }
}
