//! Runs on the board's core: builds an estimator, gives it differences of counts, and returns the velocities and the
//! cycles of each update. `tests/elf/estimator_cost.rs` is the host's side of the mailbox.
//!
//! For each sample, `SENSES` has the force, the acceleration, the age of the edge, and the kind of the edge. The kind
//! is 0 for no edge, 1 for down and 2 for up. The job has the number of the estimator, its parameters (two words each,
//! low word first), and the number of samples. The answer is the size of an [`Estimator`](zwidth::velocity::Estimator),
//! in bytes.
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

    use crate::mailbox::{CYCLES, SAMPLE, SAMPLES, answer, measure, number, word};

    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static SENSES: [[AtomicU32; 4]; SAMPLES] =
        [const { [const { AtomicU32::new(0) }; 4] }; SAMPLES];

    const DESIGN: Design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Continuous,
    };

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

    pub fn run() -> bool {
        let Some(name) = EstimatorName::from_id(word(1)) else { return false };
        let numbers = [2, 4, 6, 8, 10, 12, 14, 16].map(number);
        let Ok(estimator) = name.settings(numbers).build(&DESIGN) else { return false };
        let estimator = black_box(estimator);
        let mut state = black_box(State::at_rest(Position::default()));
        let mut count = 0i32;
        let samples = SAMPLE.iter().zip(&CYCLES).zip(&SENSES);
        for ((sample, cycles), sensed) in samples.take(word(18) as usize) {
            count = count.wrapping_add(sample.load(Relaxed).cast_signed());
            let position = Position::from_counts(count);
            let senses = black_box(senses(sensed));
            measure!(
                sample,
                cycles,
                estimator.update(&mut state, black_box(position), &senses).bits()
            );
        }
        answer(19, size_of_val(&estimator));
        true
    }
}
