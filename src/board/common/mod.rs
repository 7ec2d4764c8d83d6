//! What boards of every family with a Cortex-M4 share: the log and the probe link.

#[cfg(not(feature = "usual-logger"))]
pub mod logger;
#[cfg(not(feature = "usual-logger"))]
pub mod mask;
pub mod rtt;
