//! Estimators on whose position the wall's spring works.

use host_sim::simulation::{
    controller::{Controller, Fixed},
    twin::{Rounding, Twin, TwinEstimator},
};
use zwidth::{
    Settings, VelocitySettings, WallSettings,
    units::{Acceleration, Force, Offset, Position},
    velocity::{EstimatorName, Senses, State},
};

use crate::estimator_bench::{DESIGN, Random};

const PLACED: [EstimatorName; 6] = [
    EstimatorName::Kalman2Position,
    EstimatorName::Kalman3Position,
    EstimatorName::FoawBestPosition,
    EstimatorName::FirstOrderPosition,
    EstimatorName::ObserverPosition,
    EstimatorName::FusionPosition,
];

/// LSB of an offset in a count.
const LSB: f64 = (1u32 << Offset::FRACTION_BITS) as f64;

fn tunings(name: EstimatorName) -> Vec<VelocitySettings> {
    let base: &[f64] = match name {
        EstimatorName::Kalman2Position => &[0.5, 20.0, 800.0],
        EstimatorName::Kalman3Position => &[1e3, 2e4, 5e6],
        EstimatorName::FoawBestPosition => &[1.0, 2.0, 16.0, 32.0],
        EstimatorName::FirstOrderPosition => &[20.0, 500.0, 4000.0],
        _ => &[10.0, 100.0, 1500.0],
    };
    base.iter().map(|tuning| name.defaults().with_tuning(*tuning)).collect()
}

/// Counts of a handle that is pushed about, and what it senses.
fn motion(seed: u64, samples: usize) -> Vec<(i32, Senses)> {
    let mut random = Random(seed);
    let (mut position, mut speed, mut pushed) = (0.3, 0.0, 0.0);
    (0..samples)
        .map(|n| {
            if n % 100 == 0 {
                pushed = if n % 700 == 0 { 0.0 } else { 0.02 * random.next() };
            }
            speed = 0.999 * speed + pushed;
            position += speed;
            let senses = Senses {
                force: Force::saturating_from_bits((random.next() * 2f64.powi(29)) as i32),
                acceleration: Acceleration::saturating_from_bits((pushed * 2f64.powi(24)) as i32),
                edge: None,
            };
            (f64::floor(position) as i32, senses)
        })
        .collect()
}

/// The list is all that there are, and each is another estimator but for its position.
#[test]
fn each_says_the_velocity_of_the_estimator_whose_position_it_adds() {
    let with = EstimatorName::ALL.iter().filter(|name| name.defaults().unplaced().is_some());
    assert_eq!(with.copied().collect::<Vec<_>>(), PLACED);
    for settings in PLACED.into_iter().flat_map(tunings) {
        let own = settings.unplaced().unwrap();
        assert!(own.unplaced().is_none());
        assert_eq!(format!("{}-position", own.name().text()), settings.name().text());
        let leads = matches!(settings, VelocitySettings::FirstOrderPosition { .. });
        let [(_, own_numbers), (_, numbers)] = [&own, &settings].map(EstimatorName::of);
        assert!(leads || own_numbers == numbers, "{settings:?}: the same parameters");
        let [with, without] = [settings, own].map(|settings| settings.build(&DESIGN).unwrap());
        let mut states = [State::at_rest(Position::default()); 2];
        let mut offsets = 0;
        for (count, senses) in motion(7, 5000) {
            let at = Position::from_counts(count);
            let velocity = with.update(&mut states[0], at, &senses);
            assert_eq!(velocity, without.update(&mut states[1], at, &senses), "{settings:?}");
            assert_eq!(without.offset(&states[1]), Offset::NONE);
            offsets += u32::from(with.offset(&states[0]) != Offset::NONE);
        }
        // a line through two samples passes through the count
        let none = match settings {
            VelocitySettings::FoawBestPosition { window_samples, .. } => window_samples == 1,
            _ => false,
        };
        assert!(none || offsets > 1000, "{settings:?}: {offsets}");
    }
}

