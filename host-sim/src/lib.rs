//! host-sim

pub mod exact;
