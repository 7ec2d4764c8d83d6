//! The handle's motion over a run: several samples in one call. Only the last sample of a run may have an output.
//! Before this output the plant does not depend on the controller, so a plant behind a vtable is called only once per
//! run. The encoder is read in the same loop, while the processor waits for the plant's last step.

use std::ops::Range;

pub use zwidth::RUN;

use super::{Moment, Plant, quantiser::Quantiser};

/// Positions of the handle at the samples of a run, at most [`RUN`].
#[derive(Debug)]
pub struct Places<'a> {
    pub positions_m: &'a mut [f64; RUN],
    pub counts: &'a mut [i32; RUN],
}

/// True speeds and forces of a run. They are filled only if `watched` is set.
#[derive(Clone, Copy, Debug)]
pub struct Course {
    pub speeds_m_per_s: [f64; RUN],
    /// Force on the handle at the end of each sample except the last, in N.
    pub outputs_n: [f64; RUN],
}

/// Input of a run.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    pub index: u64,
    /// Number of samples, 1 to [`RUN`].
    pub samples: usize,
    /// Whether the [`Course`] is filled.
    pub watched: bool,
    /// Command that acts at the beginning of the run, in N.
    pub acting_n: f64,
    /// Index of the sample in which a second command takes effect. The index is beyond the run if there is no second
    /// command.
    pub arrival: usize,
    /// The second command, in N. It takes effect in sample `arrival`.
    pub arriving_n: f64,
    pub encoder: Quantiser,
}

impl Course {
    pub const NONE: Self = Self { speeds_m_per_s: [0.0; RUN], outputs_n: [0.0; RUN] };

    /// Moves the plant from the run's first sample to its last sample.
    #[inline(never)] // compiled once for each plant, independent of the controller
    pub fn run<P: Plant>(
        &mut self,
        plant: &P,
        state: P::State,
        span: &Span,
        places: &mut Places<'_>,
    ) -> P::State {
        if span.watched {
            Way::<P, true> { plant, span, places, course: self }.run(state)
        } else {
            Way::<P, false> { plant, span, places, course: self }.run(state)
        }
    }
}

struct Way<'a, 'b, P, const WATCHED: bool> {
    plant: &'a P,
    span: &'a Span,
    places: &'a mut Places<'b>,
    course: &'a mut Course,
}

impl<P: Plant, const WATCHED: bool> Way<'_, '_, P, WATCHED> {
    #[inline(always)]
    fn run(mut self, mut state: P::State) -> P::State {
        let Span { samples, acting_n, arrival, arriving_n, .. } = *self.span;
        let last = samples.clamp(1, RUN) - 1;
        state = self.under(state, acting_n, 0..last.min(arrival));
        let mut forces_n = [acting_n; 2];
        if arrival < last {
            self.note(&state, arrival, [acting_n, arriving_n]);
            state = self.plant.advance_split(&state, acting_n, arriving_n);
            self.moved(&state, arrival, arriving_n);
            state = self.under(state, arriving_n, arrival + 1..last);
            forces_n = [arriving_n; 2];
        } else if arrival == last {
            forces_n = [acting_n, arriving_n];
        }
        self.note(&state, last, forces_n);
        state
    }

    /// Moves the plant over several samples, while one command acts.
    #[inline(always)]
    fn under(&mut self, mut state: P::State, acting_n: f64, samples: Range<usize>) -> P::State {
        for sample in samples {
            self.note(&state, sample, [acting_n; 2]);
            state = self.plant.advance(&state, acting_n);
            self.moved(&state, sample, acting_n);
        }
        state
    }

    /// Stores the values of a sample. The first command acts from the sample's beginning to the split. The second
    /// command acts from the split on.
    #[inline(always)]
    fn note(&mut self, state: &P::State, sample: usize, [before_n, after_n]: [f64; 2]) {
        let sample = sample % RUN; // no effect on the value; saves the bounds checks below
        let moment = Moment { index: self.span.index + sample as u64, before_n, after_n };
        self.places.positions_m[sample] = self.plant.position_m(state);
        self.places.counts[sample] = self.span.encoder.count(self.plant.reading_m(state, &moment));
        if WATCHED {
            self.course.speeds_m_per_s[sample] = self.plant.speed_m_per_s(state);
        }
    }

    /// Stores the force at the end of a sample.
    #[inline(always)]
    fn moved(&mut self, state: &P::State, sample: usize, acting_n: f64) {
        if WATCHED {
            self.course.outputs_n[sample % RUN] = self.plant.force_n(state, acting_n);
        }
    }
}
