//! `design` reaches the documented areas, from any seed and for every protocol.

use std::sync::atomic::AtomicBool;

use host_sim::{
    analysis::{
        compare::with_filter,
        design::{Condition, DesignStudy, Question, design},
    },
    engine::Engine,
    scene::{NamedScene, PushBy, RmsOf, Scene},
    simulation::prepared::{Numeric, PreparedScene},
    study::walk::walk,
};
use zwidth::VelocitySettings;

use crate::figure::figure;

fn scene(name: &str) -> Scene {
    NamedScene::load(name).unwrap().scene
}

fn question(
    conditions: Vec<Condition>,
    gain_peak_db: Option<f64>,
    budget: u32,
    seed: u64,
) -> Question {
    Question {
        conditions,
        gain_peak_db,
        delay_s: None,
        roughness_n: None,
        mistuned_share: None,
        sections: 1,
        budget,
        repeats: 4,
        seed,
        numeric: Numeric::Fixed,
    }
}

fn ask(
    conditions: Vec<Condition>,
    gain_peak_db: Option<f64>,
    budget: u32,
    seed: u64,
) -> DesignStudy {
    let question = question(conditions, gain_peak_db, budget, seed);
    design(Engine::lanes(), question, &AtomicBool::new(false), |_| ()).unwrap()
}

fn one(scene: Scene) -> Vec<Condition> {
    vec![Condition { name: "own".into(), scene }]
}

/// Largest area, in 10^6 N^2 s/m^2, of all filters whose gain peak is below `peak_db`.
fn below(study: &DesignStudy, peak_db: f64) -> f64 {
    let below = study.filters.iter().filter(|filter| filter.gain_peak_db <= peak_db);
    below.map(|filter| filter.area() / 1e6).fold(0.0, f64::max)
}

/// Smallest allowed area, as a fraction of the area of an independent search in `f64`. That search has another budget,
/// other starts and no fixed point.
const OF_THEIRS: f64 = 0.955;

/// The areas reach those of the independent search.
#[test]
#[ignore = "minutes: .ci/long design"]
fn the_front_holds_the_areas_of_an_independent_search() {
    for (name, wanted) in [
        ("paper-1um", [(f64::INFINITY, 125.0), (6.0, 87.0), (3.0, 66.0)]),
        ("paper-2um", [(f64::INFINITY, 101.0), (6.0, 70.5), (3.0, 56.0)]),
    ] {
        let study = ask(one(scene(name)), None, 3000, 1);
        for (peak_db, theirs) in wanted {
            let (area, least) = (below(&study, peak_db), OF_THEIRS * theirs);
            println!("{name}, motor, {peak_db} dB: {area:.1}, at least {least}");
            assert!(area >= least, "{name} {peak_db} dB: {area}");
        }
    }
    // With the coarser encoder, `design` does not reach the independent program's area of 704. docs/lab/design.md lists
    // the attempts.
    for (name, least) in [("paper-1um", OF_THEIRS * 950.0), ("paper-2um", 600.0)] {
        let mut hand = scene(name);
        hand.wall_hit.push_by = PushBy::Hand;
        let area = below(&ask(one(hand), Some(6.0), 3000, 1), 6.0);
        println!("{name}, hand, 6 dB: {area:.0}, at least {least}");
        assert!(area >= least, "{name}: {area}");
    }
}

/// A second section without delay gives a larger area than one section, in fixed point.
#[test]
#[ignore = "minutes: .ci/long design"]
fn two_sections_hold_more_than_one() {
    for (name, wanted) in [
        ("paper-1um", [(f64::INFINITY, 125.0), (6.0, 86.0), (3.0, 65.5)]),
        ("paper-2um", [(f64::INFINITY, 108.0), (6.0, 72.0), (3.0, 56.0)]),
    ] {
        let mut question = question(one(scene(name)), None, 6000, 1);
        (question.sections, question.delay_s) = (2, Some(0.0));
        let study = design(Engine::lanes(), question, &AtomicBool::new(false), |_| ()).unwrap();
        for (peak_db, least) in wanted {
            let area = below(&study, peak_db);
            println!("{name}, two sections, {peak_db} dB: {area:.1}, at least {least}");
            assert!(area >= least, "{name} {peak_db} dB: {area}");
        }
        for filter in &study.filters {
            assert!(filter.shape.led_s() > -1e-8 && filter.sections.len() == 2, "{filter:?}");
        }
    }
}

