//! Errors and cost of the methods to advance the plant.
//!
//! | what | how |
//! |------|-----|
//! | trajectory | the commands of one wall hit inside the boundary are replayed. The result is the largest distance from the reference's position |
//! | verdicts | number of verdicts that differ from the reference's, for hits at one and two steps of K on both sides of the boundary |
//! | boundary | area of the walks from two starts, compared with the reference's. The grid is [`COARSER`] times as coarse as the scene's |
//! | cost | tried steps times the additions and multiplications of a step, per simulated second. An adaptive method repeats some steps, and an event needs several steps |
//!
//! The reference is the exact step. On a non-linear plant the reference is the adaptive method with its smallest
//! tolerance. At the boundary a hit is chaotic. So a second reference starts [`NUDGE_COUNTS`] away, as the repeats of a
//! sweep do. The differences between the two references are reported too. A method with smaller differences gives the
//! same answer as the reference.

mod replay;

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use zwidth::{VelocitySettings, experiment::Verdict};

pub use replay::{Recorded, Replayed};

use crate::{
    engine::Engine,
    error::Error,
    numerics::integrator::Integrator,
    scene::{Scene, element::Nonlinear},
    sim_plant::AnyPlant,
    simulation::prepared::{HitError, Numeric, PreparedScene, WallHit},
    study::{sweep::start_offset_counts, walk::walk},
};

/// Steps of K and B in these walks, as a multiple of the scene's steps.
pub const COARSER: f64 = 4.0;
/// Number of walks, each from another start position.
const REPEATS: u32 = 2;
/// Number of points on the boundary around which hits are compared. `BESIDE` has the distances of these hits from a
/// point, in steps of K.
const POINTS: usize = 8;
const BESIDE: [f64; 4] = [-2.0, -1.0, 1.0, 2.0];
/// Distance of the second reference's start from the start of the first, in counts. Their difference shows the effect
/// of chaos.
pub const NUDGE_COUNTS: f64 = 0.25;
/// Numbers of equal steps per sample.
const STEPS: [u32; 6] = [1, 2, 5, 10, 20, 50];
/// Tolerances of the adaptive method. Each pair has the relative tolerance, and the absolute tolerance of a position in
/// m.
const TOLERANCES: [[f64; 2]; 4] = [[1e-3, 1e-9], [1e-6, 1e-12], [1e-9, 1e-15], [1e-12, 1e-18]];

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Exact, by the matrix exponential.
    Exact,
    Integrated(Integrator),
}

