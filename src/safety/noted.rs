//! The faults that the guard has noted, and the part of them that the task `render` may see.

#![deny(clippy::float_arithmetic)]

use super::FaultSet;
use crate::Motion;

/// Findings of the guard since the last `clear`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Guard {
    /// Number of samples with a finding since the reset; wraps.
    pub events: u32,
    /// Number of zeroings of the count; wraps.
    pub zeros: u32,
    /// First faults. If noting had to wait, the faults of the next one or two samples are included.
    pub first: FaultSet,
    /// Sample at which the first faults were noted, low 32 bits: their own sample, or up to two later.
    pub first_sample: u32,
    /// All faults that were found.
    pub causes: FaultSet,
}

impl Guard {
    /// Nothing was found yet.
    pub const NOTHING: Self = Self {
        events: 0,
        zeros: 0,
        first: FaultSet::EMPTY,
        first_sample: 0,
        causes: FaultSet::EMPTY,
    };

    /// Notes these faults. They become the first faults if `clear` has covered all earlier faults.
    #[inline(always)]
    pub(super) fn note(&mut self, found: FaultSet, sample: u32, dealt_with: bool) {
        if dealt_with {
            (self.first, self.first_sample) = (found, sample);
        }
        self.causes = if dealt_with { found } else { self.causes.union(found) };
        self.events = self.events.wrapping_add(1);
    }

    /// Full number of [`first_sample`](Self::first_sample): the number nearest to the sample of `motion`. It is later
    /// than `motion` only if `render` is late.
    pub(super) fn first_found(&self, motion: Motion) -> u64 {
        let away = self.first_sample.wrapping_sub(motion.number()).cast_signed();
        motion.sample.saturating_add_signed(away.into())
    }
}

/// The guard's findings for the task `render`: never newer than the sample of the output.
#[derive(Clone, Copy, Debug)]
pub struct GuardView {
    newest: Guard,
    /// Sample at which the guard reported `newest`, low 32 bits.
    told_at: u32,
    /// [`Guard::zeros`] up to the sample of the last output.
    zeros: u32,
}

impl GuardView {
    /// Nothing was found yet.
    pub const NOTHING: Self = Self { newest: Guard::NOTHING, told_at: 0, zeros: 0 };

    /// Takes the guard's newest report, and the number of its sample.
    #[inline(always)]
    pub fn take(&mut self, newest: Guard, told_at: u32) {
        (self.newest, self.told_at) = (newest, told_at);
    }

    /// The guard's findings at this sample, without a zeroing after this sample.
    #[inline(always)]
    pub fn at(&mut self, sample: u32) -> Guard {
        let mut guard = self.newest;
        if self.told_at.wrapping_sub(sample).cast_signed() > 0 {
            guard.zeros = self.zeros;
        }
        self.zeros = guard.zeros;
        guard
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zero_counts_from_the_sample_with_which_it_was_carried_out() {
        let told = |zeros| Guard { zeros, events: zeros, ..Guard::NOTHING };
        let mut view = GuardView::NOTHING;
        view.take(told(1), 12);
        // all other findings count at once
        assert_eq!((view.at(10).zeros, view.at(10).events), (0, 1));
        assert_eq!(view.at(12).zeros, 1);
        view.take(told(2), 5); // the number has wrapped
        assert_eq!(view.at(u32::MAX - 4).zeros, 1);
        assert_eq!(view.at(5).zeros, 2);
        assert_eq!(view.at(15).zeros, 2);
    }
}
