//! On the board's core: makes a filter, gives it velocities, hands back the velocities and the cycles of each update.
//! The other side of the mailbox is a test.
//!
//! `JOB`: state (1: do it, 2: done, 3: the format cannot have the cutoff), number of the variant, cutoff in Hz (two words,
//! low first), fractional bits of Q15, samples, bytes of coefficients and state.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This runs on the board's core, in a test.");
}

#[cfg(target_os = "none")]
mod target {
    use core::{
        hint::black_box,
        sync::atomic::{AtomicU32, Ordering::Relaxed},
    };

    use cortex_m::peripheral::DWT;
    use filter_forms::{Filter, Step, Variant, Visit};

    const SAMPLES: usize = 2048;
    const RATE_HZ: f64 = 1e4;
    const ZERO: AtomicU32 = AtomicU32::new(0);

    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static JOB: [AtomicU32; 8] = [ZERO; 8];
    /// Velocities in, velocities out.
    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static SAMPLE: [AtomicU32; SAMPLES] = [ZERO; SAMPLES];
    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static CYCLES: [AtomicU32; SAMPLES] = [ZERO; SAMPLES];

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
            if JOB[0].load(Relaxed) == 1 {
                JOB[0].store(if run() { 2 } else { 3 }, Relaxed);
            }
        }
    }

    /// Counts the cycles of a form whose state lies in memory, as between two interrupts.
    struct Count {
        samples: usize,
    }

    impl Visit for Count {
        type Output = ();

        #[inline(never)]
        fn visit<F: Step>(self, form: &mut F, fraction: u32) {
            JOB[6].store(size_of::<F>() as u32, Relaxed);
            for (sample, cycles) in SAMPLE.iter().zip(&CYCLES).take(self.samples) {
                let input = black_box(sample.load(Relaxed).cast_signed());
                let form = black_box(&mut *form);
                let before = DWT::cycle_count();
                let empty = DWT::cycle_count().wrapping_sub(before);
                let start = DWT::cycle_count();
                let velocity = black_box(form.velocity(black_box(input), fraction));
                let end = DWT::cycle_count();
                sample.store(velocity.cast_unsigned(), Relaxed);
                cycles.store(end.wrapping_sub(start).wrapping_sub(empty), Relaxed);
            }
        }
    }

    fn run() -> bool {
        let word = |n: usize| JOB[n].load(Relaxed);
        let cutoff_hz = f64::from_bits(u64::from(word(3)) << 32 | u64::from(word(2)));
        let Some(variant) = Variant::of_number(word(1)) else { return false };
        let Ok(mut filter) = Filter::new(variant, cutoff_hz, RATE_HZ, word(4).min(15)) else {
            return false;
        };
        filter.visit(Count { samples: word(5) as usize });
        true
    }

    #[panic_handler]
    fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
        loop {}
    }
}
