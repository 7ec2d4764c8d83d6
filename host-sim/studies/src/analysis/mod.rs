//! The analyses of a scene, except its walks: linear stability and passivity, identification, and comparison of
//! estimators.

pub mod agree;
pub mod compare;
pub mod design;
#[cfg(test)]
mod doors_tests;
pub mod explain;
pub mod identify;
pub mod linear;
pub mod overview;
pub mod passive;
pub mod port;
pub mod recompute;
pub mod rendered;
pub mod replay;
pub mod telemetry;
