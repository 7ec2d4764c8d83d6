//! The handle's motion over a run of samples, at most the last of which has an output: the plant needs nothing of the
//! controller there, so it moves on alone, and a plant behind a table is called once for all of them. Its encoder reads
//! it on the way: the plant waits for its last step longer than that takes.

use std::ops::Range;

pub use zwidth::RUN;

use super::{Moment, Plant, quantiser::Quantiser};

/// Where the handle is at the samples of a run, at most [`RUN`].
#[derive(Debug)]
pub struct Places<'a> {
    pub positions_m: &'a mut [f64; RUN],
    /// What the encoder reads.
    pub counts: &'a mut [i32; RUN],
}

/// True speeds and forces of a run, filled if they are asked for.
#[derive(Clone, Copy, Debug)]
pub struct Course {
    pub speeds_m_per_s: [f64; RUN],
    /// Force on the handle at the end of each sample but the last, N.
    pub outputs_n: [f64; RUN],
}

/// A run that is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// Number of its first sample.
    pub index: u64,
    /// Its samples, 1 to [`RUN`].
    pub samples: usize,
    /// Somebody looks at the [`Course`].
    pub watched: bool,
    /// Command that acts at its beginning, N.
    pub acting_n: f64,
    /// The sample of the run within which another command takes effect; beyond the run if there is none.
    pub arrival: usize,
    /// Command that takes effect there, N.
    pub arriving_n: f64,
    /// What reads the handle.
    pub encoder: Quantiser,
}

impl Course {
    pub const NONE: Self = Self { speeds_m_per_s: [0.0; RUN], outputs_n: [0.0; RUN] };

    /// Moves from the run's first sample to its last one.
    #[inline(never)] // once for each plant, whatever the controller
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

/// A run on its way.
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

    /// Samples under one command.
    #[inline(always)]
    fn under(&mut self, mut state: P::State, acting_n: f64, samples: Range<usize>) -> P::State {
        for sample in samples {
            self.note(&state, sample, [acting_n; 2]);
            state = self.plant.advance(&state, acting_n);
            self.moved(&state, sample, acting_n);
        }
        state
    }

    /// A sample, with the commands that act at its beginning and from its split on.
    #[inline(always)]
    fn note(&mut self, state: &P::State, sample: usize, [before_n, after_n]: [f64; 2]) {
        let sample = sample % RUN; // as it is: so nothing below is checked again
        let moment = Moment { index: self.span.index + sample as u64, before_n, after_n };
        self.places.positions_m[sample] = self.plant.position_m(state);
        self.places.counts[sample] = self.span.encoder.count(self.plant.reading_m(state, &moment));
        if WATCHED {
            self.course.speeds_m_per_s[sample] = self.plant.speed_m_per_s(state);
        }
    }

    /// The end of a sample.
    #[inline(always)]
    fn moved(&mut self, state: &P::State, sample: usize, acting_n: f64) {
        if WATCHED {
            self.course.outputs_n[sample % RUN] = self.plant.force_n(state, acting_n);
        }
    }
}
