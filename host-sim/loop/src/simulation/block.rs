//! Computes the samples of a run together.
//!
//! Only the last sample of a [`Run`] may have an output. So each stage (plant, encoder, estimator) is computed over the
//! whole run. Then no stage has to wait for another stage at every sample. Observers get a [`Block`] of many runs.

use zwidth::velocity::Senses;

use super::{
    Sample,
    controller::{Controller, ControllerOutput, Readings},
    senses::{Handle, Sensing},
};
use crate::plant::{Course, Places, RUN};

/// Largest number of samples that are collected in a block.
const SAMPLES: usize = 128;
/// Number of entries: room for a block and for one more run.
const ROOM: usize = SAMPLES + RUN;

/// Results of several samples.
#[derive(Clone, Debug)]
pub struct Block {
    index: u64,
    samples: usize,
    positions_m: [f64; ROOM],
    counts: [i32; ROOM],
    /// The controller's velocities in counts per sample. `outputs_n` has the forces at the samples' ends, in N. Both
    /// are only filled if samples are observed.
    velocities: [f64; ROOM],
    outputs_n: [f64; ROOM],
    outputs: Vec<Output>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// The output belongs to the sample with this index in the block.
    pub place: usize,
    pub rendered: ControllerOutput,
}

/// Intermediate values of a run, used only by its stages.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub samples: usize,
    pub course: Course,
    senses: [Senses; RUN],
}

impl Run {
    pub const NONE: Self = Self { samples: 0, course: Course::NONE, senses: [Senses::NONE; RUN] };

    /// Computes the inputs that the controller gets in addition to the count. The handle is at these positions at the
    /// run's samples.
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

    /// Number of the block's first sample.
    #[inline]
    pub fn index(&self) -> u64 {
        self.index
    }

    #[inline]
    pub fn counts(&self) -> &[i32] {
        self.counts.get(..self.samples).unwrap_or_default()
    }

    #[inline]
    pub fn positions_m(&self) -> &[f64] {
        self.positions_m.get(..self.samples).unwrap_or_default()
    }

    #[inline]
    pub fn outputs(&self) -> &[Output] {
        &self.outputs
    }

    /// Number of samples in the block that are before sample `index`.
    #[inline]
    pub fn before(&self, index: u64) -> usize {
        let before = index.saturating_sub(self.index).min(self.samples as u64);
        usize::try_from(before).unwrap_or(SAMPLES)
    }

    /// The samples of the block, one by one. The run must be `watched`.
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

    /// Makes the block empty. The next sample is `index`.
    #[inline]
    pub(super) fn begin(&mut self, index: u64) {
        (self.index, self.samples) = (index, 0);
        self.outputs.clear();
    }

    #[inline]
    pub(super) fn has_room(&self) -> bool {
        self.samples < SAMPLES
    }

    #[inline]
    pub(super) fn places(&mut self) -> Option<Places<'_>> {
        let (at, Self { positions_m, counts, .. }) = (self.samples, self);
        let positions_m = positions_m.get_mut(at..)?.first_chunk_mut()?;
        Some(Places { positions_m, counts: counts.get_mut(at..)?.first_chunk_mut()? })
    }

    /// Adds the samples of a run. The controller's estimator runs over them.
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

    #[inline]
    pub(super) fn output(&mut self, rendered: ControllerOutput) {
        self.outputs.push(Output { place: self.samples - 1, rendered });
    }

    /// Stores the force at the end of the last sample, in N.
    pub(super) fn end(&mut self, output_n: f64) {
        if let Some(last) = self.outputs_n.get_mut(self.samples - 1) {
            *last = output_n;
        }
    }
}
