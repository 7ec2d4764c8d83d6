//! Sums over the blocks of a hit, for the verdict and the report.

use std::ops::ControlFlow;

use zwidth::{
    experiment::{Hit, HitPlan, RunningVariance},
    units::{Position, Velocity},
};

use crate::simulation::{Block, Output, hit::HitError, window::Watch};

/// The sums from which the core computes the verdict of a hit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Judged {
    plan: HitPlan,
    surface: i32,
    /// First position of the window.
    origin: Option<Position>,
    contact_samples: u32,
    scatter: RunningVariance,
}

/// If all counts are below this limit, the sum of the squared differences of a block's counts fits into 64 bits.
const NEAR: u32 = 1 << 26;

#[inline]
fn few(samples: usize) -> u32 {
    #[expect(clippy::cast_possible_truncation, reason = "a block is short")]
    let few = samples as u32;
    few
}

/// Bitwise OR of the magnitudes. The result is at least as large as each magnitude.
#[inline]
fn magnitudes(numbers: impl Iterator<Item = i32>) -> u32 {
    numbers.fold(0, |bits, number| bits | (number ^ (number >> 31))).cast_unsigned()
}

impl Judged {
    pub fn new(plan: HitPlan, surface: i32) -> Self {
        let scatter = RunningVariance::default();
        Self { plan, surface, origin: None, contact_samples: 0, scatter }
    }

    /// Number of the window's first sample.
    pub fn settle(&self) -> u64 {
        self.plan.settle.into()
    }

    /// The hit with the sums of the window, for the core's verdict.
    pub fn hit(&self) -> Hit {
        Hit::in_window(self.plan, self.contact_samples, self.scatter)
    }

    /// Adds a block. Breaks if the handle has left the core's range.
    #[inline(never)] // compiled once for all loops
    pub fn block(&mut self, block: &Block) -> ControlFlow<HitError> {
        let counts = block.counts();
        let far = magnitudes(counts.iter().copied());
        if far >= NEAR {
            let outside = |count: &i32| !Position::from_counts(*count).in_range();
            if let Some(place) = counts.iter().position(outside) {
                return ControlFlow::Break(HitError::OutOfRange(block.index() + place as u64));
            }
        }
        let within = counts.get(block.before(self.settle())..).unwrap_or_default();
        let Some((first, rest)) = within.split_first() else {
            return ControlFlow::Continue(());
        };
        let surface = self.surface;
        let contact = |count: &i32| u32::from(*count > surface);
        self.contact_samples += within.iter().map(contact).sum::<u32>();
        let (origin, rest) = match self.origin {
            Some(origin) => (origin, within),
            None => {
                let origin = Position::from_counts(*first);
                self.origin = Some(origin);
                self.scatter.push(origin);
                (origin, rest)
            }
        };
        if far.max(magnitudes([origin.counts()].into_iter())) < NEAR {
            let away = |count: &i32| i64::from(*count - origin.counts());
            let sum = rest.iter().map(away).sum();
            let squares: i64 = rest.iter().map(|count| away(count) * away(count)).sum();
            self.scatter.add(few(rest.len()), sum, squares.unsigned_abs().into());
        } else {
            rest.iter().for_each(|count| self.scatter.push(Position::from_counts(*count)));
        }
        ControlFlow::Continue(())
    }
}

/// Sums for the report of a whole hit, without the sums for the verdict.
#[derive(Clone, Debug)]
pub(super) struct Shown {
    pub watch: Watch,
    /// Positions in the window, in m. They are only stored if `listens` is set.
    pub motion: Vec<f64>,
    listens: bool,
    pub outputs: u32,
    pub saturated: u32,
    pub deepest_m: f64,
    /// Number of samples whose count changed by more than the core's velocity can represent.
    pub clipped: u32,
    pub last: i32,
}

impl Shown {
    /// Empty sums before sample 0, for a handle at rest at the count `last`.
    pub fn new(listens: bool, last: i32) -> Self {
        let (outputs, saturated, clipped, deepest_m) = (0, 0, 0, f64::NEG_INFINITY);
        let (watch, motion) = (Watch::default(), vec![]);
        Self { watch, motion, listens, outputs, saturated, deepest_m, clipped, last }
    }

    /// Adds a block. The window of the hit begins with sample `settle`.
    #[inline(never)] // compiled once for all loops
    pub fn block(&mut self, block: &Block, settle: u64) {
        self.outputs += few(block.outputs().len());
        let saturated = |output: &Output| u32::from(output.rendered.saturated);
        self.saturated += block.outputs().iter().map(saturated).sum::<u32>();
        let positions_m = block.positions_m();
        let deeper =
            |most: f64, position_m: &f64| if *position_m > most { *position_m } else { most };
        self.deepest_m = positions_m.iter().fold(self.deepest_m, deeper);
        let counts = block.counts();
        if let (Some(first), Some(last)) = (counts.first(), counts.last()) {
            let moved = counts.windows(2).map(|pair| pair[1].wrapping_sub(pair[0]));
            let most = magnitudes(moved) | magnitudes([first.wrapping_sub(self.last)].into_iter());
            if most >= Velocity::LIMIT.unsigned_abs() {
                let before = [self.last].into_iter().chain(counts.iter().copied());
                let moved = counts.iter().zip(before).map(|(count, before)| count.abs_diff(before));
                let fast = |moved: &u32| *moved > Velocity::LIMIT.unsigned_abs();
                self.clipped += few(moved.filter(fast).count());
            }
            self.last = *last;
        }
        let before = block.before(settle);
        let Some((first, _)) = positions_m.get(before..).and_then(<[f64]>::split_first) else {
            return;
        };
        let mut watch = self.watch;
        if block.index() + before as u64 == settle {
            watch.origin_m = *first;
        }
        for position_m in positions_m.iter().skip(before) {
            watch.sample(*position_m);
        }
        for output in block.outputs().iter().skip_while(|output| output.place < before) {
            watch.output(output.rendered.output);
        }
        self.watch = watch;
        if self.listens {
            self.motion.extend(positions_m.iter().skip(before));
        }
    }
}
