//! The ends: a panic and a hard fault. Both switch off and wait for the watchdog's reset.

use core::panic::PanicInfo;

use cortex_m_rt::{ExceptionFrame, exception};

/// Off at once; then the watchdog resets the chip, within its 34 to 94 ms.
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    super::off();
    loop {
        super::off();
    }
}

// SAFETY: the handler touches nothing but the outputs.
#[exception]
unsafe fn HardFault(_: &ExceptionFrame) -> ! {
    super::off();
    loop {
        super::off();
    }
}
