//! Lanes compared with the scalar loop, bit for bit, on every backend of this machine.

use zwidth::{
    VelocitySettings,
    experiment::Verdict,
    velocity::{EstimatorName, Sense},
};

use super::*;
use crate::{
    scene::{
        Accelerometer, Criterion, NamedScene, PushBy, Quantisation, RmsOf, Rounding, Scene,
        element::{Amplifier, Arm, Friction, Mode},
    },
    simulation::{
        prepared::{HitError, HitReport, Numeric, PreparedScene, WallHit},
        window::Measures,
    },
};

mod random;

const NUMERICS: [Numeric; 3] = [Numeric::Fixed, Numeric::F64, Numeric::F64Rounded];

fn engines() -> impl Iterator<Item = Engine> {
    let available = Backend::ALL.into_iter().filter(|backend| backend.is_available());
    std::iter::once(Engine::Core).chain(available.map(Engine::Lanes))
}

/// A list of hits. A free lane gets the next hit of the list.
struct Listed<'a> {
    hits: &'a [WallHit],
    taken: usize,
    in_lane: Vec<usize>,
    outcomes: Vec<Option<Result<Outcome, HitError>>>,
}

impl Work for Listed<'_> {
    fn next(&mut self, lane: usize) -> Option<WallHit> {
        let hit = self.hits.get(self.taken)?;
        if self.in_lane.len() <= lane {
            self.in_lane.resize(lane + 1, 0);
        }
        self.in_lane[lane] = self.taken;
        self.taken += 1;
        Some(*hit)
    }

    fn done(&mut self, lane: usize, outcome: Result<Outcome, HitError>) {
        let place = &mut self.outcomes[self.in_lane[lane]];
        assert!(place.is_none(), "one outcome per hit");
        *place = Some(outcome);
    }
}

fn outcomes(
    engine: Engine,
    prepared: &PreparedScene,
    numeric: Numeric,
    depth: Depth,
    hits: &[WallHit],
) -> (Vec<Result<Outcome, HitError>>, Tally) {
    let mut work = Listed { hits, taken: 0, in_lane: vec![], outcomes: vec![None; hits.len()] };
    let tally = run(engine, prepared, numeric, depth, &mut work);
    (work.outcomes.into_iter().map(Option::unwrap).collect(), tally)
}

/// An outcome whose measured values are given as bits, so that they can be compared exactly.
fn bits(outcome: &Result<Outcome, HitError>) -> Result<(Verdict, Vec<Option<u64>>), HitError> {
    outcome.clone().map(|Outcome { verdict, rms_m, measures }| {
        let of = |value: fn(&Measures) -> Option<f64>| measures.as_ref().and_then(value);
        let motion = of(|m| Some(m.rms_motion_m));
        let level = of(|m| m.sensation_db);
        let (force, wall) = (of(|m| Some(m.force_rms_n)), of(|m| Some(m.wall_force_n)));
        let limit = of(|m| Some(m.at_limit_fraction));
        let ratio = of(|m| m.penetration_ratio);
        let all = [rms_m, of(|m| Some(m.rms_m)), motion, limit, level, force, wall, ratio];
        (verdict, all.map(|value| value.map(f64::to_bits)).to_vec())
    })
}

/// Calls [`hold_with`] with the scene's own filter at the cutoff of each hit.
fn hold(prepared: &PreparedScene, hits: &[WallHit]) -> u64 {
    let own = |hit: &WallHit| {
        let cutoff_hz = hit.velocity.cutoff_hz().unwrap();
        WallHit { velocity: prepared.scene().velocity.at(cutoff_hz), ..*hit }
    };
    hold_with(prepared, &hits.iter().map(own).collect::<Vec<_>>())
}

