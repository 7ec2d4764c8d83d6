//! Lanes against the scalar loop, bit for bit, on every backend that this machine has.

use proptest::{prelude::*, sample::select};
use zwidth::{VelocitySettings, experiment::Verdict, velocity::EstimatorName};

use super::*;
use crate::{
    scene::{
        Criterion, NamedScene, PushBy, Quantisation, RmsOf, Rounding, Scene,
        element::{Amplifier, Arm, Friction, Mode},
    },
    simulation::{
        prepared::{HitError, HitReport, Numeric, PreparedScene, WallHit},
        window::Measures,
    },
};

const NUMERICS: [Numeric; 3] = [Numeric::Fixed, Numeric::F64, Numeric::F64Rounded];

fn engines() -> impl Iterator<Item = Engine> {
    let available = Backend::ALL.into_iter().filter(|backend| backend.is_available());
    std::iter::once(Engine::Core).chain(available.map(Engine::Lanes))
}

/// Hits in a list, each by the lane that is free.
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

/// To the bit: what was measured as its bits.
fn bits(outcome: &Result<Outcome, HitError>) -> Result<(Verdict, Vec<Option<u64>>), HitError> {
    outcome.clone().map(|Outcome { verdict, rms_m, measures }| {
        let of = |value: fn(&Measures) -> Option<f64>| measures.as_ref().and_then(value);
        let motion = of(|m| Some(m.rms_motion_m));
        let level = of(|m| m.sensation_db);
        let all = [rms_m, of(|m| Some(m.rms_m)), motion, of(|m| Some(m.at_limit_fraction)), level];
        (verdict, all.map(|value| value.map(f64::to_bits)).to_vec())
    })
}

