//! The samples of a run, taken many at once.
//!
//! A [`Run`] of samples ends with an output at the latest: so its stages (plant, encoder, estimator) come one after the
//! other over all of it, and none waits for the one before it in every sample. Whoever looks on gets a [`Block`] of many
//! runs.

use zwidth::velocity::Senses;

use super::{
    Sample,
    controller::{Controller, ControllerOutput, Readings},
    senses::{Handle, Sensing},
};
use crate::plant::{Course, Places, RUN};

/// Samples of a block at most.
const SAMPLES: usize = 128;
/// Room for them, and for a run at any place.
const ROOM: usize = SAMPLES + RUN;

/// What happened at some samples.
#[derive(Clone, Debug)]
pub struct Block {
    /// Number of its first sample.
    index: u64,
    samples: usize,
    positions_m: [f64; ROOM],
    counts: [i32; ROOM],
    /// If somebody looks at each sample: the controller's velocities, counts per sample, and the forces at their ends, N.
    velocities: [f64; ROOM],
    outputs_n: [f64; ROOM],
    outputs: Vec<Output>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// The sample with which it was computed, as its place in the block.
    pub place: usize,
    /// What the controller did.
    pub rendered: ControllerOutput,
}

/// What only the stages of a run see of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub samples: usize,
    pub course: Course,
    senses: [Senses; RUN],
}

impl Run {
    pub const NONE: Self = Self { samples: 0, course: Course::NONE, senses: [Senses::NONE; RUN] };

    /// Fills the senses at its samples, for these positions.
    #[inline]
    fn sense<S: Sensing>(&mut self, positions_m: &[f64; RUN], sensing: &mut S) {
        let speeds_m_per_s = &self.course.speeds_m_per_s;
        let handle = |place: usize| Handle {
            position_m: positions_m[place],
            speed_m_per_s: speeds_m_per_s[place],
        };
        for place in 0..self.samples.min(RUN) {
            if let Some(before) = place.checked_sub(1) {
                sensing.moved(handle(before), handle(place));
            }
            self.senses[place] = *sensing.senses();
        }
    }
}

impl Block {
    pub(super) fn new() -> Self {
        let (counts, nothing) = ([0; ROOM], [0.0; ROOM]);
        let (positions_m, velocities, outputs_n) = (nothing, nothing, nothing);
        let outputs = Vec::with_capacity(SAMPLES);
        Self { index: 0, samples: 0, positions_m, counts, velocities, outputs_n, outputs }
    }

    /// Number of its first sample.
    #[inline]
    pub fn index(&self) -> u64 {
        self.index
    }

    /// What the encoder read.
    #[inline]
    pub fn counts(&self) -> &[i32] {
        self.counts.get(..self.samples).unwrap_or_default()
    }

    /// Positions of the handle, m.
    #[inline]
    pub fn positions_m(&self) -> &[f64] {
        self.positions_m.get(..self.samples).unwrap_or_default()
    }

    /// The outputs, in order.
    #[inline]
    pub fn outputs(&self) -> &[Output] {
        &self.outputs
    }

    /// How many of its samples come before that number.
    #[inline]
    pub fn before(&self, index: u64) -> usize {
        let before = index.saturating_sub(self.index).min(self.samples as u64);
        usize::try_from(before).unwrap_or(SAMPLES)
    }

    /// Its samples one by one, of a run that is watched.
    pub fn each(&self) -> impl Iterator<Item = Sample> {
        let mut outputs = self.outputs.iter().peekable();
        (0..self.samples)
            .map(move |place| self.sample(place, outputs.next_if(|output| output.place == place)))
    }

    pub(super) fn sample(&self, place: usize, output: Option<&Output>) -> Sample {
        Sample {
            index: self.index + place as u64,
            position_m: self.positions_m[place],
            count: self.counts[place],
            velocity: self.velocities[place],
            rendered: output.map(|output| output.rendered),
            output_n: self.outputs_n[place],
        }
    }

    /// Empty, before sample `index`.
    #[inline]
    pub(super) fn begin(&mut self, index: u64) {
        (self.index, self.samples) = (index, 0);
        self.outputs.clear();
    }

    /// There is room for another run.
    #[inline]
    pub(super) fn has_room(&self) -> bool {
        self.samples < SAMPLES
    }

    /// Where the next run goes.
    #[inline]
    pub(super) fn places(&mut self) -> Option<Places<'_>> {
        let (at, Self { positions_m, counts, .. }) = (self.samples, self);
        let positions_m = positions_m.get_mut(at..)?.first_chunk_mut()?;
        Some(Places { positions_m, counts: counts.get_mut(at..)?.first_chunk_mut()? })
    }

    /// Takes the samples of a run, through the stage of the controller.
    #[inline]
    pub(super) fn take<C: Controller, S: Sensing>(
        &mut self,
        run: &mut Run,
        controller: &mut C,
        sensing: &mut S,
        watched: bool,
    ) {
        let (at, looks) = (self.samples, sensing.looks());
        self.samples += run.samples;
        if looks
            && let Some(positions_m) = self.positions_m.get(at..).and_then(<[f64]>::first_chunk)
        {
            run.sense(positions_m, sensing);
        }
        let readings = Readings {
            counts: self.counts.get(at..self.samples).unwrap_or_default(),
            senses: if looks { &run.senses[..] } else { &[] },
            speeds_m_per_s: &run.course.speeds_m_per_s,
        };
        if !watched {
            return controller.samples(readings, None);
        }
        let velocities = self.velocities.get_mut(at..).and_then(<[f64]>::first_chunk_mut);
        controller.samples(readings, velocities);
        let outputs_n = self.outputs_n.get_mut(at..).and_then(<[f64]>::first_chunk_mut);
        if let Some(outputs_n) = outputs_n {
            *outputs_n = run.course.outputs_n;
        }
    }

    /// Its last sample has an output.
    #[inline]
    pub(super) fn output(&mut self, rendered: ControllerOutput) {
        self.outputs.push(Output { place: self.samples - 1, rendered });
    }

    /// The force at its end, N.
    pub(super) fn end(&mut self, output_n: f64) {
        if let Some(last) = self.outputs_n.get_mut(self.samples - 1) {
            *last = output_n;
        }
    }
}