/// Compares every engine and backend with the scalar loop. Counts the hits that stayed in their lanes, and returns the
/// smallest count over the backends with lanes.
fn hold_with(prepared: &PreparedScene, hits: &[WallHit]) -> u64 {
    let mut least = u64::MAX;
    for numeric in NUMERICS {
        for depth in [Depth::Whole, Depth::Bounded, Depth::Verdict] {
            let measures =
                |report: &HitReport| (!prepared.judge().is_plain()).then_some(report.measures);
            let scalar: Vec<_> = hits
                .iter()
                .map(|hit| match depth {
                    Depth::Whole => prepared.hit(numeric, hit, |_| {}).map(|report| Outcome {
                        verdict: report.verdict,
                        rms_m: Some(report.rms_m),
                        measures: measures(&report),
                    }),
                    // the expected outcome comes from a hit that is run to its end
                    Depth::Bounded => match prepared.hit(numeric, hit, |_| {}) {
                        Err(HitError::OutOfRange(_)) => Ok(Outcome::of(Verdict::Unstable)),
                        whole => whole.map(|report| Outcome {
                            measures: measures(&report)
                                .filter(|_| report.verdict != Verdict::Unstable),
                            ..Outcome::of(report.verdict)
                        }),
                    },
                    Depth::Verdict => match prepared.verdict(numeric, hit) {
                        Err(HitError::OutOfRange(_)) => Ok(Verdict::Unstable),
                        verdict => verdict,
                    }
                    .map(Outcome::of),
                })
                .collect();
            for engine in engines() {
                let (found, tally) = outcomes(engine, prepared, numeric, depth, hits);
                for ((hit, found), expected) in hits.iter().zip(&found).zip(&scalar) {
                    let context = format!("{engine:?} {numeric:?} {depth:?} {hit:?}");
                    assert_eq!(bits(found), bits(expected), "{context}");
                }
                if engine != Engine::Core && prepared.pushes().len() == 1 {
                    assert_eq!(tally.in_lanes + tally.scalar, hits.len() as u64);
                }
                if engine != Engine::Core && lanes_for(prepared, numeric) {
                    least = least.min(tally.in_lanes);
                }
            }
        }
    }
    least
}

fn paper() -> Scene {
    NamedScene::load("paper-1um").unwrap().scene
}

/// The scene with shorter hits. The arithmetic is the same, and more hits can be tested.
fn short(mut scene: Scene) -> Scene {
    scene.device.start_position_m = scene.wall.position_m - 2e-3;
    scene.wall_hit.settle_s = 0.1003;
    scene.wall_hit.window_s = 0.1502;
    scene
}

fn grid(cutoffs_hz: &[f64], ks: &[f64], bs: &[f64]) -> Vec<WallHit> {
    let mut hits = vec![];
    for &cutoff_hz in cutoffs_hz {
        for &stiffness_n_per_m in ks {
            for &damping_n_s_per_m in bs {
                let start_offset_counts = 0.25 * (hits.len() % 4) as f64;
                hits.push(WallHit {
                    velocity: VelocitySettings::Butterworth { cutoff_hz },
                    stiffness_n_per_m,
                    damping_n_s_per_m,
                    start_offset_counts,
                });
            }
        }
    }
    hits
}

#[test]
fn whole_hits_of_the_paper_are_the_same_on_every_backend() {
    let hits = grid(&[50.0, 1500.0, 4000.0], &[2000.0, 30_000.0, 90_000.0], &[10.0, 300.0]);
    for name in ["paper-1um", "paper-2um"] {
        let prepared = PreparedScene::new(&NamedScene::load(name).unwrap().scene).unwrap();
        assert_eq!(hold(&prepared, &hits), hits.len() as u64, "all in lanes");
    }
}

/// The test has few samples, so that CI can run it in an interpreter with the instructions of another machine (NEON
/// lanes).
#[test]
fn a_few_samples_are_the_same_on_every_backend() {
    let mut scene = short(paper());
    scene.device.start_position_m = scene.wall.position_m + 1e-5;
    scene.wall_hit.settle_s = 0.004;
    scene.wall_hit.window_s = 0.008;
    let prepared = PreparedScene::new(&scene).unwrap();
    let hits = grid(&[50.0, 4000.0], &[90_000.0], &[10.0]);
    assert_eq!(hold(&prepared, &hits), hits.len() as u64, "all in lanes");
    let names: Vec<_> = engines().map(|engine| format!("{engine:?}")).collect();
    println!("{names:?}");
}

