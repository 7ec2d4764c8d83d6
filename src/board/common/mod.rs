//! Code for all boards with a Cortex-M4: the log and the probe link.

pub(in crate::board) mod control_block;
pub mod device_record;
pub mod image;
pub mod logger;
pub mod mask;
pub mod rtt;
