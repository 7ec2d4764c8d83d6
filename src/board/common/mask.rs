//! A critical section that the sampling task does not notice.
//!
//! BASEPRI is raised to [`LEVEL`]. This masks priorities 1 to 14, but not 15, the sampling task. PRIMASK stays as it
//! is. So the section excludes every task except the sampling task. That task must not use the guarded data: a call
//! from there traps.

use core::arch::asm;

use cortex_m::peripheral::scb::VectActive;

/// BASEPRI that masks the RTIC priorities 1..=14 (hardware 0xF0 down to 0x20).
const LEVEL: u8 = 0x20;

/// Runs `section` while all interrupts except the sampling task's are masked.
///
/// A wrong caller (the sampling task, a fault handler, NMI) ends in an undefined instruction. [`LEVEL`] does not mask
/// such a caller, so it could have interrupted another section.
#[inline(always)]
pub fn with_lower_tasks_masked<R>(section: impl FnOnce() -> R) -> R {
    let before = raise();
    let result = section();
    restore(before);
    result
}

/// First half of [`with_lower_tasks_masked`], for code without a closure. Returns the argument of [`restore`].
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

/// Second half: undoes [`raise`].
#[inline(always)]
pub(in crate::board) fn restore(before: u8) {
    // SAFETY: `before` is what BASEPRI was before the matching `raise`; accesses that it guarded
    // stay before this, because the assembly may touch memory.
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
