//! The result of a search: the boundaries at the best tuning, and the areas at wrong tunings.

use zwidth::VelocitySettings;

use crate::study::boundary::Boundaries;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tried {
    /// The tuning as a point on the axes. Each coordinate is 0 to 1.
    pub place: [f64; 2],
    pub settings: VelocitySettings,
    /// Mean area that the walks of the search found, in N^2 s/m^2.
    pub area: f64,
    /// Number of walks of this tuning. It is 1 if the first walk showed that this tuning cannot win.
    pub walks: u32,
}

/// Reason for an end of the search range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// The core accepts no value beyond the end.
    Core,
    /// The core accepts values beyond the end, but the search does not look there.
    Search,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Tuned {
    /// Every tried tuning, in the order in which they were tried. The list is empty if there is nothing to tune.
    pub tried: Vec<Tried>,
    /// Whether the search ended because no neighbour of its result is better. It is false if the allowed number of
    /// tunings was used up before that.
    pub settled: bool,
    /// Boundaries at the best tuning. Each start has one boundary.
    pub boundaries: Boundaries,
    /// Bandwidth of the best tuning, in Hz. [`super::bandwidth`] defines it.
    pub bandwidth_hz: f64,
    /// Mean areas that are left if the bandwidth is too low and too high by [`WRONG_BY`](super::search::WRONG_BY), as
    /// fractions of the best area. `None` if there is no tuning, or if the core refuses the wrong tuning.
    pub left_when_mistuned: [Option<f64>; 2],
    /// Mean areas that are left if the mass of the estimator's model is too small and too large by
    /// [`MASS_WRONG_BY`](super::search::MASS_WRONG_BY), as fractions of the best area. `None` if the estimator has no
    /// model.
    pub left_when_mass_is_wrong: [Option<f64>; 2],
    /// For the tuning and for the second parameter, the end of the search range that the best value has reached. `None`
    /// if the value is inside the range.
    pub edges: [Option<Edge>; 2],
    /// The number of hits of all walks, those of the search, of the result and of the wrong tunings.
    pub hits: u64,
}
