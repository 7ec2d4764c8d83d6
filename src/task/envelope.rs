//! The walls that are predicted to be stable on this board: `scenes/BOARD.envelope.csv`, which a sweep
//! wrote, as the build script took it in.

use zwidth::envelope::{Boundary, Envelope, Key, Point};

include!(concat!(env!("OUT_DIR"), "/envelope.rs"));
