//! The ends of the program: a panic, a hard fault, a failed clock, an interrupt without a task, a changed image. Each
//! one switches off, notes the fault, and waits for the watchdog.

use core::panic::PanicInfo;

use cortex_m_rt::{ExceptionFrame, exception};
use zwidth::safety::Fault;

/// Switches off at once. The watchdog resets the chip 34 to 94 ms later. Nothing is logged, because the logger itself
/// may have panicked.
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    end(Fault::Panic)
}

// SAFETY: the handler touches the outputs and the fault memory only, with whole stores.
#[exception]
unsafe fn HardFault(_: &ExceptionFrame) -> ! {
    end(Fault::HardFault)
}

/// The clock security system has found that the HSE stopped. Without this handler the timers would stop, with enable
/// active and the last force on. The system also drives TIM1's break input (reference manuals).
// SAFETY: as HardFault.
#[exception]
unsafe fn NonMaskableInt() -> ! {
    end(Fault::ClockFailure)
}

/// Handles each exception that has no task. It can only come if a bit has flipped in the NVIC or in the address of the
/// vector table.
// SAFETY: as HardFault.
#[exception]
unsafe fn DefaultHandler(_: i16) -> ! {
    end(Fault::Interrupt)
}

/// See [`end`](zwidth::contract::Board::end).
pub fn end(fault: Fault) -> ! {
    cortex_m::interrupt::disable();
    super::off();
    super::fault_memory::note(fault);
    loop {
        super::off();
    }
}