/// The true motion has a limit of 1 um. The walks have steps of 1000 N/m and 5 N s/m. Smaller steps of K find smaller
/// areas (docs/lab/design.md).
#[test]
#[ignore = "minutes: .ci/long design"]
fn quiet_walls_have_their_filter_too() {
    for (name, theirs) in [("paper-1um", 15.8), ("paper-2um", 9.9)] {
        let mut scene = scene(name);
        scene.wall_hit.rms_limit_m = 1e-6;
        scene.wall_hit.rms_of = Some(RmsOf::Motion);
        scene.walk.stiffness_start_n_per_m = 1000.0;
        scene.walk.stiffness_step_n_per_m = 1000.0;
        scene.walk.damping_start_n_s_per_m = 5.0;
        scene.walk.damping_step_n_s_per_m = 5.0;
        let (area, least) = (below(&ask(one(scene), Some(3.0), 3000, 1), 3.0), OF_THEIRS * theirs);
        println!("{name}, 1 um of the motion, 3 dB: {area:.2}, at least {least}");
        assert!(area >= least, "{name}: {area}");
    }
}

#[test]
#[ignore = "minutes: .ci/long design"]
fn ten_seeds_find_the_same_area() {
    let areas: Vec<f64> = (1..=10)
        .map(|seed| below(&ask(one(scene("paper-1um")), Some(6.0), 3000, seed), 6.0))
        .collect();
    let [low, high] = [f64::min, f64::max].map(|of| areas.iter().copied().reduce(of).unwrap());
    println!("areas {areas:.1?}: {low:.1} to {high:.1}");
    figure("host/design/seeds/spread", 100.0 * (high / low - 1.0));
    assert!(high / low < 1.02, "{areas:?}");
}

/// There are six cases: the motor or the hand pushes the handle, which is free or has the light or the heavy arm. The
/// reference is kalman-3 in the tuning of docs/lab/comparison.md.
#[test]
#[ignore = "minutes: .ci/long design"]
fn designed_for_the_worst_of_six_it_holds_in_each_what_kalman_3_does() {
    let base = scene("paper-1um");
    let mut conditions = vec![];
    for arm in [None, Some("heavy"), Some("light")] {
        for push in PushBy::ALL {
            let mut scene = base.clone();
            scene.wall_hit.push_by = push;
            scene.arm = arm.map(|name| base.named_arm(name).unwrap());
            let name = format!("{} {}", push.name(), arm.unwrap_or("free"));
            conditions.push(Condition { name, scene });
        }
    }
    let study = ask(conditions.clone(), None, 1000, 1);
    let best = &study.filters[0];
    let kalman = VelocitySettings::Kalman3 { jerk_rms_m_per_s3: 27_691.0 };
    for (condition, boundaries) in conditions.iter().zip(&best.boundaries) {
        let scene = with_filter(&condition.scene, &kalman);
        let prepared = PreparedScene::new(&scene).unwrap();
        let stop = AtomicBool::new(false);
        let area = |start| {
            let walked =
                walk(Engine::lanes(), &prepared, Numeric::Fixed, kalman, start, &stop).unwrap();
            walked.area / 4e6
        };
        let theirs: f64 = [0.0, 0.25, 0.5, 0.75].into_iter().map(area).sum();
        let ours = boundaries.area() / 1e6;
        println!("{}: {ours:.1}, kalman-3 {theirs:.1}", condition.name);
        assert!(ours >= theirs, "{}: {ours} and {theirs}", condition.name);
    }
}
