//! A critical section that the sampling task does not notice.
//!
//! BASEPRI is raised to [`LEVEL`]. This masks RTIC's priorities 1 to 14. It does not mask priority 15, which only the
//! sampling task has. PRIMASK stays as it is. So no other task can interrupt the section. The sampling task must not
//! use the guarded data: a call from that task traps.

use core::arch::asm;

use cortex_m::peripheral::scb::VectActive;

/// The value of BASEPRI that masks RTIC's priorities 1 to 14. In hardware these are the priorities 0xF0 down to 0x20.
const LEVEL: u8 = 0x20;

/// Runs `section` while all interrupts except the sampling task's are masked.
///
/// The sampling task, a fault handler or the NMI must not call this. [`LEVEL`] does not mask them, so such a caller
/// could have interrupted another section. It ends in an undefined instruction.
#[inline(always)]
pub fn with_lower_tasks_masked<R>(section: impl FnOnce() -> R) -> R {
    let before = raise();
    let result = section();
    restore(before);
    result
}

/// Begins a critical section like [`with_lower_tasks_masked`], for code that cannot use a closure. Pass the result to
/// [`restore`].
#[inline(always)]
pub(in crate::board) fn raise() -> u8 {
    if !caller_is_masked() {
        cortex_m::asm::udf();
    }
    let before = cortex_m::register::basepri::read();
    // SAFETY: raising BASEPRI only ever masks more. No `nomem`: also a compiler barrier.
    unsafe {
        asm!("msr BASEPRI_MAX, {level}", "isb", level = in(reg) u32::from(LEVEL), options(nostack, preserves_flags));
    }
    before
}

/// Ends the critical section that [`raise`] began. `before` is the result of [`raise`].
#[inline(always)]
pub(in crate::board) fn restore(before: u8) {
    // SAFETY: `before` is the value that BASEPRI had before the matching `raise`. The assembly may touch memory, so the
    // compiler moves no guarded access behind it.
    unsafe {
        asm!("msr BASEPRI, {before}", before = in(reg) u32::from(before), options(nostack, preserves_flags));
    }
}

/// Whether [`LEVEL`] masks the running exception: its hardware priority is [`LEVEL`] or a larger number.
fn caller_is_masked() -> bool {
    match cortex_m::peripheral::SCB::vect_active() {
        VectActive::ThreadMode => true,
        VectActive::Exception(_) => false,
        VectActive::Interrupt { irqn } => {
            // SAFETY: reading a priority register has no side effect.
            let nvic = unsafe { &*cortex_m::peripheral::NVIC::PTR };
            nvic.ipr.get(usize::from(irqn)).is_some_and(|priority| priority.read() >= LEVEL)
        }
    }
}
