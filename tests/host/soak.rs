//! Runs a day at 50 kHz. It has 4.3e9 samples, which is more than fits into 32 bits. The tests are ignored by default,
//! but CI runs them.

use std::ops::ControlFlow;

use host_sim::{
    scene::NamedScene,
    simulation::prepared::{PreparedScene, WallHit},
};
use zwidth::{
    experiment::RunningVariance,
    units::{Position, Velocity},
    velocity::{BiquadState, ButterworthDesign},
};

const RATE_HZ: f64 = 5e4;
const HOURS: u64 = 24;
/// Number of samples in an hour.
const HOUR: u64 = 3600 * 50_000;

#[test]
#[ignore = "a minute or two; CI runs it"]
fn a_day_in_contact_at_50_khz_does_not_drift() {
    let mut scene = NamedScene::load("paper-1um").unwrap().scene;
    scene.control.rate_hz = RATE_HZ;
    // One hit that never ends. The test reads the loop's state from outside.
    let prepared = PreparedScene::new(&scene).unwrap();
    let hit = WallHit {
        velocity: scene.velocity.at(1500.0),
        stiffness_n_per_m: 20_000.0,
        damping_n_s_per_m: 50.0,
        start_offset_counts: 0.0,
    };
    let mut simulation = prepared.fixed(&hit).unwrap();
    let mut hours = vec![];
    let mut number = 0;
    for _ in 0..HOURS {
        let mut scatter = RunningVariance::default();
        let ended = simulation.run(HOUR as u32, |sample| {
            number = sample.index;
            // The last ten seconds of each hour.
            if sample.index % HOUR >= HOUR - 500_000 {
                assert!(sample.position_m.is_finite());
                scatter.push(Position::from_counts(sample.count));
            }
            ControlFlow::<()>::Continue(())
        });
        assert!(ended.is_continue());
        hours.push((scatter.mean_counts(), scatter.rms_counts()));
    }
    assert_eq!(number, HOURS * HOUR - 1);
    assert!(number > u64::from(u32::MAX));
    println!("{hours:?}");
    let (mean, rms) = hours[0];
    for &(later_mean, later_rms) in &hours {
        assert!((later_mean - mean).abs() < 0.01, "{later_mean} after {mean}");
        assert!((later_rms - rms).abs() < 0.01, "{later_rms} after {rms}");
    }
}

/// At constant speed, the sum of the velocities always stays within the ripple of the counts. The reason is that the
/// filter's gain at 0 Hz is exactly one, to the last bit.
#[test]
#[ignore = "a minute; CI runs it"]
fn a_day_at_constant_speed_the_velocitys_sum_is_the_way_to_one_count() {
    let filter = ButterworthDesign::new(300.0, RATE_HZ, false).unwrap().quantise();
    let mut state = BiquadState::default();
    // The speed is no whole number of counts per sample: 0.3141592653.
    let (mut phase, mut way, mut sum) = (0u32, 0i64, 0i64);
    let (mut least, mut most) = (i64::MAX, i64::MIN);
    for n in 0..HOURS * HOUR {
        let (next, wrapped) = phase.overflowing_add(1_349_303_772);
        phase = next;
        way += i64::from(wrapped);
        let input = Velocity::saturating_from_counts(i32::from(wrapped));
        sum += i64::from(filter.update(&mut state, input).bits());
        if n > 100_000 {
            let off = sum - (way << Velocity::FRACTION_BITS);
            (least, most) = (least.min(off), most.max(off));
        }
    }
    let counts = (most - least) as f64 / f64::from(1u32 << Velocity::FRACTION_BITS);
    println!("sum of velocities less the way: within {counts:.3} counts over {way} counts");
    assert!(counts < 1.1, "{counts}");
}
