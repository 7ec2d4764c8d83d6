//! When the handle came over the border of a count, on the cubic through positions and speeds of both ends of a sample.

/// When within the sample (0 to 1) the handle last came over a border into the cell in which it
/// ends, and whether upwards; `None` if it never left it. Position and speed of both ends, in counts
/// and samples.
pub fn last_edge([x0, v0]: [f64; 2], [x1, v1]: [f64; 2]) -> Option<(f64, bool)> {
    let cell = x1.floor();
    // x(t) = x0 + t (v0 + t (b + t a)), its slope v0 + 2 b t + 3 a t^2
    let moved = x1 - x0;
    let a = v0 + v1 - 2.0 * moved;
    let b = 3.0 * moved - 2.0 * v0 - v1;
    let at = |t: f64| x0 + t * (v0 + t * (b + t * a));
    let slope = |t: f64| v0 + t * (2.0 * b + t * 3.0 * a);
    // From the end back over pieces without a turn.
    let mut until = 1.0;
    for from in turns(v0, b, a) {
        let x = at(from);
        let border = if x < cell {
            Some((cell, true))
        } else if x >= cell + 1.0 {
            Some((cell + 1.0, false))
        } else {
            None
        };
        if let Some((border, up)) = border {
            let distance = |t: f64| at(t) - border;
            let whole = from == 0.0 && until == 1.0;
            let rounded = f64::EPSILON * (x0.abs() + 8.0 * (v0.abs() + b.abs() + a.abs()));
            let quick = whole.then(|| crossing_of_sample(distance, slope, rounded)).flatten();
            return Some((quick.unwrap_or_else(|| crossing(distance, from, until)), up));
        }
        until = from;
    }
    None
}

/// Where `v0 + 2 b t + 3 a t^2` is 0 between 0 and 1, latest first, and 0.
fn turns(v0: f64, b: f64, a: f64) -> impl Iterator<Item = f64> {
    let discriminant = b * b - 3.0 * a * v0;
    let roots = if discriminant > 0.0 {
        let q = -(b + discriminant.sqrt().copysign(b));
        let (one, two) = (q / (3.0 * a), v0 / q); // not finite if there is no such root
        [one.max(two), one.min(two)]
    } else {
        [0.0; 2]
    };
    roots.into_iter().filter(|t| *t > 0.0 && *t < 1.0).chain([0.0])
}

/// Halvings of a sample: far below the 2^-16 that an age has.
const HALVINGS: u32 = 32;
/// Parts of a sample after these halvings.
const PARTS: f64 = (1u64 << HALVINGS) as f64;
/// Steps of Newton's to the place of a crossing: from the middle they double its digits.
const NEWTON_STEPS: u32 = 4;

/// Where a monotone function is 0, between two places where it has different signs.
fn crossing(function: impl Fn(f64) -> f64, mut from: f64, mut until: f64) -> f64 {
    let rises = function(from) < 0.0;
    for _ in 0..HALVINGS {
        let middle = 0.5 * (from + until);
        if (function(middle) < 0.0) == rises {
            from = middle;
        } else {
            until = middle;
        }
    }
    until
}

/// The very number that [`crossing`] gives from 0 to 1, in a third of the time; `None` where it is not certain to be.
/// The halvings end at the border between two of [`PARTS`] where the sign changes. There is one such border if the
/// function, next but one to it, is farther from 0 than it is `rounded`: beyond, it is farther still.
fn crossing_of_sample(
    function: impl Fn(f64) -> f64,
    slope: impl Fn(f64) -> f64,
    rounded: f64,
) -> Option<f64> {
    let rises = function(0.0) < 0.0;
    let mut t = 0.5;
    for _ in 0..NEWTON_STEPS {
        t = (t - function(t) / slope(t)).clamp(0.0, 1.0);
    }
    let part = (t * PARTS).ceil();
    let [far_before, before, at, far_behind] =
        [-2.0, -1.0, 0.0, 1.0].map(|off| function((part + off) / PARTS));
    let inside = part >= 2.0 && part + 1.0 <= PARTS;
    let changes = (before < 0.0) == rises && (at < 0.0) != rises;
    let clear = far_before.abs() > rounded && far_behind.abs() > rounded;
    (inside && changes && clear).then_some(part / PARTS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    #[test]
    fn a_crossing_that_is_found_in_few_steps_is_that_of_the_halvings() {
        let mut n = 0;
        let mut next = || {
            n += 1;
            random::uniform_with_zero(7, n) - 0.5
        };
        let (mut quick, cases) = (0, 20_000);
        for _ in 0..cases {
            // a border that a cubic without turns comes over, slowly or fast, wherever the handle is
            let place = (next() * 2e5).floor();
            let speed = 10f64.powf(4.0 * next());
            let bent = [speed * next(), 0.3 * speed * next()];
            let at = |t: f64| speed * t + bent[0] * t * (t - 1.0) + bent[1] * t * t * (t - 1.0);
            let x0 = place - speed * (0.5 + next());
            let function = |t: f64| x0 + at(t) - place;
            let slope = |t: f64| speed + bent[0] * (2.0 * t - 1.0) + bent[1] * t * (3.0 * t - 2.0);
            if (function(0.0) < 0.0) == (function(1.0) < 0.0) {
                continue;
            }
            let rounded = f64::EPSILON * (x0.abs() + 30.0 * speed);
            if let Some(found) = crossing_of_sample(function, slope, rounded) {
                assert_eq!(found.to_bits(), crossing(function, 0.0, 1.0).to_bits());
                quick += 1;
            }
        }
        assert!(quick > cases / 2, "{quick}");
    }
}
