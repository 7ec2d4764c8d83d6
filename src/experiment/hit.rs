//! The wall hit (paper, 2.2.3). A constant push drives the handle against the wall. After a settle time a window
//! begins. The RMS of the count about its mean in this window gives the verdict.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{RmsLimit, RunningVariance};
use crate::{
    Design,
    range::{SettingsError, limits, within},
    units::{Force, Position},
};

/// The wall-hit experiment in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitSettings {
    /// Constant push of the hit, in N.
    pub push_n: f64,
    /// Time before the hit is judged, in s.
    pub settle_s: f64,
    /// Time over which the hit is judged, in s.
    pub window_s: f64,
    /// Limit of the RMS, in m. A hit is `stable` if its RMS is below this limit.
    pub rms_limit_m: f64,
}

impl HitSettings {
    /// Checks, and converts to samples, counts and fractions of full scale.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    #[expect(clippy::float_arithmetic, reason = "design time: settings to integers")]
    pub fn build(&self, design: &Design) -> Result<HitPlan, SettingsError> {
        design.check()?;
        let limit_counts = self.rms_limit_m / design.resolution_m;
        let rms = &limits::RMS_COUNTS;
        let range = rms.start() * design.resolution_m..=rms.end() * design.resolution_m;
        within("rms_limit_m", self.rms_limit_m, range)?;
        Ok(HitPlan {
            push: design.force("push_n", self.push_n)?,
            settle: design.samples("settle_s", self.settle_s)?,
            window: design.samples("window_s", self.window_s)?,
            limit: RmsLimit::from_counts(limit_counts),
        })
    }
}

/// A wall hit in samples, counts and fractions of full scale. Made by [`HitSettings::build`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitPlan {
    /// Constant push into the wall.
    pub push: Force,
    /// Samples before the window.
    pub settle: u32,
    /// Samples in the window.
    pub window: u32,
    /// Limit of the RMS. A hit is `stable` if its RMS is below this limit.
    pub limit: RmsLimit,
}

/// Result of a hit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)] // as wide as a word, so that the counts beside it in an `Event` are copied by words
pub enum Verdict {
    /// The window had contact, and the RMS stayed below the limit.
    Stable,
    /// The window had contact, and the RMS reached the limit.
    Unstable,
    /// No sample of the window was in contact. The hit gives no result about the wall.
    NoContact,
}

impl Verdict {
    /// All verdicts.
    pub const ALL: [Self; 3] = [Self::Stable, Self::Unstable, Self::NoContact];

    /// Name of the verdict for programs, in files and JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stable => "stable",
            Self::Unstable => "unstable",
            Self::NoContact => "no_contact",
        }
    }

    /// Text of the verdict for people, on the console and in figures.
    pub const fn text(self) -> &'static str {
        match self {
            Self::NoContact => "no contact",
            _ => self.name(),
        }
    }
}

/// A hit in progress. Give every sample to the hit. The hit returns a verdict once, at the last sample of the window.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    plan: HitPlan,
    samples: u32,
    contact_samples: u32,
    scatter: RunningVariance,
}

impl Hit {
    /// Makes a hit whose first sample is still to come.
    pub fn new(plan: HitPlan) -> Self {
        Self { plan, samples: 0, contact_samples: 0, scatter: RunningVariance::default() }
    }

    /// Continues a hit inside its window. The sums of the samples so far were computed elsewhere.
    pub fn in_window(plan: HitPlan, contact_samples: u32, scatter: RunningVariance) -> Self {
        Self { plan, samples: plan.settle, contact_samples, scatter }
    }

    #[inline(always)]
    pub(super) fn plan(&self) -> &HitPlan {
        &self.plan
    }

    /// The push of the hit, from the first sample to the last.
    #[inline]
    pub fn push(&self) -> Force {
        self.plan.push
    }

    /// Takes one sample. `contact` says whether its position is inside the wall.
    #[inline]
    pub fn sample(&mut self, position: Position, contact: bool) -> Option<Verdict> {
        if self.samples < self.plan.settle {
            self.samples += 1;
            return None;
        }
        if self.is_over() {
            return Some(self.verdict());
        }
        self.scatter.push(position);
        self.contact_samples += u32::from(contact);
        self.is_over().then(|| self.verdict())
    }

    /// Returns the verdict before the end of the window, if later samples cannot change it any more.
    pub fn certain_verdict(&self) -> Option<Verdict> {
        let unstable =
            self.contact_samples > 0 && self.scatter.must_reach(self.plan.limit, self.plan.window);
        unstable.then_some(Verdict::Unstable)
    }

    /// Whether the window is full.
    #[inline]
    pub fn is_over(&self) -> bool {
        self.scatter.samples() >= self.plan.window
    }

