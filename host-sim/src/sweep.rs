//! The study over cutoffs: boundaries with repeats, areas with their spread, the ideal cutoff and
//! the range that the repeats cannot tell from it.
//!
//! At its edge the boundary is chaotic: moving the start by a fraction of a count moves one walk's
//! area by 0.2 to 2 %. So every walk is repeated from starts spread over one count, and the
//! result is the mean with its low and high.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use zwidth::experiment::Ended;

use crate::{
    error::Error,
    rig::{Numeric, Rig},
    walk::{Boundary, walk},
};

/// A cutoff is as good as the best if its mean area is at least this fraction of the largest.
pub const AS_GOOD_AS_BEST: f64 = 0.98;

/// All boundaries at one cutoff.
#[derive(Clone, Debug, PartialEq)]
pub struct CutoffResult {
    /// Nominal cutoff, Hz.
    pub cutoff_hz: f64,
    /// -3 dB frequency of the digital filter, Hz.
    pub true_cutoff_hz: f64,
    /// One boundary per repeat, the first from the scene's own start.
    pub boundaries: Vec<Boundary>,
}

/// A study.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepResult {
    /// Cutoffs ascending.
    pub cutoffs: Vec<CutoffResult>,
    /// The recommendation; `None` if no cutoff has a stable wall.
    pub ideal: Option<Ideal>,
}

/// The recommended cutoff.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ideal {
    /// The smallest cutoff whose mean area is at least 98 % of the largest, Hz.
    pub cutoff_hz: f64,
    /// Lowest and highest of the cutoffs that cannot be told from it, Hz.
    pub range_hz: [f64; 2],
    /// What the range rests on.
    pub basis: RangeBasis,
}

/// What the range of the ideal cutoff rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RangeBasis {
    /// The areas of the repeats overlap with those of the ideal cutoff. With four repeats each,
    /// two equal cutoffs have areas that do not overlap in 3 of 100 cases.
    Repeats,
    /// There are no repeats: the mean area is at least 98 % of the largest.
    WithinTwoPercent,
}

impl RangeBasis {
    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Repeats => "repeats_overlap",
            Self::WithinTwoPercent => "within_two_percent",
        }
    }
}

impl CutoffResult {
    fn areas(&self) -> impl Iterator<Item = f64> {
        self.boundaries.iter().map(|boundary| boundary.area)
    }

    /// Mean area over the repeats, N^2 s/m^2.
    pub fn area(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a handful of repeats")]
        let repeats = self.boundaries.len().max(1) as f64;
        self.areas().sum::<f64>() / repeats
    }

    /// Smallest area of the repeats, N^2 s/m^2.
    pub fn area_low(&self) -> f64 {
        self.areas().reduce(f64::min).unwrap_or(0.0)
    }

    /// Largest area of the repeats, N^2 s/m^2.
    pub fn area_high(&self) -> f64 {
        self.areas().reduce(f64::max).unwrap_or(0.0)
    }

    /// Largest K of any repeat, N/m.
    pub fn stiffness_peak_n_per_m(&self) -> f64 {
        self.boundaries.iter().map(Boundary::stiffness_peak_n_per_m).fold(0.0, f64::max)
    }

    /// Largest B of any repeat, N s/m.
    pub fn damping_max_n_s_per_m(&self) -> f64 {
        self.boundaries.iter().map(Boundary::damping_max_n_s_per_m).fold(0.0, f64::max)
    }

    /// Hits over all repeats.
    pub fn hits(&self) -> u64 {
        self.boundaries.iter().map(|boundary| boundary.hits).sum()
    }
}

/// Which walks a study makes.
#[derive(Clone, Debug)]
pub struct Plan<'a> {
    /// The prepared scene.
    pub rig: &'a Rig,
    /// Nominal cutoffs, Hz, in any order.
    pub cutoffs_hz: &'a [f64],
}

