//! The boundary walk.

use proptest::prelude::*;
use zwidth::experiment::{Cell, Ended, Verdict, Walk, WalkError, WalkSettings, WalkTotals};

use crate::any::Random;

/// A grid in whole units, so that rounding cannot change its cells. It has start, step and largest value of K, and the
/// same of B.
#[derive(Clone, Copy, Debug)]
struct Grid {
    unit: [f64; 2],
    k: [i64; 3],
    b: [i64; 3],
}

impl Grid {
    fn settings(&self) -> WalkSettings {
        let k = self.k.map(|number| number as f64 * self.unit[0]);
        let b = self.b.map(|number| number as f64 * self.unit[1]);
        WalkSettings {
            stiffness_start_n_per_m: k[0],
            stiffness_step_n_per_m: k[1],
            stiffness_max_n_per_m: k[2],
            damping_start_n_s_per_m: b[0],
            damping_step_n_s_per_m: b[1],
            damping_max_n_s_per_m: b[2],
        }
    }

    fn k(&self, i: i64) -> i64 {
        self.k[0] + i * self.k[1]
    }

    fn b(&self, j: i64) -> i64 {
        self.b[0] + j * self.b[1]
    }
}

fn grid() -> impl Strategy<Value = Grid> {
    let axis = |first: i64| {
        (1i64..40, first..60, 0i64..500).prop_map(|(step, start, more)| [start, step, start.max(step) + more])
    };
    // Steps in decimal units, whose sum differs slightly from the largest value.
    let unit = prop::sample::select(vec![1.0, 0.1, 0.01, 0.3, 10.01, 7e-3]);
    ([unit.clone(), unit], axis(1), axis(0)).prop_map(|(unit, k, b)| Grid { unit, k, b })
}

/// Which walls are stable.
#[derive(Clone, Copy, Debug)]
enum World {
    /// Walls below a parabola of B are stable.
    Arch { top: i64, middle: i64, fall: i64 },
    /// Random walls, all with contact. Of eight walls, `of_eight` are stable on average.
    Random { seed: u64, of_eight: u64 },
    /// Random walls. Some of these walls have no contact.
    Loose { seed: u64 },
}

impl World {
    fn verdict(&self, grid: &Grid, i: i64, j: i64) -> Verdict {
        let random = |seed: u64| Random(seed ^ (i as u64) << 32 ^ j as u64).below(64);
        let stable = |stable| if stable { Verdict::Stable } else { Verdict::Unstable };
        match *self {
            Self::Arch { top, middle, fall } => {
                let away = grid.b(j) - middle;
                stable(grid.k(i) <= top - away * away / fall)
            }
            Self::Random { seed, of_eight } => stable(random(seed) / 8 < of_eight),
            Self::Loose { seed } => match random(seed) {
                0 => Verdict::NoContact,
                n => stable(n < 40),
            },
        }
    }
}

fn world() -> impl Strategy<Value = World> {
    prop_oneof![
        (1i64..600, 0i64..500, 1i64..500).prop_map(|(top, middle, fall)| World::Arch { top, middle, fall }),
        (any::<u64>(), 0u64..=8).prop_map(|(seed, of_eight)| World::Random { seed, of_eight }),
        any::<u64>().prop_map(|seed| World::Loose { seed }),
    ]
}

/// The hits, points and end of a walk as the paper describes it: column by column.
#[derive(Debug, Default, PartialEq)]
struct Told {
    hits: Vec<[i64; 2]>,
    boundary: Vec<[i64; 2]>,
    end: Option<Result<Ended, WalkError>>,
}

fn told(grid: &Grid, world: &World) -> Told {
    let mut told = Told::default();
    let mut capped = false;
    let cell = |[i, j]: [i64; 2]| Cell { stiffness: i as i32, damping: j as i32 };
    let [mut i, mut j] = [0, 0];
    // The highest stable K of each column. The search starts at the K of the previous column.
    loop {
        let mut highest = None;
        let mut at = i;
        loop {
            told.hits.push([at, j]);
            match world.verdict(grid, at, j) {
                Verdict::NoContact => {
                    told.end = Some(Err(WalkError::NoContact(cell([at, j]))));
                    return told;
                }
                Verdict::Stable => {
                    let came_down = at < i;
                    highest = Some(at);
                    if came_down {
                        break;
                    }
                    if grid.k(at + 1) > grid.k[2] {
                        capped = true;
                        break;
                    }
                    at += 1;
                }
                Verdict::Unstable if told.hits.len() == 1 => {
                    told.end = Some(Err(WalkError::FirstUnstable));
                    return told;
                }
                Verdict::Unstable if highest.is_some() => break,
                Verdict::Unstable if grid.k(at - 1) > 0 => at -= 1,
                Verdict::Unstable => {
                    let ended = if capped { Ended::StiffnessMax } else { Ended::Closed };
                    told.end = Some(Ok(ended));
                    return told;
                }
            }
        }
        i = highest.unwrap();
        told.boundary.push([i, j]);
        if grid.b(j + 1) > grid.b[2] {
            told.end = Some(Ok(if capped { Ended::BothMax } else { Ended::DampingMax }));
            return told;
        }
        j += 1;
    }
}

crate::properties! {
    /// A walk has the same hits, boundary, area and end as a second implementation, which goes column by column in
    /// whole numbers. This is true for any set of stable walls. After the end the walk stays within its largest values
    /// and repeats its answer.
    told_column_by_column(300, (grid, world) in (grid(), world())) {
        let told = told(&grid, &world);
        let settings = grid.settings();
        assert_eq!(settings.check(), Ok(()));
        let mut walk = Walk::new(settings);
        let mut totals = WalkTotals::default();
        let mut seen = Told::default();
        while seen.end.is_none() && seen.hits.len() <= told.hits.len() {
            let [i, j] = [walk.cell().stiffness, walk.cell().damping].map(i64::from);
            seen.hits.push([i, j]);
            match walk.report(world.verdict(&grid, i, j)) {
                Ok(step) => {
                    totals.add(&settings, &step);
                    seen.boundary.extend(step.boundary.map(|c| [c.stiffness.into(), c.damping.into()]));
                    seen.end = step.ended.map(Ok);
                }
                Err(error) => seen.end = Some(Err(error)),
            }
        }
        assert_eq!(seen, told);
        let last = walk.cell();
        for verdict in Verdict::ALL {
            let again = walk.report(verdict).map(|step| step.ended.unwrap());
            assert_eq!(Some(again), told.end);
            assert_eq!(walk.cell(), last);
        }
        assert!((1..=grid.k[2]).contains(&grid.k(last.stiffness.into())));
        assert!((0..=grid.b[2]).contains(&grid.b(last.damping.into())));
        if told.end.is_some_and(|end| end.is_ok()) {
            let units: i64 = told.boundary.iter().map(|[i, _]| grid.k(*i) * grid.b[1]).sum();
            let area = units as f64 * grid.unit[0] * grid.unit[1];
            assert!((totals.area - area).abs() <= 1e-9 * area);
            assert_eq!(totals.points as usize, told.boundary.len());
            assert_eq!(totals.hits as usize, told.hits.len());
            let peak = told.boundary.iter().map(|[i, _]| grid.k(*i)).max().unwrap_or(0);
            assert!((totals.stiffness_peak_n_per_m - peak as f64 * grid.unit[0]).abs() <= 1e-6 * grid.unit[0]);
        }
    }
}
