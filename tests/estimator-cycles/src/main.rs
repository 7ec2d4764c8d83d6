//! The velocity estimators on the board's processor: takes samples out of a mailbox in RAM, one at a
//! time, and puts back the velocity and the cycles that it took. `tests/estimator_cycles.rs` is at
//! the other end.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {
    println!("for the board: see tests/estimator_cycles.rs");
}

#[cfg(target_os = "none")]
mod target {
    use core::sync::atomic::{AtomicU32, Ordering::SeqCst};

    use cortex_m::peripheral::{DWT, Peripherals};
    use stm32f4xx_hal as _; // its vector table
    use zwidth::{
        Design, Output,
        units::{Acceleration, Force, Position, Velocity},
        velocity::{Edge, Estimator, EstimatorName, Senses, State},
    };

    /// Word 0: what to do (0 nothing, done), 1: number of the estimator, 2 to 5: its parameters,
    /// 6: position, 7: force, 8: acceleration, 9: age, 10: kind of edge (0 none, 1 down, 2 up),
    /// 11: velocity, 12: cycles, 13 and 14: bytes of coefficients and state.
    #[unsafe(no_mangle)] // SAFETY: no other symbol has this name
    static MAILBOX: [AtomicU32; 16] = [const { AtomicU32::new(0) }; 16];

    /// As `tests/estimator_cycles.rs`.
    const DESIGN: Design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Continuous,
    };

    fn word(n: usize) -> u32 {
        MAILBOX.get(n).map_or(0, |word| word.load(SeqCst))
    }

    fn put(n: usize, value: u32) {
        if let Some(word) = MAILBOX.get(n) {
            word.store(value, SeqCst);
        }
    }

    fn parameter(n: usize) -> f64 {
        f64::from_bits(u64::from(word(n)) | u64::from(word(n + 1)) << 32)
    }

    #[inline(never)] // called, as the interrupt calls what it does
    fn update(
        estimator: &Estimator,
        state: &mut State,
        position: Position,
        s: &Senses,
    ) -> Velocity {
        estimator.update(state, position, s)
    }

    #[cortex_m_rt::entry]
    fn main() -> ! {
        if let Some(mut peripherals) = Peripherals::take() {
            peripherals.DCB.enable_trace();
            peripherals.DWT.enable_cycle_counter();
        }
        let mut estimator = Estimator::Difference;
        let mut state = State::at_rest(Position::default());
        loop {
            match word(0) {
                1 => {
                    let parameters = [parameter(2), parameter(4)];
                    let built = EstimatorName::of_number(word(1))
                        .map(|name| name.settings(parameters).build(&DESIGN));
                    if let Some(Ok(built)) = built {
                        estimator = built;
                        state = State::at_rest(Position::from_counts(word(6).cast_signed()));
                        put(13, size_of_val(&estimator) as u32);
                        put(14, size_of_val(&state) as u32);
                        put(0, 0);
                    } else {
                        put(0, u32::MAX);
                    }
                }
                2 => {
                    let edge = Edge { age: word(9), up: word(10) == 2 };
                    let senses = Senses {
                        force: Force::saturating_from_bits(word(7).cast_signed()),
                        acceleration: Acceleration::saturating_from_bits(word(8).cast_signed()),
                        edge: (word(10) != 0).then_some(edge),
                    };
                    let position = Position::from_counts(word(6).cast_signed());
                    let before = DWT::cycle_count();
                    let velocity = update(&estimator, &mut state, position, &senses);
                    let after = DWT::cycle_count();
                    put(11, velocity.bits().cast_unsigned());
                    put(12, after.wrapping_sub(before));
                    put(0, 0);
                }
                _ => {}
            }
        }
    }

    #[panic_handler]
    fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
        loop {}
    }
}
