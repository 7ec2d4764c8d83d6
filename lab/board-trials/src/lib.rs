//! Tests of the firmware's release image on the virtual board: faults with the force on (`cargo board campaign`), and
//! random sessions (`cargo board fuzz`).
#![forbid(unsafe_code)]

pub mod campaign;
pub mod fuzz;
mod random;
mod threads;
