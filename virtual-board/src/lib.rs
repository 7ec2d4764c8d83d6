//! The firmware's release ELF in closed loop without a board. An emulated microcontroller runs the ELF. A scene's plant
//! moves its encoder pins, and its force output acts on the plant.
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
