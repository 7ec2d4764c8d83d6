//! The target's side of the mailbox of `tests/elf/mailbox.rs`: a job and samples in memory, results in their place.
//!
//! `JOB`: state (1: do it, 2: done, 3: refused), what the job needs, number of samples; the word behind that is given
//! back: bytes of what was measured.

use core::{
    panic::PanicInfo,
    sync::atomic::{AtomicU32, Ordering::Relaxed},
};

pub const SAMPLES: usize = 4096;

#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
static JOB: [AtomicU32; 20] = [const { AtomicU32::new(0) }; 20];
/// What goes in; velocities come out.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub static SAMPLE: [AtomicU32; SAMPLES] = [const { AtomicU32::new(0) }; SAMPLES];
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub static CYCLES: [AtomicU32; SAMPLES] = [const { AtomicU32::new(0) }; SAMPLES];

/// No interrupt is used; the firmware's crates, which cargo builds along, insist on vectors.
#[unsafe(link_section = ".vector_table.interrupts")] // SAFETY: this is what belongs there
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
static __INTERRUPTS: [u32; 1] = [0];

#[cortex_m_rt::entry]
fn main() -> ! {
    if let Some(mut core) = cortex_m::Peripherals::take() {
        core.DCB.enable_trace();
        core.DWT.enable_cycle_counter();
    }
    loop {
        if word(0) == 1 {
            JOB[0].store(if crate::run() { 2 } else { 3 }, Relaxed);
        }
    }
}

/// A word of the job.
pub fn word(at: usize) -> u32 {
    JOB.get(at).map_or(0, |word| word.load(Relaxed))
}

/// Two words of the job, low first.
pub fn number(at: usize) -> f64 {
    f64::from_bits(u64::from(word(at + 1)) << 32 | u64::from(word(at)))
}

/// Gives a number of bytes back.
pub fn answer(at: usize, bytes: usize) {
    if let Some(word) = JOB.get(at) {
        word.store(u32::try_from(bytes).unwrap_or(u32::MAX), Relaxed);
    }
}

/// One velocity in the place of its sample, with the cycles that it took. A macro, because what a closure captures is
/// loaded within the count.
macro_rules! measure {
    ($sample:ident, $cycles:ident, $velocity:expr) => {
        let before = DWT::cycle_count();
        let empty = DWT::cycle_count().wrapping_sub(before);
        let start = DWT::cycle_count();
        let velocity = core::hint::black_box($velocity);
        let end = DWT::cycle_count();
        $sample.store(velocity.cast_unsigned(), Relaxed);
        $cycles.store(end.wrapping_sub(start).wrapping_sub(empty), Relaxed);
    };
}
pub(crate) use measure;

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