/// Every engine and backend against the scalar loop. Returns how many hits stayed in their lanes on the worst of those
/// that have lanes.
fn hold(prepared: &PreparedScene, hits: &[WallHit]) -> u64 {
    let mut least = u64::MAX;
    for numeric in NUMERICS {
        for depth in [Depth::Whole, Depth::Bounded, Depth::Verdict] {
            let measures =
                |report: &HitReport| (!prepared.judge().is_plain()).then(|| report.measures());
            let scalar: Vec<_> = hits
                .iter()
                .map(|hit| match depth {
                    Depth::Whole => prepared.hit(numeric, hit, |_| {}).map(|report| Outcome {
                        verdict: report.verdict,
                        rms_m: Some(report.rms_m),
                        measures: measures(&report),
                    }),
                    // by a hit that runs to its end
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
                if engine != Engine::Core {
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

/// A short hit: the arithmetic is the same, and there are many of them.
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
                    cutoff_hz,
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

/// So short that an interpreter of another machine's instructions runs it in CI: NEON's lanes.
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
    let observer = Scene { velocity: EstimatorName::Observer.defaults().into(), ..short(paper()) };
    for mut scene in [friction, observer] {
        scene.sweep.cutoffs_hz = vec![800.0];
        let prepared = PreparedScene::new(&scene).unwrap();
        assert!(!lanes_for(&prepared, Numeric::Fixed));
        hold(&prepared, &hits);
    }
}

/// The cutoffs of a sweep have to suit the estimator.
fn with_estimator(mut scene: Scene, velocity: VelocitySettings) -> Scene {
    scene.sweep.cutoffs_hz = vec![0.1 * scene.control.rate_hz];
    Scene { velocity: velocity.into(), ..scene }
}

/// The estimators that have lanes in fixed point.
fn in_lanes() -> impl Iterator<Item = EstimatorName> {
    let all = EstimatorName::ALL.iter().copied();
    all.filter(|name| {
        let scene = with_estimator(paper(), name.defaults());
        name.sense().is_none() && lanes_for(&PreparedScene::new(&scene).unwrap(), Numeric::Fixed)
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

/// docs/batch.md names them.
const IN_LANES: [&str; 18] = [
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
    "foaw-end",
    "foaw-best",
    "levant-explicit",
    "levant-implicit",
    "kalman-2",
    "kalman-3",
    "central-difference",
    "biquad",
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

/// A handle that leaves the core's range, filters and gains at their ends: never another outcome.
#[test]
fn hits_at_the_ends_of_the_ranges_leave_their_lanes() {
    let mut scene = short(paper());
    scene.encoder.resolution_m = 1e-8;
    scene.wall.position_m = 0.001;
    scene.device.start_position_m = 0.0;
    scene.device.mass_kg = 1e-3;
    scene.device.stiffness_n_per_m = 0.0;
    scene.device.damping_n_s_per_m = 0.0;
    scene.actuator.limit_v = 1000.0;
    scene.wall_hit.push_n = 500.0;
    let prepared = PreparedScene::new(&scene).unwrap();
    let hits = grid(&[0.4, 50.0, 4990.0], &[0.0, 2000.0, 1e9], &[0.0, 10.0, 1e6]);
    assert!(hold(&prepared, &hits) < hits.len() as u64, "some left");
}

fn scenes() -> impl Strategy<Value = Scene> {
    let loops = (
        prop_oneof![Just(1u32), Just(2), Just(10), 1u32..40],
        prop_oneof![Just(0.0), Just(10.0), 0.0..45.0f64],
        prop_oneof![Just(1e4), 1e3..5e4f64],
        any::<bool>(),
        any::<bool>(),
        -7.9..-3.1f64,
    );
    let outputs = prop_oneof![
        Just(None),
        (2u32..=24).prop_map(|bits| Some(Quantisation::Dac { bits })),
        (2u32..10_000).prop_map(|steps| Some(Quantisation::Pwm { steps })),
    ];
    let estimators = prop_oneof![
        3 => select(&[EstimatorName::Butterworth, EstimatorName::ButterworthPrewarped][..]),
        1 => select(&[EstimatorName::FirstOrder, EstimatorName::FirstOrderPrewarped][..]),
        1 => Just(EstimatorName::Difference),
    ];
    let bodies = (-2.0..1.0f64, 0.0..20.0f64, 0.0..300.0f64, (0.05..1.2f64, any::<bool>()));
    let elements = (any::<bool>(), any::<bool>(), 100.0..3000.0f64);
    (loops, outputs, estimators, bodies, elements).prop_map(
        |(loops, output, velocity, (mass, damping, stiffness, push), (pole, arm, hz))| {
            let (push, by_hand) = push;
            let (period, latency, rate_hz, push_only, round, resolution) = loops;
            let mut scene = paper();
            scene.actuator.period = period;
            scene.actuator.latency = latency;
            scene.control.rate_hz = rate_hz;
            scene.wall.push_only = push_only;
            scene.encoder.rounding = if round { Rounding::Round } else { Rounding::Floor };
            scene.encoder.resolution_m = 10f64.powf(resolution);
            scene.output = output;
            scene.velocity = velocity.defaults().into();
            scene.device.mass_kg = 10f64.powf(mass);
            scene.device.damping_n_s_per_m = damping;
            scene.device.stiffness_n_per_m = stiffness;
            scene.wall_hit.push_n = push * 5.9; // beyond 1 it saturates
            scene.wall_hit.push_n = scene.wall_hit.push_n.min(5.9);
            scene.wall_hit.push_by = if by_hand { PushBy::Hand } else { PushBy::Motor };
            scene.device.rest_position_m = 0.069;
            scene.device.start_position_m = 0.0695;
            scene.wall_hit.settle_s = 0.05;
            scene.wall_hit.window_s = 0.07;
            scene.wall_hit.rms_limit_m = 15.0 * scene.encoder.resolution_m;
            scene.amplifier = pole.then_some(Amplifier { bandwidth_hz: hz });
            scene.arm = arm.then_some(Arm {
                mass_kg: 1.0,
                damping_n_s_per_m: 10.0,
                stiffness_n_per_m: 200.0,
                rest_position_m: 0.06,
                grip_damping_n_s_per_m: 20.0,
                grip_stiffness_n_per_m: 1000.0,
            });
            scene
        },
    )
}

/// An estimator with its tuning anywhere in its range.
fn tuned(name: EstimatorName, tuning: f64, scene: &Scene) -> VelocitySettings {
    let settings = name.defaults();
    let (rate_hz, noise_m) = (scene.control.rate_hz, scene.encoder.resolution_m / 12f64.sqrt());
    // The Kalman filters' u, from 0.001 to 0.95
    let u = 0.00101 * 930f64.powf(tuning);
    match settings {
        VelocitySettings::Kalman2 { .. } => {
            settings.with_tuning(2.0 * u * u / (1.0 - u) * noise_m * rate_hz.powi(2))
        }
        VelocitySettings::Kalman3 { .. } => {
            let ratio = 2.0 * u.powi(3) / ((1.0 - u) * (2.0 - u));
            settings.with_tuning(ratio * noise_m * rate_hz.powi(3))
        }
        VelocitySettings::LeastSquares1 { .. } | VelocitySettings::LeastSquares2 { .. } => {
            settings.with_tuning((2.0 * 32f64.powf(tuning)).round())
        }
        VelocitySettings::FoawEnd { .. } | VelocitySettings::FoawBest { .. } => {
            let noise = 1000.0 * (tuning * 37.0).fract().powi(6);
            settings.with_tuning((32f64.powf(tuning)).round()).with_second(noise)
        }
        VelocitySettings::LevantExplicit { .. } | VelocitySettings::LevantImplicit { .. } => {
            let unit = scene.encoder.resolution_m * rate_hz * rate_hz;
            let lambda_ratio = 0.5 + 2.5 * (tuning * 37.0).fract();
            settings.with_tuning(1.001e-6 * 9.9e9f64.powf(tuning) * unit).with_second(lambda_ratio)
        }
        VelocitySettings::Biquad { .. } => {
            let damping = 0.1 * 10f64.powf((tuning * 37.0).fract());
            settings.with_tuning(3e-3 * 30f64.powf(tuning) * rate_hz).with_second(damping)
        }
        _ => settings,
    }
}

fn walls() -> impl Strategy<Value = Vec<WallHit>> {
    let wall = (0.0..1.0f64, 0.0..6.5f64, -1.0..4.0f64, 0.0..1.0f64).prop_map(
        |(cutoff, stiffness, damping, start)| WallHit {
            cutoff_hz: cutoff, // of the range, see below
            stiffness_n_per_m: 10f64.powf(stiffness),
            damping_n_s_per_m: 10f64.powf(damping),
            start_offset_counts: start,
        },
    );
    prop::collection::vec(wall, 1..20)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn random_scenes_are_the_same_bit_for_bit(scene in scenes(), mut hits in walls()) {
        prop_assume!(scene.check().is_ok());
        let rate_hz = scene.control.rate_hz;
        for hit in &mut hits {
            // from the lowest to the highest cutoff that is accepted with and without pre-warping
            hit.cutoff_hz = rate_hz * 4e-5 * (0.379f64 / 4e-5).powf(hit.cutoff_hz);
        }
        let prepared = PreparedScene::new(&scene).unwrap();
        prop_assert!(lanes_for(&prepared, Numeric::Fixed));
        hold(&prepared, &hits);
    }

    #[test]
    fn random_scenes_of_every_estimator_are_the_same_bit_for_bit(
        scene in scenes(),
        mut hits in walls(),
        name in select(in_lanes().collect::<Vec<_>>()),
        tuning in 0.0..1.0f64,
    ) {
        let rate_hz = scene.control.rate_hz;
        let velocity = tuned(name, tuning, &scene);
        let scene = with_estimator(scene, velocity);
        prop_assume!(scene.check().is_ok());
        for hit in &mut hits {
            hit.cutoff_hz = rate_hz * 4e-5 * (0.24f64 / 4e-5).powf(hit.cutoff_hz);
        }
        let prepared = PreparedScene::new(&scene).unwrap();
        prop_assert!(lanes_for(&prepared, Numeric::Fixed));
        hold(&prepared, &hits);
    }

    #[test]
    fn every_criterion_is_the_same_bit_for_bit(
        mut scene in scenes(),
        mut hits in walls(),
        criterion in select(&[Criterion::Rms, Criterion::Unsaturated, Criterion::Felt][..]),
        (motion, told, limit) in (any::<bool>(), any::<bool>(), -2.0..2.0f64),
    ) {
        let hit = &mut scene.wall_hit;
        (hit.criterion, hit.rms_of) = (criterion, if motion { RmsOf::Motion } else { RmsOf::Counts });
        hit.rms_limit_m = scene.encoder.resolution_m * 10f64.powf(limit);
        hit.felt_limit_db = 20.0 * limit;
        hit.settle_s = 0.02;
        hit.window_s = if criterion == Criterion::Felt { 0.5 } else { 0.07 };
        prop_assume!(scene.check().is_ok());
        for hit in &mut hits {
            hit.cutoff_hz = scene.control.rate_hz * 4e-5 * (0.379f64 / 4e-5).powf(hit.cutoff_hz);
        }
        hits.truncate(6);
        let told = told.then(|| PreparedScene::told(&scene)).transpose().unwrap();
        let prepared = told.unwrap_or_else(|| PreparedScene::new(&scene).unwrap());
        prop_assert!(lanes_for(&prepared, Numeric::Fixed));
        hold(&prepared, &hits);
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