impl Method {
    /// All methods that a scene can have. The first is the reference.
    pub fn all(scene: &Scene) -> Vec<Self> {
        let adaptive =
            TOLERANCES.iter().rev().map(|&[relative_tolerance, absolute_tolerance_m]| {
                Integrator::DormandPrince { relative_tolerance, absolute_tolerance_m }
            });
        let euler =
            STEPS.map(|steps_per_sample| Integrator::SemiImplicitEuler { steps_per_sample });
        let rk4 = STEPS.map(|steps_per_sample| Integrator::Rk4 { steps_per_sample });
        let exact = (scene.nonlinear() == Nonlinear::default()).then_some(Self::Exact);
        let stepwise = adaptive.chain(euler).chain(rk4).map(Self::Integrated);
        exact.into_iter().chain(stepwise).collect()
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Integrated(Integrator::SemiImplicitEuler { .. }) => "semi-implicit-euler",
            Self::Integrated(Integrator::Rk4 { .. }) => "rk4",
            Self::Integrated(Integrator::DormandPrince { .. }) => "dormand-prince",
        }
    }

    /// The setting of the method: its number of steps per sample, or its relative tolerance.
    pub fn setting(self) -> Option<f64> {
        match self {
            Self::Exact => None,
            Self::Integrated(
                Integrator::SemiImplicitEuler { steps_per_sample }
                | Integrator::Rk4 { steps_per_sample },
            ) => Some(steps_per_sample.into()),
            Self::Integrated(Integrator::DormandPrince { relative_tolerance, .. }) => {
                Some(relative_tolerance)
            }
        }
    }

    fn scene(self, scene: &Scene) -> Scene {
        let integrator = match self {
            Self::Exact => None,
            Self::Integrated(integrator) => Some(integrator),
        };
        Scene { integrator, ..scene.clone() }
    }

    fn plant(self, scene: &Scene) -> AnyPlant {
        let fraction = scene.actuator.latency.fract();
        AnyPlant::unsensed(&self.scene(scene), 1.0 / scene.control.rate_hz, fraction)
    }

    /// Number of additions and multiplications in one step of a linear plant with `states` states. For the exact
    /// method, a step is a whole sample. Operations of non-linear elements are not included.
    pub fn operations(self, states: usize) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "2 to 7")]
        let n = states as f64;
        let rate = n * (2.0 * n + 1.0) + 2.0;
        match self {
            Self::Exact => n * (2.0 * n + 1.0),
            Self::Integrated(Integrator::SemiImplicitEuler { .. }) => rate + 2.0 * n + n,
            Self::Integrated(Integrator::Rk4 { .. }) => 4.0 * rate + 3.0 * 2.0 * n + 6.0 * n,
            Self::Integrated(Integrator::DormandPrince { .. }) => {
                // Seven rates, 21 + 7 weights, six stage ends, and the ratio of error to tolerance.
                7.0 * rate + 2.0 * n * (21.0 + 7.0 + 6.0) + 5.0 * n
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantMeasured {
    /// Largest distance from the reference's position, in m.
    pub trajectory_m: f64,
    /// Number of verdicts that differ from the verdicts of the reference.
    pub verdicts_wrong: usize,
    /// Mean area, in N^2 s/m^2.
    pub area: f64,
    /// Relative difference of the area from the area of the reference.
    pub area_change: f64,
    /// Number of tried steps per sample. It is one for the exact step.
    pub steps_per_sample: f64,
    /// Additions and multiplications per simulated second.
    pub operations_per_s: f64,
    /// Time of the plant on this machine, in ns per sample.
    pub host_ns: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct PlantRow {
    pub method: Method,
    /// The values, or the reason why the method is refused.
    pub measured: Result<PlantMeasured, String>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Plants {
    /// One row per method. The reference is the first row.
    pub rows: Vec<PlantRow>,
    /// Cutoff of the scene's estimator in all hits, in Hz. It is 0 for an estimator without a cutoff.
    pub cutoff_hz: f64,
    /// The wall of the replayed hit: K in N/m and B in N s/m.
    pub wall: [f64; 2],
    /// Number of hits that were compared.
    pub verdicts: usize,
    /// Number of verdicts that change if the start of the reference changes by [`NUDGE_COUNTS`].
    pub verdicts_chaotic: usize,
    /// Relative change of the area if the start of the reference changes by [`NUDGE_COUNTS`].
    pub area_chaotic: f64,
}

/// The scene's estimator. If the estimator has a cutoff, the middle cutoff of the scene's sweep is used.
pub fn filter(scene: &Scene) -> VelocitySettings {
    let cutoffs = &scene.sweep.cutoffs_hz;
    scene.velocity.at(cutoffs[cutoffs.len() / 2])
}

struct Reference<'a> {
    scene: &'a Scene,
    velocity: VelocitySettings,
    stop: &'a AtomicBool,
    engine: Engine,
    hits: Vec<WallHit>,
    recorded: Recorded,
}

/// Measures all methods. `done` is called once at the start, and after each method.
///
/// # Errors
/// The handle does not reach the wall, or `stop` was set.
pub fn measure(
    engine: Engine,
    scene: &Scene,
    stop: &AtomicBool,
    done: impl Fn() + Sync,
) -> Result<Plants, Error> {
    let methods = Method::all(scene);
    let Some(&first) = methods.first() else {
        return Err(Error::Internal("no method".into()));
    };
    let velocity = filter(scene);
    let cutoff_hz = velocity.cutoff_hz().unwrap_or_default();
    let prepared = PreparedScene::new(&first.scene(scene))?;
    let fine = walk(engine, &prepared, Numeric::Fixed, velocity, 0.0, stop)?;
    let Some(peak) =
        fine.points.iter().max_by(|a, b| a.stiffness_n_per_m.total_cmp(&b.stiffness_n_per_m))
    else {
        return Err(Error::Input(format!(
            "no wall is stable at {cutoff_hz} Hz: there is no boundary to compare integrators at"
        )));
    };
    let middle = WallHit {
        velocity,
        stiffness_n_per_m: 0.5 * peak.stiffness_n_per_m,
        damping_n_s_per_m: peak.damping_n_s_per_m,
        start_offset_counts: 0.0,
    };
    let step = scene.walk.stiffness_step_n_per_m;
    let spread = (0..POINTS).map(|n| n * (fine.points.len() - 1) / (POINTS - 1));
    let beside = spread.filter_map(|n| fine.points.get(n)).flat_map(|point| {
        BESIDE.map(|steps| WallHit {
            stiffness_n_per_m: point.stiffness_n_per_m + steps * step,
            damping_n_s_per_m: point.damping_n_s_per_m,
            ..middle
        })
    });
    let hits: Vec<WallHit> = beside.filter(|hit| hit.stiffness_n_per_m > 0.0).collect();
    let recorded = Recorded::new(&prepared, &middle).map_err(Error::from)?;
    let reference = Reference { scene, velocity, stop, engine, hits, recorded };
    let ((expected, nudged), (area, area_nudged)) = rayon::join(
        || [0.0, NUDGE_COUNTS].map(|nudge| reference.verdicts(&prepared, nudge)).into(),
        || [0.0, NUDGE_COUNTS].map(|nudge| reference.area(first, nudge)).into(),
    );
    let (expected, nudged, area) = (expected?, nudged?, area?);
    let area_chaotic = area_nudged? / area - 1.0;
    done();
    // The last methods have the most steps and take longest. So these methods start first.
    let rows: Vec<Result<PlantRow, Error>> = methods
        .par_iter()
        .rev()
        .with_max_len(1)
        .map(|&method| {
            let row = reference.row(method, &expected, area);
            done();
            row
        })
        .collect();
    let mut rows: Vec<PlantRow> = rows.into_iter().rev().collect::<Result<_, _>>()?;
    for row in &mut rows {
        if let Ok(measured) = &mut row.measured {
            measured.host_ns = reference.recorded.host_ns(&row.method.plant(scene));
        }
    }
    Ok(Plants {
        rows,
        cutoff_hz,
        wall: [middle.stiffness_n_per_m, middle.damping_n_s_per_m],
        verdicts: expected.len(),
        verdicts_chaotic: differing(&expected, &nudged),
        area_chaotic,
    })
}

fn differing(a: &[Verdict], b: &[Verdict]) -> usize {
    a.iter().zip(b).filter(|(a, b)| a != b).count()
}

impl Reference<'_> {
    fn row(&self, method: Method, expected: &[Verdict], area: f64) -> Result<PlantRow, Error> {
        let prepared = match PreparedScene::new(&method.scene(self.scene)) {
            Ok(prepared) => prepared,
            Err(error @ Error::Input(_)) => {
                return Ok(PlantRow { method, measured: Err(error.to_string()) });
            }
            Err(error) => return Err(error),
        };
        let Replayed { error_m, steps, samples } = self.recorded.replay(&method.plant(self.scene));
        let states = self.scene.chain().states();
        #[expect(clippy::cast_precision_loss, reason = "below 2^53")]
        let steps_per_sample = match method {
            Method::Exact => 1.0,
            Method::Integrated(_) => steps as f64 / f64::from(samples),
        };
        let own = self.area(method, 0.0)?;
        let measured = PlantMeasured {
            trajectory_m: error_m,
            verdicts_wrong: differing(expected, &self.verdicts(&prepared, 0.0)?),
            area: own,
            area_change: own / area - 1.0,
            steps_per_sample,
            operations_per_s: method.operations(states)
                * steps_per_sample
                * self.scene.control.rate_hz,
            host_ns: f64::NAN,
        };
        Ok(PlantRow { method, measured: Ok(measured) })
    }

    fn verdicts(&self, prepared: &PreparedScene, nudge_counts: f64) -> Result<Vec<Verdict>, Error> {
        let verdict = |hit: &WallHit| {
            if self.stop.load(std::sync::atomic::Ordering::Relaxed) {
                return Err(Error::Interrupted);
            }
            let hit = WallHit { start_offset_counts: nudge_counts, ..*hit };
            match prepared.verdict(Numeric::Fixed, &hit) {
                Err(HitError::OutOfRange(_)) => Ok(Verdict::Unstable),
                other => Ok(other?),
            }
        };
        self.hits.par_iter().with_max_len(1).map(verdict).collect()
    }

    /// Mean area over all starts.
    fn area(&self, method: Method, nudge_counts: f64) -> Result<f64, Error> {
        let mut scene = method.scene(self.scene);
        scene.walk.stiffness_step_n_per_m *= COARSER;
        scene.walk.damping_step_n_s_per_m *= COARSER;
        let prepared = PreparedScene::new(&scene)?;
        let areas: Vec<f64> = (0..REPEATS)
            .into_par_iter()
            .with_max_len(1)
            .map(|repeat| {
                let start = start_offset_counts(repeat, REPEATS) + nudge_counts;
                walk(self.engine, &prepared, Numeric::Fixed, self.velocity, start, self.stop)
                    .map(|b| b.area)
            })
            .collect::<Result<_, _>>()?;
        Ok(areas.iter().sum::<f64>() / f64::from(REPEATS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    fn recorded(scene: &Scene) -> Recorded {
        let hit = WallHit {
            velocity: scene.velocity.at(1500.0),
            stiffness_n_per_m: 30_000.0,
            damping_n_s_per_m: 200.0,
            start_offset_counts: 0.0,
        };
        Recorded::new(&PreparedScene::new(scene).unwrap(), &hit).unwrap()
    }

    fn rk4(steps_per_sample: u32) -> Method {
        Method::Integrated(Integrator::Rk4 { steps_per_sample })
    }

    /// The latency is no whole number of samples, so steps are split.
    #[test]
    fn the_commands_of_a_hit_give_the_reference_the_same_hit() {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        for latency in [10.0, 7.75, 0.0] {
            scene.actuator.latency = latency;
            let replayed = recorded(&scene).replay(&Method::Exact.plant(&scene));
            assert_eq!((replayed.error_m, replayed.steps), (0.0, 0), "{latency}");
            let other = Scene {
                device: crate::scene::Device { mass_kg: 0.4161, ..scene.device },
                ..scene.clone()
            };
            let wrong = recorded(&scene).replay(&Method::Exact.plant(&other));
            assert!(wrong.error_m > 1e-6, "another plant is told apart: {wrong:?}");
        }
    }

    #[test]
    fn steps_are_counted_as_they_are_made() {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let recorded = recorded(&scene);
        for steps in [1, 5] {
            let replayed = recorded.replay(&rk4(steps).plant(&scene));
            assert_eq!(replayed.steps, u64::from(steps) * 60_000);
        }
        // An adaptive method repeats some steps. For a smaller error, the method needs more steps.
        let adaptive = |tolerance: f64| {
            let method = Method::Integrated(Integrator::DormandPrince {
                relative_tolerance: tolerance,
                absolute_tolerance_m: 1e-6 * tolerance,
            });
            let mut stiff = scene.clone();
            stiff.mode = Some(crate::scene::element::Mode {
                mass_kg: 0.02,
                stiffness_n_per_m: 1e6,
                damping_n_s_per_m: 2.0,
            });
            self::recorded(&stiff).replay(&method.plant(&stiff))
        };
        let (loose, tight) = (adaptive(1e-3), adaptive(1e-11));
        assert!(tight.steps > 2 * loose.steps, "{loose:?} {tight:?}");
        assert!(tight.error_m < 0.1 * loose.error_m, "{loose:?} {tight:?}");
    }

    #[test]
    fn more_states_and_better_methods_cost_more() {
        let euler = Method::Integrated(Integrator::SemiImplicitEuler { steps_per_sample: 1 });
        for states in 2..7 {
            let costs = [Method::Exact, euler, rk4(1)].map(|method| method.operations(states));
            assert!(costs[0] < costs[1] && costs[1] < costs[2], "{costs:?}");
            assert!(rk4(1).operations(states + 1) > rk4(1).operations(states));
        }
        assert_eq!(Method::Exact.operations(2), 10.0, "phi: 4 products, 2 sums; gamma: 2 and 2");
    }
}