/// As the twin has it, which keeps the position or fits the line as it is written down.
#[test]
fn the_position_is_the_twins_within_an_lsb() {
    let mut most = 0f64;
    for settings in PLACED.into_iter().flat_map(tunings) {
        let estimator = settings.build(&DESIGN).unwrap();
        let mut twin = TwinEstimator::new(&settings, &DESIGN).unwrap();
        let mut state = State::at_rest(Position::default());
        let (mut last, mut worst, mut largest) = (0, 0f64, 0f64);
        for (count, senses) in motion(3, 20_000) {
            estimator.update(&mut state, Position::from_counts(count), &senses);
            twin.update(count - last, &senses);
            last = count;
            let offset = f64::from(estimator.offset(&state).bits()) / LSB;
            worst = worst.max((offset - twin.offset()).abs());
            largest = largest.max(twin.offset().abs());
        }
        println!("{settings:?}: {:.3} LSB of at most {largest:.2} counts", worst * LSB);
        assert!(worst * LSB < 1.0, "{settings:?}: {worst}");
        most = most.max(worst * LSB);
    }
    crate::figure::figure("host/estimators/placed_lsb", most);
}

/// A handle at constant speed is where the line through its counts says: half a count ahead of what they are rounded down
/// to, but for the estimator's own error. And it is nearer to the truth than the count.
#[test]
fn the_position_is_nearer_to_the_truth_than_the_count() {
    for name in PLACED.into_iter().filter(|name| *name != EstimatorName::FirstOrderPosition) {
        // observers are told that nothing acts
        let settings = name.defaults();
        let estimator = settings.build(&DESIGN).unwrap();
        let mut state = State::at_rest(Position::default());
        let (mut off, mut off_count) = (0.0, 0.0);
        for n in 0..6000 {
            let truth = 3.4371 * f64::from(n);
            let count = truth.floor();
            estimator.update(&mut state, Position::from_counts(count as i32), &Senses::NONE);
            if n > 3000 {
                let offset = f64::from(estimator.offset(&state).bits()) / LSB;
                off += (count + offset + 0.5 - truth).powi(2);
                off_count += (count + 0.5 - truth).powi(2);
            }
        }
        let ratio = f64::sqrt(off / off_count);
        println!("{}: {ratio:.2}", name.text());
        assert!(ratio < 0.8, "{}: {ratio}", name.text());
    }
}

/// Core and twin in the loop, on the same counts: the force is the wall's on the estimated position.
#[test]
fn the_springs_force_is_that_of_the_twin() {
    let wall = WallSettings {
        position_m: -5e-3,
        stiffness_n_per_m: 100.0,
        damping_n_s_per_m: 3.0,
        push_only: false,
    };
    for name in PLACED {
        let settings = Settings { velocity: name.defaults(), wall };
        let counts = motion(11, 20_000);
        let mut core = Fixed::new(&settings, &DESIGN, Force::ZERO, 0).unwrap();
        let mut twin = Twin::new(&settings, &DESIGN, Rounding::Exact, 0.0, 0).unwrap();
        let (mut outputs, mut worst) = (0, 0f64);
        for (count, senses) in counts {
            let due = core.sample(count, &senses);
            assert_eq!(due, twin.sample(count, &senses));
            if due {
                let [a, b] = [core.render(), twin.render()].map(|output| output.force);
                worst = worst.max((a - b).abs());
                outputs += u32::from(b != 0.0 && b.abs() < 1.0);
            }
        }
        assert!(outputs > 300, "{name:?}: {outputs}");
        // an LSB or two of position and velocity
        let lsb = DESIGN.resolution_m / LSB / DESIGN.full_scale_n;
        let allowed = 4.0 * lsb * (wall.stiffness_n_per_m + wall.damping_n_s_per_m * 1e4);
        assert!(worst < allowed, "{name:?}: {worst} {allowed}");
    }
}
