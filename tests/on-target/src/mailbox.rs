//! The target's side of the mailbox of `tests/elf/mailbox.rs`. Job and samples are in memory. The results replace the
//! samples.
//!
//! `JOB` has a state, the words of the job, and the number of samples. The state is 1 for requested, 2 for done and 3
//! for refused. The program writes the measured size in bytes into the next word.

use core::{
    panic::PanicInfo,
    sync::atomic::{AtomicU32, Ordering::Relaxed},
};

pub const SAMPLES: usize = 4096;

#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
static JOB: [AtomicU32; 20] = [const { AtomicU32::new(0) }; 20];
/// The inputs. The program replaces each of them by its velocity.
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub static SAMPLE: [AtomicU32; SAMPLES] = [const { AtomicU32::new(0) }; SAMPLES];
#[unsafe(no_mangle)] // SAFETY: no other symbol has this name
pub static CYCLES: [AtomicU32; SAMPLES] = [const { AtomicU32::new(0) }; SAMPLES];

/// No interrupt is used. But cargo also builds the firmware's crates, which require vectors.
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

pub fn word(at: usize) -> u32 {
    JOB.get(at).map_or(0, |word| word.load(Relaxed))
}

/// A number in two words of the job, low word first.
pub fn number(at: usize) -> f64 {
    f64::from_bits(u64::from(word(at + 1)) << 32 | u64::from(word(at)))
}

/// Writes a size in bytes into the job.
pub fn answer(at: usize, bytes: usize) {
    if let Some(word) = JOB.get(at) {
        word.store(u32::try_from(bytes).unwrap_or(u32::MAX), Relaxed);
    }
}

/// Replaces a sample by its velocity and notes the cycles. The code is a macro, because a closure would load its
/// captured values while the cycles are counted.
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
