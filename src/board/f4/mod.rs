//! The peripherals of the STM32F4, one file each.

#[allow(dead_code, reason = "a board has one output")]
pub mod dac;
pub mod debugger;
#[cfg(all(feature = "nucleo-f446re", feature = "time-stamps"))]
pub mod edges;
pub mod enable;
pub mod encoder;
mod fatal;
pub mod fault_memory;
pub mod flash;
#[allow(dead_code, reason = "a board has one output")]
pub mod pwm;
pub mod reset;
pub mod sample_timer;
pub mod supply;
pub mod watchdog;

use super::off;
