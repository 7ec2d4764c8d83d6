//! The result of a search: boundaries at the best tuning, and the areas at wrong tunings.

use zwidth::VelocitySettings;

use crate::study::boundary::Boundaries;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tried {
    /// Position on the axes, each 0 to 1.
    pub place: [f64; 2],
    pub settings: VelocitySettings,
    /// Mean area of the search's walks, N^2 s/m^2.
    pub area: f64,
    /// Number of walks: 1 if the first walk showed that this tuning cannot win.
    pub walks: u32,
}

/// The reason for an end of the search range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// The core accepts no value beyond this end.
    Core,
    /// The range of the search ends at this end.
    Search,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Tuned {
    /// Every tried tuning, in the order of the tries. Empty if there is nothing to tune.
    pub tried: Vec<Tried>,
    /// Whether the search ended because no neighbour of its result is better. False if all allowed tunings were used up
    /// before that.
    pub settled: bool,
    /// Boundaries at the best tuning, one per start.
    pub boundaries: Boundaries,
    /// -3 dB bandwidth at the best tuning, Hz, as defined in [`super::bandwidth`].
    pub bandwidth_hz: f64,
    /// Mean area with a bandwidth that is too low and too high by [`WRONG_BY`](super::search::WRONG_BY), as a fraction
    /// of the best area. `None` if there is no tuning, or if the core refuses the wrong tuning.
    pub left_when_mistuned: [Option<f64>; 2],
    /// Mean area with a model mass that is too small and too large by [`MASS_WRONG_BY`](super::search::MASS_WRONG_BY),
    /// as a fraction of the best area. `None` without a model.
    pub left_when_mass_is_wrong: [Option<f64>; 2],
    /// For the tuning and the second parameter: the end of the search range, if the best value is at an end.
    pub edges: [Option<Edge>; 2],
    /// Hits of all walks: search, result, and wrong tunings.
    pub hits: u64,
}
