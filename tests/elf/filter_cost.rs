//! Runs the velocity filter in every number format and form on the board's core. The image has no panic. The velocities
//! equal the host's bit for bit, and the cycles equal the table of `cargo sim trade`. The cycles are the emulator's,
//! with zero wait states. The cycles were not compared with silicon.

use filter_forms::{Filter, Form, Format, Variant};

use crate::mailbox::{Mailbox, assert_cost};

const RATE_HZ: f64 = 1e4;
/// Number of fractional bits of a signal in Q15. Full scale is then 128 counts per sample.
const Q15_FRACTION: u32 = 8;

/// The motions of the test. They are at rest, slow, at the largest speed of Q15, reversing, at the core's limit, and of
/// any size.
fn inputs() -> Vec<i32> {
    const COUNT: i32 = 1 << 16;
    let mut seed = 1u32;
    let mut random = move || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        seed.cast_signed()
    };
    let mut all = vec![0; 50];
    all.extend((0..300).map(|n| if n % 7 == 0 { COUNT } else { 0 }));
    all.extend([100 * COUNT; 200]);
    all.extend((0..200).map(|n| if n / 50 % 2 == 0 { 100 * COUNT } else { -100 * COUNT }));
    all.extend((0..300).map(|_| random() >> 12));
    all.extend((0..300).map(|_| random()));
    all.extend([32_767 * COUNT; 150]);
    all.extend([-32_767 * COUNT; 150]);
    all.extend([0; 300]);
    all
}

/// Columns: `variant,cycles,ram_bytes`.
const TABLE: &str = include_str!("../../host-sim/data/filter_cost.csv");

#[test]
#[ignore = "a program of its own for the target; CI runs it"]
fn on_the_target_every_filter_is_as_on_the_host_and_takes_the_stated_cycles() {
    let mut target = Mailbox::of("filter-cost", &[]);
    let inputs = inputs();
    let mut measured = vec![];
    for (number, &variant) in (0u32..).zip(&Variant::ALL) {
        let (mut most, mut bytes) = (0, 0);
        for cutoff_hz in [20.0f64, 300.0, 1500.0, 4500.0] {
            let bits = cutoff_hz.to_bits();
            let job = [number, bits as u32, (bits >> 32) as u32, Q15_FRACTION, inputs.len() as u32];
            let (velocities, cycles, size) = target.run(&variant.to_string(), &job, &inputs);
            let mut host = Filter::new(variant, cutoff_hz, RATE_HZ, Q15_FRACTION).unwrap();
            for (n, (input, velocity)) in inputs.iter().zip(velocities).enumerate() {
                assert_eq!(
                    velocity,
                    host.update(*input),
                    "{variant} at {cutoff_hz} Hz, sample {n}"
                );
            }
            most = most.max(*cycles.iter().max().unwrap());
            bytes = size;
        }
        println!("{variant},{most},{bytes}");
        measured.push((variant, most, bytes));
    }
    let cycles = |format, form| {
        let wanted = Variant { format, form };
        measured.iter().find(|(variant, ..)| *variant == wanted).unwrap().1
    };
    assert!(cycles(Format::F32, Form::Direct1) < cycles(Format::F64, Form::Direct1) / 5);
    for (variant, cycles, bytes) in &measured {
        let name = variant.to_string();
        let row = assert_cost("filter_cost.csv", TABLE, &name, *cycles);
        assert_eq!(f64::from(*bytes), row[2].parse::<f64>().unwrap(), "{name}: bytes");
    }
}
