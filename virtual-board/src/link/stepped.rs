//! A virtual board that runs only when it is called. A web page has no threads, and only the page's clock.

use std::sync::Arc;

use super::wires::{Slices, Wires};
use crate::{
    session::{Failed, Session},
    world::World,
};

/// A board whose hand has released the handle.
pub struct SteppedBoard {
    world: World<'static>,
    slices: Slices,
    pub wires: Arc<Wires>,
}

impl SteppedBoard {
    /// Switches a board on. A hand has set the zero at the scene's 0 and has just released the handle. The board is
    /// never freed, like the program's table of log messages: a page has one of each.
    ///
    /// # Errors
    /// The image is not of this firmware, or refuses a command.
    pub fn start(session: Session) -> Result<Self, Failed> {
        let world = Box::leak(Box::new(session)).boot_and_let_go()?;
        let wires = Arc::new(Wires::default());
        Ok(Self { world, slices: Slices::new(Arc::clone(&wires)), wires })
    }

    /// Runs the board for a millisecond. `speed` is simulated seconds per real second; it is only displayed.
    ///
    /// # Errors
    /// The program ended.
    pub fn millisecond(&mut self, speed: f64) -> Result<(), Failed> {
        self.slices.run(&mut self.world)?;
        self.wires.look(&self.world, speed);
        Ok(())
    }
}
