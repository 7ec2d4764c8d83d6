//! Code that any board with a Cortex-M4 can use: the log, the link to the probe, the critical section, and access to
//! device record and image in flash.

pub(in crate::board) mod control_block;
pub mod device_record;
pub mod image;
pub mod logger;
pub mod mask;
pub mod rtt;
