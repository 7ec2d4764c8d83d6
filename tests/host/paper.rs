//! Tests the paper's results on its own device, and the effect of fixed point in comparison with the `f64` twin.

use std::sync::{OnceLock, atomic::AtomicBool};

use crate::figure::figure;
use host_sim::{
    engine::Engine,
    scene::NamedScene,
    simulation::prepared::{Numeric, PreparedScene, WallHit},
    study::{
        boundary::{Boundary, BoundaryPoint},
        sweep::{Plan, SweepResult, filters, sweep},
    },
};
use zwidth::VelocitySettings;

/// Area of one cell of the walk's grid, in N^2 s/m^2.
const CELL: f64 = 2000.0 * 10.0;
const SCENES: [&str; 2] = ["paper-1um", "paper-2um"];
const REPEATS: u32 = 4;

fn prepare(scene: &str) -> PreparedScene {
    PreparedScene::new(&NamedScene::load(scene).unwrap().scene).unwrap()
}

/// The default sweep of both scenes, computed once.
fn default_sweep(numeric: Numeric) -> &'static [SweepResult] {
    static FIXED: OnceLock<Vec<SweepResult>> = OnceLock::new();
    static EXACT: OnceLock<Vec<SweepResult>> = OnceLock::new();
    static ROUNDED: OnceLock<Vec<SweepResult>> = OnceLock::new();
    let cell = match numeric {
        Numeric::Fixed => &FIXED,
        Numeric::F64 => &EXACT,
        Numeric::F64Rounded => &ROUNDED,
    };
    cell.get_or_init(|| {
        let prepared = SCENES.map(prepare);
        let filters = [0, 1].map(|n: usize| {
            let scene = prepared[n].scene();
            filters(&scene.velocity, &scene.sweep.cutoffs_hz)
        });
        let plans = [0, 1].map(|n: usize| Plan {
            name: SCENES[n],
            prepared: &prepared[n],
            filters: &filters[n],
        });
        sweep(Engine::lanes(), &plans, numeric, REPEATS, &AtomicBool::new(false), |_| ()).unwrap()
    })
}

fn area(result: &SweepResult, cutoff_hz: f64) -> f64 {
    result.cutoffs.iter().find(|cutoff| cutoff.cutoff_hz == cutoff_hz).unwrap().boundaries.area()
}

#[test]
fn at_1_um_the_area_grows_to_2000_hz_and_hardly_beyond() {
    let result = &default_sweep(Numeric::Fixed)[0];
    let up_to_2000: Vec<f64> = result
        .cutoffs
        .iter()
        .filter(|cutoff| cutoff.cutoff_hz <= 2000.0)
        .map(|cutoff| cutoff.boundaries.area())
        .collect();
    assert!(up_to_2000.is_sorted(), "{up_to_2000:?}");
    let at_2000 = area(result, 2000.0);
    for cutoff_hz in [2500.0, 3000.0, 4000.0] {
        let gain = area(result, cutoff_hz) / at_2000 - 1.0;
        println!("1 um, {cutoff_hz} Hz against 2000 Hz: {:+.2} %", gain * 100.0);
        assert!(gain < 0.05);
    }
}

#[test]
fn at_2_um_there_is_a_broad_top_between_1200_and_1700_hz() {
    let result = &default_sweep(Numeric::Fixed)[1];
    let top = result.cutoffs.iter().map(|cutoff| cutoff.boundaries.area()).fold(0.0, f64::max);
    for cutoff in &result.cutoffs {
        let (cutoff_hz, below) = (cutoff.cutoff_hz, 1.0 - cutoff.boundaries.area() / top);
        println!("2 um, {cutoff_hz} Hz: {:.1} % below the top", below * 100.0);
        match cutoff_hz {
            1200.0..=1700.0 => assert!(below < 0.05, "{cutoff_hz}"),
            2500.0 => assert!(below >= 0.10),
            4000.0 => assert!(below >= 0.25),
            _ => assert!(below > 0.0, "the top is at {cutoff_hz} Hz"),
        }
    }
    let ideal = result.ideal.unwrap();
    assert!((1200.0..=1700.0).contains(&ideal.cutoff_hz), "{ideal:?}");
}

#[test]
fn a_coarser_encoder_never_enlarges_the_area() {
    let [fine, coarse] = default_sweep(Numeric::Fixed) else { panic!("two scenes") };
    for (fine, coarse) in fine.cutoffs.iter().zip(&coarse.cutoffs) {
        let allowed = (0.02 * fine.boundaries.area()).max(2.0 * CELL);
        let excess = coarse.boundaries.area() - fine.boundaries.area();
        assert!(excess <= allowed, "{} Hz: {excess}", fine.cutoff_hz);
    }
}

#[test]
fn fixed_point_areas_are_the_twins() {
    let (mut errors, mut count) = (0.0, 0.0);
    for (fixed, exact) in default_sweep(Numeric::Fixed).iter().zip(default_sweep(Numeric::F64)) {
        for (fixed, exact) in fixed.cutoffs.iter().zip(&exact.cutoffs) {
            let difference = (fixed.boundaries.area() - exact.boundaries.area()).abs();
            let allowed = (0.05 * exact.boundaries.area()).max(2.0 * CELL);
            assert!(difference <= allowed, "{} Hz: {difference}", exact.cutoff_hz);
            errors += difference / exact.boundaries.area();
            count += 1.0;
        }
    }
    let mean = errors / count;
    println!("mean relative error of the area: {:.3} %", mean * 100.0);
    figure("host/paper/area_error", mean);
    assert!(mean <= 0.01);
}

