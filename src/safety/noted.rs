//! The faults that the guard has noted, and the part of them that the task `render` may see.

#![deny(clippy::float_arithmetic)]

use super::FaultSet;
use crate::Motion;

/// Findings of the guard since the last `clear`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Guard {
    /// Number of samples since the reset in which a fault was found. The number wraps.
    pub events: u32,
    /// Number of times that the count was zeroed. The number wraps.
    pub zeros: u32,
    /// The faults that were noted first. If the guard had to wait before it could note them, the faults of the next one
    /// or two samples are included.
    pub first: FaultSet,
    /// Low 32 bits of the number of the sample at which the first faults were noted. This is the sample in which they
    /// were found, or one of the next two.
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

    /// Notes these faults. They become the first faults if all earlier ones were cleared.
    #[inline(always)]
    pub(super) fn note(&mut self, found: FaultSet, sample: u32, dealt_with: bool) {
        if dealt_with {
            (self.first, self.first_sample) = (found, sample);
        }
        self.causes = if dealt_with { found } else { self.causes.union(found) };
        self.events = self.events.wrapping_add(1);
    }

    /// Full number of the sample [`first_sample`](Self::first_sample). It is the number nearest to the sample of
    /// `motion`, and is larger than that only if `render` is late.
    pub(super) fn first_found(&self, motion: Motion) -> u64 {
        let away = self.first_sample.wrapping_sub(motion.number()).cast_signed();
        motion.sample.saturating_add_signed(away.into())
    }
}

/// The guard's findings, as the task `render` may see them at an output. A zeroing after the sample of this output is
/// not yet included.
#[derive(Clone, Copy, Debug)]
pub struct GuardView {
    newest: Guard,
    /// Low 32 bits of the number of the sample at which the guard reported `newest`.
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

    /// Returns the guard's findings for the output of this sample. A zeroing after this sample is left out.
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
        // All findings other than zeroings count at once.
        assert_eq!((view.at(10).zeros, view.at(10).events), (0, 1));
        assert_eq!(view.at(12).zeros, 1);
        view.take(told(2), 5); // the number has wrapped
        assert_eq!(view.at(u32::MAX - 4).zeros, 1);
        assert_eq!(view.at(5).zeros, 2);
        assert_eq!(view.at(15).zeros, 2);
    }
}
