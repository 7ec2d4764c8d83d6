//! The firmware's release ELF in closed loop without a board: an emulated microcontroller whose
//! encoder pins follow the plant of a scene and whose force output drives it.
#![forbid(unsafe_code)]

pub mod amplifier;
pub mod board;
pub mod core_program;
pub mod device;
pub mod elf;
pub mod image;
pub mod link;
pub mod log;
pub mod mcu;
pub mod rtt;
pub mod session;
mod wiring;
pub mod world;
