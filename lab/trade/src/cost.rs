//! The cost of one filter update. The cycles on the board's core are from a stored table. The nanoseconds on this
//! machine are measured.

use std::time::Instant;

use filter_forms::{Filter, Step, Variant, Visit};

use crate::analysis::compare::Cost;

/// Cost of one update of `variant`. It includes the conversion from and to velocity bits. The cycles are from a stored
/// table, and a test compares this table with a measurement.
pub fn of(variant: Variant) -> Option<Cost> {
    Cost::find(include_str!("../../../host-sim/data/filter_cost.csv"), &variant.to_string())
}

const SAMPLES: u32 = 50_000;
const RUNS: u32 = 5;

/// Time of one update on this machine, in ns: the minimum of several runs. This time differs from call to call.
pub fn host_ns(filter: &Filter) -> f64 {
    struct Time;
    impl Visit for Time {
        type Output = f64;

        fn visit<F: Step>(self, form: &mut F, fraction: u32) -> f64 {
            let start = Instant::now();
            let mut input = 0i32;
            for n in 0..SAMPLES {
                // The input is in the range of a hand's speed. The input depends on the last output, so that the
                // compiler cannot remove an update.
                input = (input >> 8) + if n % 3 == 0 { 1 << 20 } else { 0 };
                input = form.velocity(input, fraction);
            }
            std::hint::black_box(input);
            start.elapsed().as_secs_f64() / f64::from(SAMPLES) * 1e9
        }
    }
    (0..RUNS).map(|_| ({ *filter }).visit(Time)).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_variant_has_a_cost() {
        for variant in Variant::ALL {
            let cost = of(variant).unwrap_or_else(|| panic!("{variant} is not in the table"));
            assert!(cost.cycles > 10.0 && cost.ram_bytes >= 12.0, "{variant}: {cost:?}");
        }
    }
}