/// Makes several studies at once: at every cutoff of every plan `repeats` walks (one or more), on
/// all threads of the current pool. `done` is called after each walk, from any thread. The result
/// does not depend on the number of threads.
///
/// # Errors
/// A setting is out of range, the handle does not reach the wall, or `stop` was set.
pub fn sweep(
    plans: &[Plan<'_>],
    numeric: Numeric,
    repeats: u32,
    stop: &AtomicBool,
    done: impl Fn(&Boundary) + Sync,
) -> Result<Vec<SweepResult>, Error> {
    let sorted: Vec<Vec<f64>> = plans.iter().map(|plan| ascending(plan.cutoffs_hz)).collect();
    let mut jobs = vec![];
    for (plan, cutoffs_hz) in plans.iter().zip(&sorted) {
        for &cutoff_hz in cutoffs_hz {
            for repeat in 0..repeats {
                jobs.push((plan.rig, cutoff_hz, f64::from(repeat) / f64::from(repeats)));
            }
        }
    }
    // Every walk runs to its end or to the interruption, so that the error that is reported is the
    // first in this order, not the first in time.
    let walks: Vec<Result<Boundary, Error>> = jobs
        .into_par_iter()
        .with_max_len(1)
        .map(|(rig, cutoff_hz, start_offset_counts)| {
            let boundary = walk(rig, numeric, cutoff_hz, start_offset_counts, stop)?;
            done(&boundary);
            Ok(boundary)
        })
        .collect();
    if stop.load(Ordering::Relaxed) {
        return Err(Error::Interrupted);
    }
    let mut walks = walks.into_iter();
    let mut results = Vec::with_capacity(plans.len());
    for (plan, cutoffs_hz) in plans.iter().zip(sorted) {
        let mut cutoffs = Vec::with_capacity(cutoffs_hz.len());
        for cutoff_hz in cutoffs_hz {
            let boundaries = walks.by_ref().take(repeats as usize).collect::<Result<_, _>>()?;
            let true_cutoff_hz = plan.rig.scene().true_cutoff_hz(cutoff_hz);
            cutoffs.push(CutoffResult { cutoff_hz, true_cutoff_hz, boundaries });
        }
        let ideal = ideal(&cutoffs);
        results.push(SweepResult { cutoffs, ideal });
    }
    Ok(results)
}

/// Each cutoff once, from low to high.
pub fn ascending(cutoffs_hz: &[f64]) -> Vec<f64> {
    let mut sorted = cutoffs_hz.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    sorted
}

fn ideal(cutoffs: &[CutoffResult]) -> Option<Ideal> {
    let largest = cutoffs.iter().map(CutoffResult::area).fold(0.0, f64::max);
    let good = |result: &&CutoffResult| result.area() >= AS_GOOD_AS_BEST * largest;
    let ideal = cutoffs.iter().find(good).filter(|_| largest > 0.0)?;
    let basis =
        if ideal.boundaries.len() > 1 { RangeBasis::Repeats } else { RangeBasis::WithinTwoPercent };
    let alike = |other: &&CutoffResult| match basis {
        RangeBasis::Repeats => {
            other.area_low() <= ideal.area_high() && ideal.area_low() <= other.area_high()
        }
        RangeBasis::WithinTwoPercent => good(other),
    };
    let alike = cutoffs.iter().filter(alike).map(|result| result.cutoff_hz);
    let range_hz = alike.fold([ideal.cutoff_hz; 2], |[low, high], cutoff_hz| {
        [low.min(cutoff_hz), high.max(cutoff_hz)]
    });
    Some(Ideal { cutoff_hz: ideal.cutoff_hz, range_hz, basis })
}

impl SweepResult {
    /// What a reader must know beside the numbers, one sentence each.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec![];
        for result in &self.cutoffs {
            let cutoff_hz = result.cutoff_hz;
            let walks = result.boundaries.len();
            let count = |ended| result.boundaries.iter().filter(|b| b.ended == ended).count();
            for (ended, what) in [
                (None, "the first point is unstable"),
                (Some(Ended::DampingMax), "B reached walk.damping_max_n_s_per_m"),
                (Some(Ended::StiffnessMax), "K reached walk.stiffness_max_n_per_m"),
                (Some(Ended::BothMax), "K and B reached their caps in [walk]"),
            ] {
                let found = count(ended);
                let effect =
                    if ended.is_none() { "its area counts as 0" } else { "the area is cut there" };
                if found > 0 {
                    notes.push(format!(
                        "{cutoff_hz} Hz: {what} in {found} of {walks} walks; {effect}"
                    ));
                }
            }
        }
        if let (Some(ideal), Some(first), Some(last)) =
            (self.ideal, self.cutoffs.first(), self.cutoffs.last())
        {
            let [low, high] = ideal.range_hz;
            if self.cutoffs.len() > 1 && (low == first.cutoff_hz || high == last.cutoff_hz) {
                notes.push(
                    "the ideal range touches an end of the cutoffs that were tried; it may go on beyond"
                        .into(),
                );
            }
        }
        notes
    }
}
