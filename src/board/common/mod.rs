//! Code for a board with any Cortex-M4: log, probe link, critical section, device record and image in flash.

pub(in crate::board) mod control_block;
pub mod device_record;
pub mod image;
pub mod logger;
pub mod mask;
pub mod rtt;
