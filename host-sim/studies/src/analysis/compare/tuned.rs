//! The result of a search: boundaries at the best tuning, and what is left of their area when the
//! tuning is wrong.

use zwidth::VelocitySettings;

use crate::study::boundary::Boundaries;

/// A tuning that was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tried {
    /// Place on the axes, 0 to 1 each.
    pub place: [f64; 2],
    pub settings: VelocitySettings,
    /// Mean area of the walks of the search, N^2 s/m^2.
    pub area: f64,
    /// Number of these walks: 1 if the first one showed that this tuning cannot win.
    pub walks: u32,
}

/// An end of what was searched, at which the best tuning lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// The core accepts nothing beyond.
    Core,
    /// The range of the search ends there.
    Search,
}

/// The result of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct Tuned {
    /// Every tuning that was tried, in that order; empty if there is nothing to tune.
    pub tried: Vec<Tried>,
    /// The search ended because nothing near its result is better, not because its tunings were
    /// used up.
    pub settled: bool,
    /// Boundaries at the best tuning, one per start.
    pub boundaries: Boundaries,
    /// -3 dB bandwidth at the best tuning, Hz, as [`super::bandwidth`] defines it.
    pub bandwidth_hz: f64,
    /// Mean area that is left when the bandwidth is too low and too high by
    /// [`WRONG_BY`](super::search::WRONG_BY), as a fraction of the best one; `None` where there is
    /// nothing to tune, or the core refuses that tuning.
    pub left_when_mistuned: [Option<f64>; 2],
    /// The same where the mass of its model is too small and too large by
    /// [`MASS_WRONG_BY`](super::search::MASS_WRONG_BY); `None` without a model.
    pub left_when_mass_is_wrong: [Option<f64>; 2],
    /// Where the best tuning and the best second parameter lie at an end of what was searched.
    pub edges: [Option<Edge>; 2],
    /// Hits of all its walks: search, result, and wrong tunings.
    pub hits: u64,
}
