//! Properties of the records before a fault, and of the fault's record in backup RAM.

use proptest::prelude::*;
use zwidth::{
    safety::{BlackBox, Fault, FaultRecord, FaultSet},
    telemetry::Record,
};

use crate::any::noticed;

crate::properties! {
    /// The black box has the newest records, one of every `every` outputs. The oldest is the first, and the record with
    /// the fault is the last. Then the black box takes no record until it is released. After the release it is empty.
    newest(500, (every, events) in (
        1u32..6,
        prop::collection::vec(prop_oneof![40 => Just(0u8), 2 => Just(1), 1 => Just(2)], 1..120),
    )) {
        const N: usize = 7;
        let mut ring = BlackBox::<N>::new(every);
        let (mut kept, mut frozen, mut since) = (Vec::new(), false, 0);
        for (sample, event) in (0u64..).zip(events) {
            match event {
                2 => {
                    ring.release();
                    (kept, frozen, since) = (Vec::new(), false, 0);
                }
                fault => {
                    let fault = fault == 1;
                    ring.push(Record { sample, ..Record::EMPTY }, fault);
                    if !frozen {
                        since += 1;
                        if fault || since == every {
                            kept.push(sample);
                            since = 0;
                        }
                        frozen = fault;
                    }
                }
            }
            let newest = &kept[kept.len().saturating_sub(N)..];
            let held: Vec<u64> = (0..ring.len()).map(|n| ring.get(n).unwrap().sample).collect();
            assert_eq!(held, newest);
            assert_eq!((ring.is_frozen(), ring.is_empty(), ring.get(N)), (frozen, newest.is_empty(), None));
        }
    }

    /// A fault's record in backup RAM is read back unchanged. After a change of one word, or of up to three bits, no
    /// record is found, because a CRC-32 always detects these changes. In a RAM that has lost its supply no record is
    /// found either.
    remembered(1000, (code, causes, sample, words, flips) in (
        any::<prop::sample::Index>(),
        any::<u32>(),
        any::<u64>(),
        any::<[i32; 3]>(),
        noticed(FaultRecord::WORDS),
    )) {
        let fault = Fault::ALL[code.index(Fault::ALL.len())];
        let causes = FaultSet::from_bits(causes);
        let record = FaultRecord {
            causes,
            sample,
            position: zwidth::units::Position::from_counts(words[0]),
            velocity: zwidth::units::Velocity::saturating_from_bits(words[1]),
            force: zwidth::units::Force::saturating_from_bits(words[2]),
            ..FaultRecord::bare(fault)
        };
        let stored = record.to_words();
        assert_eq!(FaultRecord::from_words(&stored), Some(record));
        let mut other = stored;
        for (word, flip) in flips {
            other[word] ^= flip;
        }
        assert_eq!(FaultRecord::from_words(&other), (other == stored).then_some(record));
        for fill in [0, u32::MAX] {
            assert_eq!(FaultRecord::from_words(&[fill; FaultRecord::WORDS]), None);
        }
    }
}
