//! The envelope of the walls that are predicted to be stable.

use proptest::prelude::*;
use zwidth::{
    console::{REPLY_MAX, Reply, Text},
    safety::envelope::{Boundary, Envelope, Key, Outside, Point},
    velocity::EstimatorName,
};

use crate::{any, limits::device};

const KEY: Key = Key { estimator: EstimatorName::Butterworth, cutoff_hz: 1500.0, period: 10, design: 0 };

/// A value as a record stores it.
fn held(value: f64) -> f64 {
    f64::from(value as f32)
}

/// Draws points with rising B. As in a record, they are in whole steps or rounded.
fn points() -> impl Strategy<Value = Vec<Point>> {
    let k = || (0u32..2000, prop::bool::weighted(0.5)).prop_map(|(k, whole)| {
        let k = f64::from(k);
        held(if whole { 100.0 * k } else { k * 77.7 / 3.0 })
    });
    prop::collection::vec((1u32..30, k(), k(), prop::bool::weighted(0.6)), 1..12).prop_map(|rows| {
        let mut b = 0.0;
        rows.into_iter()
            .map(|(step, one, other, from_0)| {
                b += f64::from(step) / 3.0;
                let low = if from_0 { 0.0 } else { f64::min(one, other) };
                Point {
                    damping_n_s_per_m: held(b),
                    stiffness_low_n_per_m: low,
                    stiffness_high_n_per_m: f64::max(one, other),
                }
            })
            .collect()
    })
}

/// Whether the documentation allows K and B. Between two points, K must be allowed at both points. Below the first
/// point, K is limited by the chord to this point.
fn is_inside(points: &[Point], k: f64, b: f64) -> bool {
    if k == 0.0 && b == 0.0 {
        return true;
    }
    let holds = |point: &Point| {
        let (low, high) = (point.stiffness_low_n_per_m, point.stiffness_high_n_per_m);
        high > 0.0 && low <= k && k <= high
    };
    let first = points[0];
    if b < first.damping_n_s_per_m {
        let chord = first.stiffness_high_n_per_m * (b / first.damping_n_s_per_m);
        return first.stiffness_low_n_per_m == 0.0 && chord > 0.0 && k <= chord;
    }
    points.iter().any(|point| point.damping_n_s_per_m == b && holds(point))
        || points.windows(2).any(|pair| {
            let between = pair[0].damping_n_s_per_m < b && b < pair[1].damping_n_s_per_m;
            between && pair.iter().all(holds)
        })
}

fn allows(points: &[Point], k: f64, b: f64) -> Result<(), Outside> {
    let mut words = [0; 64];
    let words = Envelope::put(&[Boundary { key: KEY, points }], &mut words).unwrap();
    Envelope::read(words).unwrap().allows(&KEY, k, b)
}

/// Reads the limits from the two texts of an error: the text for a program, and the text for the console.
fn read(outside: &Outside) -> [[f64; 2]; 2] {
    let reply = Text::<REPLY_MAX>::of(Reply::Outside(*outside, &device(any::PAPER), KEY));
    [outside.to_string(), reply.as_str().to_owned()].map(|line| {
        let (_, range) = line.split_once("from ").unwrap();
        let range = range.split(',').next().unwrap();
        let (low, high) = range.split_once(" to ").unwrap();
        [low, high].map(|end| end.parse().unwrap())
    })
}

/// One unit in the ninth digit of the value.
fn unit(value: f64) -> f64 {
    if value == 0.0 { 1e-300 } else { 10f64.powi(value.abs().log10().floor() as i32 - 8) }
}

/// Chooses B and K on a point, next to a point, or anywhere.
fn near(points: &[Point], place: usize, which: u8, part: f64) -> [f64; 2] {
    let point = points[place % points.len()];
    let k = match which % 4 {
        0 => point.stiffness_low_n_per_m,
        1 => point.stiffness_high_n_per_m,
        2 => any::between(0.0, 2e5, part),
        _ => 0.0,
    };
    let beside = |value: f64, which: u8| match which {
        0 => value * (1.0 - 1e-12),
        1 => value * (1.0 + 1e-12),
        _ => value,
    };
    let b = match which / 4 % 4 {
        0 => part * 100.0,
        1 => part * points[0].damping_n_s_per_m,
        _ => beside(point.damping_n_s_per_m, which / 64 % 4),
    };
    [beside(k, which / 16 % 4), b]
}

crate::properties! {
    /// A wall is allowed exactly where the documentation allows this wall, up to a part in 10^12 of K and B.
    as_on_the_page(2000, (points, place, which, part) in (points(), any::<usize>(), any::<u8>(), any::part())) {
        let [k, b] = near(&points, place, which, part);
        let inside = is_inside(&points, k, b);
        // The chord is rounded.
        if inside == is_inside(&points, k * (1.0 + 1e-14), b) && inside == is_inside(&points, k * (1.0 - 1e-14), b)
            || points.iter().any(|point| k == point.stiffness_high_n_per_m && b == point.damping_n_s_per_m)
        {
            assert_eq!(allows(&points, k, b).is_ok(), inside, "k {k} b {b}");
        }
        assert!(allows(&points, -1.0, b).is_err() && allows(&points, k, f64::NAN).is_err());
        let last = points[points.len() - 1].damping_n_s_per_m;
        assert!(allows(&points, k, last * (1.0 + 1e-12)).is_err());
    }

    /// The lowest and the highest gain that an error message prints are accepted when they are typed. A gain outside
    /// these two, by one unit in the ninth digit, is refused.
    printed(2000, (points, part, more) in (points(), any::part(), 0.0..1e6f64)) {
        let last = points[points.len() - 1].damping_n_s_per_m;
        let b = any::between(0.0, last, part);
        for k in [more, 0.0, 1e7] {
            let Err(outside @ Outside::Stiffness { .. }) = allows(&points, k, b) else { continue };
            if outside.allowed().is_some_and(|[low, high]| high - low < 2.0 * unit(high)) {
                continue; // no number of nine digits may be inside
            }
            for ends in read(&outside) {
                for (typed, out) in ends.into_iter().zip([-1.0, 1.0]) {
                    assert_eq!(allows(&points, typed, b), Ok(()), "{typed} of {outside:?} at {b}");
                    let next = typed + out * unit(typed);
                    assert!(next < 0.0 || allows(&points, next, b).is_err(), "{next} of {outside:?} at {b}");
                }
            }
        }
        let Err(outside @ Outside::Damping { .. }) = allows(&points, 1.0, last * 1.5) else { panic!("b is beyond") };
        for [_, typed] in read(&outside) {
            let beyond = |b: f64| matches!(allows(&points, 1.0, b), Err(Outside::Damping { .. }));
            assert!(!beyond(typed) && beyond(typed + unit(typed)), "{typed} of {outside:?}");
        }
    }
}