/// The points in which two boundaries differ. A pair has both points at the same B. If a boundary has no point there,
/// its K is 0.
fn differing(a: &Boundary, b: &Boundary) -> Vec<(BoundaryPoint, BoundaryPoint)> {
    let point = |boundary: &Boundary, n: usize, other: &Boundary| {
        boundary.points.get(n).copied().unwrap_or_else(|| BoundaryPoint {
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: other.points[n].damping_n_s_per_m,
        })
    };
    let both = (0..a.points.len().max(b.points.len())).map(|n| (point(a, n, b), point(b, n, a)));
    both.filter(|(a, b)| a != b).collect()
}

/// Whether this wall is chaotic: the exact twin gives both verdicts when the start is moved by up to 0.015 count, in
/// steps of 0.0001.
fn is_chaotic(
    prepared: &PreparedScene,
    velocity: VelocitySettings,
    start_offset_counts: f64,
    wall: BoundaryPoint,
) -> bool {
    let verdict = |n: i32| {
        let hit = WallHit {
            velocity,
            stiffness_n_per_m: wall.stiffness_n_per_m,
            damping_n_s_per_m: wall.damping_n_s_per_m,
            start_offset_counts: start_offset_counts + f64::from(n) * 1e-4,
        };
        prepared.verdict(Numeric::F64, &hit).unwrap()
    };
    let first = verdict(0);
    (1..=150).flat_map(|n| [n, -n]).any(|n| verdict(n) != first)
}

#[test]
fn up_to_200_hz_fixed_point_boundaries_are_identical_but_where_the_twin_is_chaotic() {
    let (mut walks, mut chaotic) = (0, 0);
    for (n, scene) in SCENES.into_iter().enumerate() {
        let prepared = prepare(scene);
        let low =
            |numeric| default_sweep(numeric)[n].cutoffs.iter().filter(|c| c.cutoff_hz <= 200.0);
        for (fixed, exact) in low(Numeric::Fixed).zip(low(Numeric::F64)) {
            for (repeat, (a, b)) in fixed.boundaries.iter().zip(exact.boundaries.iter()).enumerate()
            {
                walks += 1;
                let start = repeat as f64 / f64::from(REPEATS);
                for (a, b) in differing(a, b) {
                    chaotic += 1;
                    let stiffer = if a.stiffness_n_per_m > b.stiffness_n_per_m { a } else { b };
                    let excused = is_chaotic(&prepared, fixed.velocity, start, stiffer);
                    println!("{scene}, {} Hz, start {start}: {a:?} {b:?}", fixed.cutoff_hz);
                    assert!(excused, "the twin is sure of this wall");
                    assert!(fixed.cutoff_hz > 100.0, "at 50 and 100 Hz nothing is chaotic");
                }
            }
        }
    }
    println!("{walks} walks, {chaotic} points differ");
    figure("host/paper/walks_up_to_200_hz", walks);
    figure("host/paper/points_that_differ", chaotic);
    assert!(chaotic <= 1, "{chaotic}");
}

/// Fraction of the boundary's points that differ from the exact twin's points by more than one step of K.
fn share_off(numeric: Numeric) -> f64 {
    let (mut off, mut all) = (0.0, 0.0);
    for (other, exact) in default_sweep(numeric).iter().zip(default_sweep(Numeric::F64)) {
        for (other, exact) in other.cutoffs.iter().zip(&exact.cutoffs) {
            for (a, b) in other.boundaries.iter().zip(exact.boundaries.iter()) {
                all += a.points.len().max(b.points.len()) as f64;
                let far = |(a, b): &(BoundaryPoint, BoundaryPoint)| {
                    (a.stiffness_n_per_m - b.stiffness_n_per_m).abs() > 1.5 * 2000.0
                };
                off += differing(a, b).iter().filter(|pair| far(pair)).count() as f64;
            }
        }
    }
    off / all
}

#[test]
#[ignore = "two more sweeps of each scene; CI runs it"]
fn fixed_point_moves_the_chaotic_edge_hardly_more_than_rounding_the_velocity_alone() {
    const FACTOR_MAX: f64 = 1.25;
    let (fixed, rounded) = (share_off(Numeric::Fixed), share_off(Numeric::F64Rounded));
    println!(
        "more than one step off the exact twin: fixed {:.2} %, rounded twin {:.2} %, ratio {:.3}",
        fixed * 100.0,
        rounded * 100.0,
        fixed / rounded
    );
    figure("host/paper/share_off_fixed", fixed);
    figure("host/paper/share_off_rounded", rounded);
    assert!(fixed <= FACTOR_MAX * rounded);
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let prepared = prepare("paper-2um");
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let filters = filters(&prepared.scene().velocity, &[50.0, 200.0, 100.0]);
        let plan = [Plan { name: "paper-2um", prepared: &prepared, filters: &filters }];
        pool.install(|| {
            sweep(Engine::lanes(), &plan, Numeric::Fixed, 2, &AtomicBool::new(false), |_| ())
                .unwrap()
        })
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(7));
    assert_eq!(
        one[0].cutoffs.iter().map(|c| c.cutoff_hz).collect::<Vec<_>>(),
        [50.0, 100.0, 200.0]
    );
}
