//! The envelope of walls that are predicted to be stable.

use proptest::prelude::*;
use zwidth::{
    safety::envelope::{Boundary, Envelope, Key, Outside, Point},
};

use crate::any;

const KEY: Key<'static> = Key {
    device: "bench",
    estimator: "butterworth",
    cutoff_hz: 1500.0,
    latency_samples: 0.115,
    period_samples: 10.0,
};

/// Points by rising B, as a sweep writes them: whole steps, or the rounded numbers of one.
fn points() -> impl Strategy<Value = Vec<Point>> {
    let k = || (0u32..2000, prop::bool::weighted(0.5)).prop_map(|(k, whole)| {
        let k = f64::from(k);
        if whole { 100.0 * k } else { k * 77.7 / 3.0 }
    });
    prop::collection::vec((1u32..30, k(), k(), prop::bool::weighted(0.6)), 1..12).prop_map(|rows| {
        let mut b = 0.0;
        rows.into_iter()
            .map(|(step, one, other, from_0)| {
                b += f64::from(step) / 3.0;
                let low = if from_0 { 0.0 } else { f64::min(one, other) };
                Point {
                    damping_n_s_per_m: b,
                    stiffness_low_n_per_m: low,
                    stiffness_high_n_per_m: f64::max(one, other),
                }
            })
            .collect()
    })
}

/// What the page says of K and B: between two points the K that both allow, below the first the chord to it.
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
    let boundaries = [Boundary { key: KEY, points }];
    Envelope { boundaries: &boundaries }.allows(&KEY, k, b)
}

/// B and K near what decides: on a point, right beside one, or anywhere.
fn near(points: &[Point], place: usize, which: u8, part: f64) -> [f64; 2] {
    let point = points[place % points.len()];
    let k = match which % 4 {
        0 => point.stiffness_low_n_per_m,
        1 => point.stiffness_high_n_per_m,
        2 => any::between(0.0, 2e5, part),
        _ => 0.0,
    };
    let beside = |value: f64, which: u8| match which {
        0 => value.next_down().max(0.0),
        1 => value.next_up(),
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
    /// A wall is allowed where the page says so, and nowhere else, to the last bit of K and B.
    as_on_the_page(2000, (points, place, which, part) in (points(), any::<usize>(), any::<u8>(), any::part())) {
        let [k, b] = near(&points, place, which, part);
        assert_eq!(allows(&points, k, b).is_ok(), is_inside(&points, k, b), "k {k} b {b}");
        assert!(allows(&points, -1.0, b).is_err() && allows(&points, k, f64::NAN).is_err());
        let last = points[points.len() - 1].damping_n_s_per_m;
        assert!(allows(&points, k, last.next_up()).is_err());
    }
}
