//! Runs the ring of positions between sampling task and output task, step by step.

use std::sync::{Mutex, PoisonError};

use proptest::prelude::*;
use zwidth::units::Position;

#[path = "../../../src/sync/position_ring.rs"]
mod position_ring;

use position_ring::{FOLLOWED, Follower, is_kept, note, read};

/// There is only one ring. With this mutex, only one test uses the ring at a time.
static RING: Mutex<()> = Mutex::new(());

/// A position that is computed from the number of its sample.
fn place(sample: u64) -> Position {
    Position::from_counts((sample.wrapping_mul(0x9E37_79B9) >> 3) as i32)
}

crate::properties! {
    /// Samples may come between any two steps of the follower. The follower reads the position of every sample up to
    /// the requested one. It reads each position once and in order. The follower leaves out positions that are too old.
    followed(300, (first, turns) in (
        prop_oneof![Just(0u64), any::<u32>().prop_map(u64::from)],
        prop::collection::vec((
            prop_oneof![8 => 1u64..20, 1 => 1u64..100],
            prop::collection::vec(prop::bool::weighted(0.3), 40),
        ), 1..40),
    )) {
        let _alone = RING.lock().unwrap_or_else(PoisonError::into_inner);
        let half = FOLLOWED as u64;
        let mut follower = Follower::new();
        // Up to the first sample there is nothing to read.
        let (mut noted, mut next) = (first, first);
        let mut begun = false;
        for (samples, between) in turns {
            for _ in 0..samples {
                note(noted, place(noted));
                noted += 1;
            }
            let last = noted - 1;
            follower.follow_to(last);
            let oldest = (last + 1).saturating_sub(half);
            if !begun {
                // The follower may start in the middle of the samples. Positions that were never noted are not read.
                for _ in oldest..first.max(oldest) {
                    follower.read();
                }
                begun = true;
            }
            next = next.max(oldest);
            let mut between = between.into_iter();
            for sample in next..=last {
                // A sample comes while other positions are read.
                if between.next() == Some(true) && noted <= last + half {
                    note(noted, place(noted));
                    noted += 1;
                }
                assert_eq!(follower.read(), Some(place(sample)), "sample {sample}");
            }
            assert_eq!(follower.read(), None);
            next = last + 1;
        }
    }

    /// Positions that are read together belong to their samples, or are reported as lost.
    read_together(300, (first, newest, since) in (any::<u32>().prop_map(u64::from), 0u64..400, 0u64..400)) {
        let _alone = RING.lock().unwrap_or_else(PoisonError::into_inner);
        let next = first + newest + 1 + since;
        (first..next).for_each(|sample| note(sample, place(sample)));
        let mut places = [Position::default(); 21];
        read(first + newest, &mut places);
        for (position, back) in places.iter().rev().zip(0..) {
            let sample = (first + newest).wrapping_sub(back);
            if sample >= first && sample <= first + newest && is_kept(sample, next) {
                assert_eq!(*position, place(sample), "{back} back");
            }
        }
    }
}

#[cfg(test)]
#[test]
fn a_flipped_bit_keeps_no_further_sample_away() {
    let _alone = RING.lock().unwrap_or_else(PoisonError::into_inner);
    for bit in 0..u64::BITS {
        let mut follower = Follower::new();
        let mut last = 1_000_000;
        for turn in 0..4 {
            (last + 1..=last + 10).for_each(|sample| note(sample, place(sample)));
            last += 10;
            follower.follow_to(last);
            let positions = std::iter::from_fn(|| follower.read()).count();
            if turn == 1 {
                follower.spoil(bit);
            }
            // After the flip the positions of one output may be missing, or come once more.
            assert!(turn != 3 || positions == 10, "bit {bit}: {positions}");
        }
    }
}
