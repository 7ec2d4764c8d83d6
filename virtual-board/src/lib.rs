//! Runs the firmware's release ELF in closed loop, with an emulated microcontroller in place of a board. The plant of a
//! scene moves the encoder's pins. The force output acts on the plant.
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
