//! Interrupts without a task. None is expected. If one comes, it must not keep a task waiting.

use cortex_m::peripheral::scb::SystemHandler;
use stm32f4xx_hal::pac::Interrupt;

/// Interrupts that src/main.rs binds to tasks. src/main.rs also sets the priorities of these interrupts.
const TASKS: [Interrupt; 4] = [Interrupt::TIM5, Interrupt::SPI3, Interrupt::PVD, Interrupt::SPI2];

/// The lowest of the 16 priorities.
const LOWEST: u8 = 0xF0;

/// Number of interrupts of the chip with the most interrupts.
const COUNT: usize = 97;

/// Gives all other interrupts and the system handlers the lowest priority, below the fault handlers. The handler of all
/// these interrupts is `DefaultHandler` (fatal.rs).
pub fn set_up(core: &mut cortex_m::Peripherals) {
    for number in 0..COUNT {
        let bound = TASKS.iter().any(|task| *task as usize == number);
        if !bound {
            // SAFETY: these interrupts are not enabled. Their new priority is below the priority of every task except
            // `link`.
            unsafe { core.NVIC.ipr[number].write(LOWEST) };
        }
    }
    use SystemHandler::{DebugMonitor, PendSV, SVCall, SysTick};
    for handler in [SVCall, DebugMonitor, PendSV, SysTick] {
        // SAFETY: nothing raises these exceptions. Their new priority is below the priority of every task except
        // `link`.
        unsafe { core.SCB.set_priority(handler, LOWEST) };
    }
}
