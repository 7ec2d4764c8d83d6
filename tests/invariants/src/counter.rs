//! The encoder's counter.

use proptest::prelude::*;
use zwidth::{CounterWidth, encoder::Encoder};

crate::properties! {
    /// A counter of 16 or 32 bits may wrap, and is followed exactly from any reading on. Setting the zero changes
    /// positions, but causes no motion.
    followed(200, (start, narrow, steps) in (
        any::<u32>(),
        any::<bool>(),
        prop::collection::vec((-32_768i64..=32_767, prop::bool::weighted(0.05)), 1..200),
    )) {
        let (width, range) = if narrow { (CounterWidth::Bits16, 1i128 << 16) } else { (CounterWidth::Bits32, 1 << 32) };
        let first = i128::from(start) % range;
        let mut encoder = Encoder::new(first as u32, width);
        let mut position = if first >= range / 2 { first - range } else { first };
        let mut count = first;
        assert_eq!(i128::from(encoder.position().counts()), position);
        for (step, zero) in steps {
            count += i128::from(step);
            position += i128::from(step);
            let read = encoder.track(count.rem_euclid(range) as u32);
            let wrapped = (position + (1 << 31)).rem_euclid(1 << 32) - (1 << 31);
            assert_eq!(i128::from(read.counts()), wrapped);
            if zero {
                encoder.zero();
                position = 0;
                assert_eq!(encoder.position().counts(), 0);
            }
        }
    }
}
