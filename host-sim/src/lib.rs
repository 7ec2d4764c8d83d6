//! host-sim

pub mod exact;
pub mod linear;
