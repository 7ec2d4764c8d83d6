//! Runs on the board's core: builds a filter, gives it velocities, and returns the velocities and the cycles of each
//! update. `tests/elf/filter_cost.rs` is the host's side of the mailbox.
//!
//! The job has the number of the variant, the cutoff in Hz (two words, low word first), the fractional bits of Q15, and
//! the number of samples. The answer is the size of coefficients and state, in bytes. The job is refused if the format
//! cannot have the cutoff.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod mailbox;
#[cfg(target_os = "none")]
use target::run;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This runs on the board's core, in a test.");
}

#[cfg(target_os = "none")]
mod target {
    use core::{hint::black_box, sync::atomic::Ordering::Relaxed};

    use cortex_m::peripheral::DWT;
    use filter_forms::{Filter, Step, Variant, Visit};

    use crate::mailbox::{CYCLES, SAMPLE, answer, measure, number, word};

    const RATE_HZ: f64 = 1e4;

    /// Counts the cycles of a form whose state is in memory, as between two interrupts.
    struct Count {
        samples: usize,
    }

    impl Visit for Count {
        type Output = ();

        #[inline(never)]
        fn visit<F: Step>(self, form: &mut F, fraction: u32) {
            answer(6, size_of::<F>());
            for (sample, cycles) in SAMPLE.iter().zip(&CYCLES).take(self.samples) {
                let input = black_box(sample.load(Relaxed).cast_signed());
                let form = black_box(&mut *form);
                measure!(sample, cycles, form.velocity(black_box(input), fraction));
            }
        }
    }

    pub fn run() -> bool {
        let Some(variant) = Variant::of_number(word(1)) else { return false };
        let Ok(mut filter) = Filter::new(variant, number(2), RATE_HZ, word(4).min(15)) else {
            return false;
        };
        filter.visit(Count { samples: word(5) as usize });
        true
    }
}
