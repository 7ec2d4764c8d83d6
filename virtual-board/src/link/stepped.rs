//! A virtual board that goes on when it is told to: in a page there are no threads, and no clock but the page's.

use std::sync::Arc;

use super::wires::{Slices, Wires};
use crate::{
    session::{Failed, Session},
    world::World,
};

/// A board with a hand that lets its handle go.
pub struct SteppedBoard {
    world: World<'static>,
    slices: Slices,
    pub wires: Arc<Wires>,
}

impl SteppedBoard {
    /// Switches a board on: a hand has zeroed it at the scene's 0 and has just let it go. Kept for good, as the program's
    /// table of log messages is: one for each page.
    ///
    /// # Errors
    /// The image is none of this firmware, or refuses what it was told.
    pub fn start(session: Session) -> Result<Self, Failed> {
        let world = Box::leak(Box::new(session)).boot_and_let_go()?;
        let wires = Arc::new(Wires::default());
        Ok(Self { world, slices: Slices::new(Arc::clone(&wires)), wires })
    }

    /// A millisecond on the board; `speed` for those who look: seconds there for each second here.
    ///
    /// # Errors
    /// The program ended.
    pub fn millisecond(&mut self, speed: f64) -> Result<(), Failed> {
        self.slices.run(&mut self.world)?;
        self.wires.look(&self.world, speed);
        Ok(())
    }
}