#[test]
fn linear_elements_run_in_lanes() {
    let amplifier = Some(Amplifier { bandwidth_hz: 800.0 });
    let mode = Some(Mode { mass_kg: 0.1, stiffness_n_per_m: 4e4, damping_n_s_per_m: 3.0 });
    let arm = Some(Arm {
        mass_kg: 1.1,
        damping_n_s_per_m: 10.0,
        stiffness_n_per_m: 200.0,
        rest_position_m: 0.05,
        grip_damping_n_s_per_m: 20.0,
        grip_stiffness_n_per_m: 1000.0,
    });
    let hits = grid(&[800.0, 2500.0], &[2000.0, 25_000.0], &[10.0, 80.0, 300.0]);
    for (amplifier, mode, arm) in [
        (amplifier, None, None),
        (None, mode, None),
        (amplifier, None, arm),
        (None, mode, arm),
        (amplifier, mode, arm),
    ] {
        let scene = Scene { amplifier, mode, arm, ..short(paper()) };
        let prepared = PreparedScene::new(&scene).unwrap();
        assert!(lanes_for(&prepared, Numeric::Fixed));
        assert_eq!(hold(&prepared, &hits), hits.len() as u64, "all in lanes");
    }
}

#[test]
fn what_has_no_lanes_runs_all_the_same() {
    let hits = grid(&[800.0], &[2000.0, 25_000.0], &[10.0]);
    let mut friction = short(paper());
    friction.friction =
        Some(Friction { coulomb_n: 0.05, static_n: 0.05, stribeck_speed_m_per_s: 1e-3 });
    friction.integrator =
        Some(crate::numerics::integrator::Integrator::Rk4 { steps_per_sample: 1 });
    let edges = Scene { velocity: EstimatorName::TimeStamps.defaults().into(), ..short(paper()) };
    for scene in [friction, edges] {
        let prepared = PreparedScene::new(&scene).unwrap();
        assert!(!lanes_for(&prepared, Numeric::Fixed));
        hold(&prepared, &hits);
    }
}

/// The scene with this estimator, and with a suitable cutoff in its sweep. If the estimator needs an accelerometer, the
/// scene gets one.
fn with_estimator(mut scene: Scene, velocity: VelocitySettings) -> Scene {
    scene.sweep.cutoffs_hz = vec![0.1 * scene.control.rate_hz];
    if velocity.name().sense() == Some(Sense::Acceleration) {
        scene.accelerometer.get_or_insert(ACCELEROMETER);
    }
    Scene { velocity: velocity.into(), ..scene }
}

const ACCELEROMETER: Accelerometer = Accelerometer {
    full_scale_m_per_s2: 157.0,
    resolution_m_per_s2: 0.04,
    noise_m_per_s2_per_sqrt_hz: 3e-3,
    bias_m_per_s2: 0.5,
    bandwidth_hz: Some(1600.0),
};

/// The estimators that can run in lanes in fixed point.
fn in_lanes() -> impl Iterator<Item = EstimatorName> {
    let all = EstimatorName::ALL.iter().copied();
    all.filter(|name| {
        let scene = with_estimator(paper(), name.defaults());
        let has = |scene| lanes_for(&PreparedScene::new(scene).unwrap(), Numeric::Fixed);
        scene.check().is_ok() && has(&scene)
    })
}

#[test]
fn every_estimator_with_lanes_keeps_its_hits_there() {
    let hits = grid(&[800.0, 1900.0], &[2000.0, 25_000.0, 80_000.0], &[10.0, 80.0, 300.0]);
    let names: Vec<_> = in_lanes().map(EstimatorName::text).collect();
    assert_eq!(names, IN_LANES);
    for name in in_lanes() {
        let scene = with_estimator(short(paper()), name.defaults());
        let prepared = PreparedScene::new(&scene).unwrap();
        assert_eq!(hold(&prepared, &hits), hits.len() as u64, "{}", name.text());
    }
}

#[test]
fn a_filter_of_another_form_than_the_scenes_runs_beside_the_lanes() {
    let prepared = PreparedScene::new(&short(paper())).unwrap();
    let mut hits = grid(&[800.0], &[2000.0, 25_000.0], &[10.0, 80.0]);
    let filters = [EstimatorName::Kalman2, EstimatorName::TimeStamps, EstimatorName::FirstOrder];
    for (hit, name) in hits.iter_mut().zip(filters) {
        hit.velocity = name.defaults();
    }
    assert_eq!(hold_with(&prepared, &hits), 2, "the low-passes");
}

/// Estimators that can run in lanes. docs/lab/batch.md names the estimators that cannot.
const IN_LANES: [&str; 24] = [
    "butterworth",
    "butterworth-prewarped",
    "first-order",
    "first-order-prewarped",
    "difference",
    "taylor-2",
    "taylor-3",
    "least-squares-1",
    "least-squares-2",
    "tracking-loop",
    "observer",
    "fusion",
    "foaw-end",
    "foaw-best",
    "levant-explicit",
    "levant-implicit",
    "kalman-2",
    "kalman-3",
    "second-order",
    "smoothing",
    "tracking-lead",
    "biquad",
    "biquad-2",
    "window-difference",
];

