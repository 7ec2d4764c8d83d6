//! On the board's core: builds an estimator, gives it differences, hands back the velocities and the
//! cycles of each update. The other side of the mailbox is a test.
//!
//! `SENSES`: force, acceleration, age of the edge, kind of edge (0 none, 1 down, 2 up) of each sample.
//! `JOB`: state (1: do it, 2: done, 3: settings refused), number of the estimator, its two parameters
//! (each two words, low first), samples, bytes of an [`Estimator`].
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
    use zwidth::{
        Design, Output,
        units::{Acceleration, Force, Position},
        velocity::{Edge, EstimatorName, Senses, State},
    };

    const SAMPLES: usize = 4096;
    const ZERO: AtomicU32 = AtomicU32::new(0);

    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static JOB: [AtomicU32; 8] = [ZERO; 8];
    /// Differences in, velocities out.
    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static SAMPLE: [AtomicU32; SAMPLES] = [ZERO; SAMPLES];
    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static CYCLES: [AtomicU32; SAMPLES] = [ZERO; SAMPLES];
    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static SENSES: [[AtomicU32; 4]; SAMPLES] = [const { [ZERO; 4] }; SAMPLES];

    const DESIGN: Design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Continuous,
    };

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

    fn number(at: usize) -> f64 {
        let [low, high] = [at, at + 1].map(|n| u64::from(JOB[n].load(Relaxed)));
        f64::from_bits(high << 32 | low)
    }

    fn senses([force, acceleration, age, kind]: &[AtomicU32; 4]) -> Senses {
        let kind = kind.load(Relaxed);
        let edge = Edge { age: age.load(Relaxed), up: kind == 2 };
        Senses {
            force: Force::saturating_from_bits(force.load(Relaxed).cast_signed()),
            acceleration: Acceleration::saturating_from_bits(
                acceleration.load(Relaxed).cast_signed(),
            ),
            edge: (kind != 0).then_some(edge),
        }
    }

    fn run() -> bool {
        let Some(name) = EstimatorName::of_number(JOB[1].load(Relaxed)) else { return false };
        let Ok(estimator) = name.settings([number(2), number(4)]).build(&DESIGN) else {
            return false;
        };
        let estimator = black_box(estimator);
        let mut state = black_box(State::at_rest(Position::default()));
        let mut count = 0i32;
        let count_of_samples = JOB[6].load(Relaxed) as usize;
        for ((sample, cycles), sensed) in
            SAMPLE.iter().zip(&CYCLES).zip(&SENSES).take(count_of_samples)
        {
            count = count.wrapping_add(sample.load(Relaxed).cast_signed());
            let position = Position::from_counts(count);
            let senses = black_box(senses(sensed));
            let before = DWT::cycle_count();
            let empty = DWT::cycle_count().wrapping_sub(before);
            let start = DWT::cycle_count();
            let velocity = estimator.update(&mut state, black_box(position), &senses);
            let velocity = black_box(velocity);
            let end = DWT::cycle_count();
            sample.store(velocity.bits().cast_unsigned(), Relaxed);
            cycles.store(end.wrapping_sub(start).wrapping_sub(empty), Relaxed);
        }
        JOB[7].store(size_of_val(&estimator) as u32, Relaxed);
        true
    }

    #[panic_handler]
    fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
        loop {}
    }
}
