//! Every estimator, compiled for the board, so that `tests/elf/control_path.rs` can look at the machine
//! code.
#![cfg_attr(target_os = "none", no_std)]

use zwidth::{
    units::Position,
    velocity::{Estimator, Senses, State},
};

/// Every sample.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub extern "C" fn zwidth_estimate(
    estimator: &Estimator,
    state: &mut State,
    position: &Position,
    senses: &Senses,
) -> i32 {
    estimator.update(state, *position, senses).bits()
}

#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
