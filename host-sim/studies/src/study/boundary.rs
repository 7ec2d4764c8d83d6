//! The boundary of the stable walls at one cutoff. The core's walk finds it hit by hit.

use std::borrow::Cow;

use serde::Serialize;
use zwidth::{
    VelocitySettings,
    experiment::{Cell, Ended, Verdict, Walk, WalkError},
};

use crate::{
    error::Error,
    numerics::statistics::Repeats,
    simulation::prepared::{HitError, PreparedScene, WallHit},
    table::{self, Kind, Table},
};

/// A wall on the boundary: the largest stable K at this B.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BoundaryPoint {
    pub stiffness_n_per_m: f64,
    pub damping_n_s_per_m: f64,
}

impl BoundaryPoint {
    /// A hit of this wall from the scene's own start.
    pub fn hit(&self, velocity: VelocitySettings) -> WallHit {
        let Self { stiffness_n_per_m, damping_n_s_per_m } = *self;
        WallHit { velocity, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts: 0.0 }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Boundary {
    /// The points in ascending order of B.
    pub points: Vec<BoundaryPoint>,
    /// Area below the boundary, in N^2 s/m^2. It is the sum of `K dB` over the points.
    pub area: f64,
    pub hits: u64,
    /// The reason why the walk ended; `None` if the first point is unstable.
    pub ended: Option<Ended>,
}

impl Boundary {
    /// Largest K in N/m; 0 if the boundary is empty.
    pub fn stiffness_peak_n_per_m(&self) -> f64 {
        self.points.iter().map(|point| point.stiffness_n_per_m).fold(0.0, f64::max)
    }

    /// Largest B with a stable K, in N s/m; 0 if the boundary is empty.
    pub fn damping_max_n_s_per_m(&self) -> f64 {
        self.points.iter().map(|point| point.damping_n_s_per_m).fold(0.0, f64::max)
    }
}

/// Boundaries of one estimator from several starts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Boundaries(Vec<Boundary>);

impl FromIterator<Boundary> for Boundaries {
    fn from_iter<T: IntoIterator<Item = Boundary>>(boundaries: T) -> Self {
        Self(boundaries.into_iter().collect())
    }
}

impl IntoIterator for Boundaries {
    type Item = Boundary;
    type IntoIter = std::vec::IntoIter<Boundary>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

impl std::ops::Deref for Boundaries {
    type Target = Vec<Boundary>;

    fn deref(&self) -> &Vec<Boundary> {
        &self.0
    }
}

impl Boundaries {
    /// Area of each boundary, in N^2 s/m^2.
    pub fn areas(&self) -> Vec<f64> {
        self.iter().map(|boundary| boundary.area).collect()
    }

    pub fn repeats(&self) -> Repeats {
        Repeats::of(self.iter().map(|boundary| boundary.area))
    }

    /// Mean area of the boundaries, in N^2 s/m^2.
    pub fn area(&self) -> f64 {
        self.repeats().mean
    }

    pub fn hits(&self) -> u64 {
        self.iter().map(|boundary| boundary.hits).sum()
    }

    /// Smallest and largest area of the boundaries, in N^2 s/m^2.
    pub fn area_range(&self) -> [f64; 2] {
        [f64::min, f64::max].map(|of| self.areas().into_iter().reduce(of).unwrap_or(0.0))
    }

    /// Largest K that one of the boundaries has, in N/m.
    pub fn stiffness_peak_n_per_m(&self) -> f64 {
        self.stiffness_peaks_n_per_m().into_iter().fold(0.0, f64::max)
    }

    /// Largest B that one of the boundaries has, in N s/m.
    pub fn damping_max_n_s_per_m(&self) -> f64 {
        self.dampings_max_n_s_per_m().into_iter().fold(0.0, f64::max)
    }

    /// Largest K of each boundary, in N/m.
    pub fn stiffness_peaks_n_per_m(&self) -> Vec<f64> {
        self.iter().map(Boundary::stiffness_peak_n_per_m).collect()
    }

    /// Largest B of each boundary, in N s/m.
    pub fn dampings_max_n_s_per_m(&self) -> Vec<f64> {
        self.iter().map(Boundary::damping_max_n_s_per_m).collect()
    }

    /// The K of each boundary in N/m, read at the B of the grid that is nearest to this B. It is 0 if a boundary ends
    /// before this B.
    pub fn stiffnesses_at(&self, damping_n_s_per_m: f64) -> Vec<f64> {
        let of = |boundary: &Boundary| {
            let distance = |b: f64| (b - damping_n_s_per_m).abs();
            let reaches = boundary.damping_max_n_s_per_m() >= damping_n_s_per_m;
            let nearest = boundary.points.iter().min_by(|p, q| {
                distance(p.damping_n_s_per_m).total_cmp(&distance(q.damping_n_s_per_m))
            });
            nearest.filter(|_| reaches).map_or(0.0, |point| point.stiffness_n_per_m)
        };
        self.iter().map(of).collect()
    }

    /// A table with every point of several boundaries. The column `of` has the names of the boundaries.
    pub fn table<'a>(
        of: &str,
        named: impl IntoIterator<Item = (Cow<'static, str>, &'a Self)>,
    ) -> Table {
        let mut table = Table::new([
            (of, Kind::Text),
            ("repeat", Kind::Whole),
            ("damping_n_s_per_m", Kind::Number),
            ("stiffness_n_per_m", Kind::Number),
        ]);
        for (name, boundaries) in named {
            for (repeat, boundary) in boundaries.iter().enumerate() {
                table.rows.extend(boundary.points.iter().map(|point| {
                    vec![
                        table::Cell::Text(name.clone()),
                        table::Cell::count(repeat),
                        point.damping_n_s_per_m.into(),
                        point.stiffness_n_per_m.into(),
                    ]
                }));
            }
        }
        table
    }

    /// Number of boundaries whose walk ended at a cap or went beyond it.
    pub fn capped(&self) -> usize {
        self.iter().filter(|boundary| !matches!(boundary.ended, None | Some(Ended::Closed))).count()
    }
}

/// A walk that is in progress, and the boundary that it has found so far.
#[derive(Clone, Debug)]
pub struct Progress {
    walk: Walk,
    boundary: Boundary,
    last_stiffness: Option<i32>,
    velocity: VelocitySettings,
    start_offset_counts: f64,
}

impl Progress {
    /// A walk of the scene with this filter. It is before its first hit.
    pub fn new(
        prepared: &PreparedScene,
        velocity: VelocitySettings,
        start_offset_counts: f64,
    ) -> Self {
        let walk = Walk::new(prepared.scene().walk_plan());
        let boundary = Boundary { points: vec![], area: 0.0, hits: 0, ended: None };
        Self { walk, boundary, last_stiffness: None, velocity, start_offset_counts }
    }

    pub fn hit(&self) -> WallHit {
        self.hit_at(self.walk.cell())
    }

    /// The cell of the next hit, in steps of K and of B.
    pub fn place(&self) -> (i32, i32) {
        let Cell { stiffness, damping } = self.walk.cell();
        (stiffness, damping)
    }

    pub(super) fn walk(&self) -> Walk {
        self.walk
    }

    /// K of the boundary's last point in steps, and the number of points. `None` if there is no point yet.
    pub(super) fn last_point(&self) -> Option<(i32, usize)> {
        self.last_stiffness.map(|stiffness| (stiffness, self.boundary.points.len()))
    }

    pub(super) fn hit_at(&self, cell: Cell) -> WallHit {
        WallHit {
            velocity: self.velocity,
            stiffness_n_per_m: self.walk.plan().stiffness_n_per_m(cell),
            damping_n_s_per_m: self.walk.plan().damping_n_s_per_m(cell),
            start_offset_counts: self.start_offset_counts,
        }
    }

    /// Takes the verdict of [`hit`](Self::hit). At the end of the walk, returns the boundary, or the reason why there
    /// is no boundary. An unstable first point gives an empty boundary. A hit that leaves the core's range is unstable.
    /// `touches` says whether the handle reaches the wall in a hit.
    pub fn report(
        &mut self,
        verdict: Result<Verdict, HitError>,
        touches: impl Fn(&WallHit) -> bool,
    ) -> Option<Result<Boundary, Error>> {
        let hit = self.hit();
        self.boundary.hits += 1;
        let verdict = match verdict {
            // A hit with an early verdict may end before the handle leaves the range. Both count as unstable.
            Err(HitError::OutOfRange(_)) => Verdict::Unstable,
            Err(error) => return Some(Err(error.into())),
            Ok(verdict) => verdict,
        };
        let step = match self.walk.report(verdict) {
            Ok(step) => step,
            Err(WalkError::FirstUnstable) => return Some(Ok(self.boundary.clone())),
            Err(error @ WalkError::NoContact(_)) => {
                let (k, b) = (hit.stiffness_n_per_m, hit.damping_n_s_per_m);
                let reason = if touches(&hit) {
                    "the handle bounces off the wall and is away from it for the whole window; raise \
                     wall_hit.window_s or wall_hit.push_n"
                        .into()
                } else {
                    format!("{error}; raise wall_hit.push_n or move wall.position_m closer")
                };
                let cutoff = self.velocity.cutoff_hz().map(|hz| format!("{hz} Hz, "));
                return Some(Err(Error::Input(format!(
                    "no_contact at {}K = {k} N/m, B = {b} N s/m: {reason}",
                    cutoff.unwrap_or_default()
                ))));
            }
        };
        let plan = self.walk.plan();
        if let Some(cell) = step.boundary {
            let stiffness_n_per_m = plan.stiffness_n_per_m(cell);
            let damping_n_s_per_m = plan.damping_n_s_per_m(cell);
            self.boundary.area += plan.area_n2_s_per_m2(cell);
            self.boundary.points.push(BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m });
            self.last_stiffness = Some(cell.stiffness);
        }
        self.boundary.ended = step.ended;
        step.ended.map(|_| Ok(self.boundary.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let boundaries: Boundaries = [
            boundary(&[(10.0, 2000.0), (20.0, 6000.0), (30.0, 4000.0)]),
            boundary(&[(10.0, 2000.0), (20.0, 4000.0)]),
        ]
        .into_iter()
        .collect();
        assert_eq!(boundaries.areas(), [120_000.0, 60_000.0]);
        assert_eq!((boundaries.area(), boundaries.area_range()), (90_000.0, [60_000.0, 120_000.0]));
        assert_eq!(boundaries.stiffness_peaks_n_per_m(), [6000.0, 4000.0]);
        assert_eq!(boundaries.dampings_max_n_s_per_m(), [30.0, 20.0]);
        assert_eq!(boundaries.stiffness_peak_n_per_m(), 6000.0);
        assert_eq!(boundaries.stiffnesses_at(19.0), [6000.0, 4000.0]);
        assert_eq!(boundaries.stiffnesses_at(29.0), [4000.0, 0.0], "the second ends before");
    }
}
