//! The result of a search: boundaries at the best tuning, and what is left of their area when the
//! tuning is wrong.

use zwidth::VelocitySettings;

use crate::{numerics::statistics::Repeats, study::walk::Boundary};

/// A tuning that was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tried {
    /// Place on the axes, 0 to 1 each.
    pub place: [f64; 2],
    /// The estimator there.
    pub settings: VelocitySettings,
    /// Mean area of the walks of the search, N^2 s/m^2.
    pub area: f64,
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
    pub boundaries: Vec<Boundary>,
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
}

impl Tuned {
    fn each(&self, of: impl Fn(&Boundary) -> f64) -> Vec<f64> {
        self.boundaries.iter().map(of).collect()
    }

    /// Area of each repeat, N^2 s/m^2.
    pub fn areas(&self) -> Vec<f64> {
        self.each(|boundary| boundary.area)
    }

    /// Mean area, N^2 s/m^2.
    pub fn area(&self) -> f64 {
        Repeats::of(self.boundaries.iter().map(|boundary| boundary.area)).mean
    }

    /// Smallest and largest area of the repeats, N^2 s/m^2.
    pub fn area_range(&self) -> [f64; 2] {
        let low = self.areas().into_iter().reduce(f64::min).unwrap_or(0.0);
        [low, self.areas().into_iter().reduce(f64::max).unwrap_or(0.0)]
    }

    /// Largest K of each repeat, N/m.
    pub fn stiffness_peaks_n_per_m(&self) -> Vec<f64> {
        self.each(Boundary::stiffness_peak_n_per_m)
    }

    /// Largest B of each repeat, N s/m.
    pub fn dampings_max_n_s_per_m(&self) -> Vec<f64> {
        self.each(Boundary::damping_max_n_s_per_m)
    }

    /// K of each repeat at the grid's B nearest to this one, N/m; 0 where a boundary ends before.
    pub fn stiffnesses_at(&self, damping_n_s_per_m: f64) -> Vec<f64> {
        self.each(|boundary| {
            let distance = |b: f64| (b - damping_n_s_per_m).abs();
            let reaches = boundary.damping_max_n_s_per_m() >= damping_n_s_per_m;
            let nearest = boundary.points.iter().min_by(|p, q| {
                distance(p.damping_n_s_per_m).total_cmp(&distance(q.damping_n_s_per_m))
            });
            nearest.filter(|_| reaches).map_or(0.0, |point| point.stiffness_n_per_m)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::walk::BoundaryPoint;

    #[test]
    fn every_figure_of_a_boundary_is_that_of_each_repeat() {
        let boundary = |points: &[(f64, f64)]| Boundary {
            points: points
                .iter()
                .map(|&(damping_n_s_per_m, stiffness_n_per_m)| BoundaryPoint {
                    damping_n_s_per_m,
                    stiffness_n_per_m,
                })
                .collect(),
            area: points.iter().map(|(_, k)| 10.0 * k).sum(),
            hits: 1,
            ended: None,
        };
        let tuned = Tuned {
            tried: vec![],
            settled: true,
            boundaries: vec![
                boundary(&[(10.0, 2000.0), (20.0, 6000.0), (30.0, 4000.0)]),
                boundary(&[(10.0, 2000.0), (20.0, 4000.0)]),
            ],
            bandwidth_hz: 0.0,
            left_when_mistuned: [None; 2],
            left_when_mass_is_wrong: [None; 2],
            edges: [None; 2],
        };
        assert_eq!(tuned.areas(), [120_000.0, 60_000.0]);
        assert_eq!((tuned.area(), tuned.area_range()), (90_000.0, [60_000.0, 120_000.0]));
        assert_eq!(tuned.stiffness_peaks_n_per_m(), [6000.0, 4000.0]);
        assert_eq!(tuned.dampings_max_n_s_per_m(), [30.0, 20.0]);
        assert_eq!(tuned.stiffnesses_at(19.0), [6000.0, 4000.0]);
        assert_eq!(tuned.stiffnesses_at(29.0), [4000.0, 0.0], "the second ends before");
    }
}