    /// Count, sum and sum of squares of the window's samples so far.
    #[inline]
    pub fn scatter(&self) -> &RunningVariance {
        &self.scatter
    }

    /// Samples of the window that were in contact.
    #[inline]
    pub fn contact_samples(&self) -> u32 {
        self.contact_samples
    }

    /// The verdict that follows from the window's samples so far.
    pub fn verdict(&self) -> Verdict {
        if self.contact_samples == 0 {
            Verdict::NoContact
        } else if self.scatter.is_below(self.plan.limit) {
            Verdict::Stable
        } else {
            Verdict::Unstable
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::tests::DESIGN;

    const PLAN: HitPlan =
        HitPlan { push: Force::ZERO, settle: 4, window: 6, limit: RmsLimit::ONE_COUNT };

    impl RmsLimit {
        const ONE_COUNT: Self = Self::from_bits(1 << 16);
    }

    /// Runs a hit and returns the verdict and the number of samples that it took.
    fn run(mut sample: impl FnMut(i32) -> (i32, bool)) -> (Verdict, i32) {
        let mut hit = Hit::new(PLAN);
        for n in 0.. {
            let (counts, contact) = sample(n);
            if let Some(verdict) = hit.sample(Position::from_counts(counts), contact) {
                return (verdict, n + 1);
            }
        }
        unreachable!()
    }

    #[test]
    fn only_the_window_counts() {
        let wild_settling = |n| (if n < 4 { 1000 * n } else { 7 }, n == 9);
        assert_eq!(run(wild_settling), (Verdict::Stable, 10));
        let late = |n| (if n == 9 { 5 } else { 0 }, true);
        assert_eq!(run(late), (Verdict::Unstable, 10));
    }

    #[test]
    fn contact_before_the_window_is_no_contact() {
        assert_eq!(run(|n| (0, n < 4)).0, Verdict::NoContact);
        assert_eq!(run(|n| (100 * n, false)).0, Verdict::NoContact);
    }

    #[test]
    fn an_early_verdict_needs_contact_and_certainty() {
        let mut hit = Hit::new(PLAN);
        for n in 0..4 {
            hit.sample(Position::from_counts(n), true);
            assert_eq!(hit.certain_verdict(), None);
        }
        hit.sample(Position::from_counts(0), false);
        hit.sample(Position::from_counts(40), false);
        assert_eq!(hit.certain_verdict(), None, "still without contact");
        hit.sample(Position::from_counts(40), true);
        assert_eq!(hit.certain_verdict(), Some(Verdict::Unstable));
    }

    #[test]
    fn a_hit_pushes_as_planned_and_counts_the_samples_of_its_window_in_contact() {
        let mut hit = Hit::new(HitPlan { push: Force::FULL_SCALE, ..PLAN });
        // four samples to settle
        let settle = [(true, 0); 4];
        for (contact, counted) in settle.into_iter().chain([(true, 1), (false, 1), (true, 2)]) {
            hit.sample(Position::from_counts(0), contact);
            assert_eq!((hit.push(), hit.contact_samples()), (Force::FULL_SCALE, counted));
        }
    }

    #[test]
    fn a_finished_hit_keeps_its_verdict() {
        let mut hit = Hit::new(PLAN);
        let verdicts = (0..20).map(|_| hit.sample(Position::from_counts(0), true));
        assert_eq!(verdicts.flatten().filter(|v| *v == Verdict::Stable).count(), 11);
    }

    #[test]
    fn a_hit_in_samples_counts_and_fractions() {
        let hit = HitSettings { push_n: 2.953, settle_s: 4.0, window_s: 2.0, rms_limit_m: 1.5e-5 };
        let plan = hit.build(&DESIGN).unwrap();
        assert_eq!((plan.settle, plan.window), (40_000, 20_000));
        assert_eq!(plan.push.bits(), 1 << 29);
        assert_eq!(plan.limit, RmsLimit::from_bits(15 << 16));
        let late = HitSettings { settle_s: f64::NAN, ..hit };
        assert_eq!(late.build(&DESIGN).unwrap_err().parameter, "settle_s");
        let strong = HitSettings { push_n: -6.0, ..hit };
        assert_eq!(strong.build(&DESIGN).unwrap_err().parameter, "push_n");
        // 0.001 to 65 535 counts of 1 um
        for (rms_limit_m, allowed) in
            [(0.9e-9, false), (1.1e-9, true), (0.0655, true), (0.0656, false)]
        {
            let built = HitSettings { rms_limit_m, ..hit }.build(&DESIGN);
            assert_eq!(built.is_ok(), allowed, "{rms_limit_m}");
        }
    }
}