#[test]
fn a_hit_without_contact_and_one_that_is_refused_say_so() {
    let mut scene = short(paper());
    scene.wall_hit.push_n = 0.0;
    scene.device.start_position_m = 0.0;
    let prepared = PreparedScene::new(&scene).unwrap();
    let mut hits = grid(&[800.0], &[2000.0], &[10.0]);
    hits.extend(grid(&[1e9], &[2000.0], &[10.0]));
    hits.extend(grid(&[800.0], &[2000.0], &[-1.0]));
    hits.extend(grid(&[900.0], &[2000.0], &[10.0]));
    for engine in engines() {
        let (found, _) = outcomes(engine, &prepared, Numeric::Fixed, Depth::Verdict, &hits);
        assert_eq!(found[0].clone().unwrap().verdict, Verdict::NoContact);
        assert!(matches!(&found[1], Err(HitError::Settings(e)) if e.parameter == "cutoff_hz"));
        assert!(
            matches!(&found[2], Err(HitError::Settings(e)) if e.parameter == "damping_n_s_per_m")
        );
        assert_eq!(found[3].clone().unwrap().verdict, Verdict::NoContact);
    }
}

/// A scene whose handle leaves the core's range. Lanes and scalar loop must still give the same outcome.
fn at_the_ends() -> Scene {
    let mut scene = short(paper());
    scene.encoder.resolution_m = 1e-8;
    scene.wall.position_m = 0.001;
    scene.device.start_position_m = 0.0;
    scene.device.mass_kg = 1e-3;
    scene.device.stiffness_n_per_m = 0.0;
    scene.device.damping_n_s_per_m = 0.0;
    scene.actuator.limit_v = 1000.0;
    scene.wall_hit.push_n = 500.0;
    scene
}

#[test]
fn hits_at_the_ends_of_the_ranges_leave_their_lanes() {
    let prepared = PreparedScene::new(&at_the_ends()).unwrap();
    let hits = grid(&[0.4, 50.0, 4990.0], &[0.0, 2000.0, 1e9], &[0.0, 10.0, 1e6]);
    assert!(hold(&prepared, &hits) < hits.len() as u64, "some left");
}

/// Runs every estimator with slow and fast tuning. Some estimators reach their limits before the handle reaches its
/// limits.
#[test]
fn estimators_at_the_ends_of_their_ranges_leave_their_lanes() {
    let hits = grid(&[800.0], &[20.0], &[0.01, 0.05]);
    // observers cannot model a handle that is so light
    let names = in_lanes().filter(|name| name.sense().is_none());
    let ways = [(0.0, 0.5), (0.5, 0.5), (0.99, 0.5), (0.5, 5.0)];
    for (name, (tuning, push_n)) in names.flat_map(|name| ways.map(|way| (name, way))) {
        let mut scene = at_the_ends();
        scene.device.mass_kg = 0.01;
        scene.wall_hit.push_n = push_n;
        let velocity = random::tuned(name, tuning, &scene);
        let scene = with_estimator(scene, velocity);
        hold(&PreparedScene::new(&scene).unwrap(), &hits);
    }
}

#[test]
fn a_stream_is_in_order_and_ends_when_it_is_told_to() {
    use std::sync::atomic::{AtomicBool, Ordering};
    let mut scene = short(paper());
    scene.wall_hit.settle_s = 0.001;
    scene.wall_hit.window_s = 0.001;
    let prepared = PreparedScene::new(&scene).unwrap();
    let stop = AtomicBool::new(false);
    let hit = |number: u64| WallHit {
        stiffness_n_per_m: number as f64,
        ..grid(&[900.0], &[0.0], &[10.0])[0]
    };
    let mut next = 0;
    let mut take = |number, _| {
        assert_eq!(number, next);
        next += 1;
        if number == 7000 {
            stop.store(true, Ordering::Relaxed);
        }
        Ok(())
    };
    let ended = stream(
        Engine::lanes(),
        &prepared,
        Numeric::Fixed,
        Depth::Whole,
        20_000,
        hit,
        &stop,
        &mut take,
    );
    assert!(matches!(ended, Err(crate::error::Error::Interrupted)));
    assert!(next > 7000 && next < 20_000);
}
