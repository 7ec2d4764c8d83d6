//! The time at which the handle crossed the border between two counts. The path of the handle is the cubic that has the
//! positions and speeds at both ends of a sample.

/// Finds the last crossing into the count at the sample's end. Returns the time of the crossing within the sample (0 to
/// 1), and whether the crossing was upwards. Returns `None` without a crossing. Positions are in counts, speeds in
/// counts per sample.
pub fn last_edge([x0, v0]: [f64; 2], [x1, v1]: [f64; 2]) -> Option<(f64, bool)> {
    let cell = x1.floor();
    // x(t) = x0 + t (v0 + t (b + t a)), its slope v0 + 2 b t + 3 a t^2
    let moved = x1 - x0;
    let a = v0 + v1 - 2.0 * moved;
    let b = 3.0 * moved - 2.0 * v0 - v1;
    let at = |t: f64| x0 + t * (v0 + t * (b + t * a));
    let slope = |t: f64| v0 + t * (2.0 * b + t * 3.0 * a);
    // searches backwards from the end, over monotone pieces
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

/// Zeros of `v0 + 2 b t + 3 a t^2` between 0 and 1, the latest first. The last element is 0.
fn turns(v0: f64, b: f64, a: f64) -> impl Iterator<Item = f64> {
    let discriminant = b * b - 3.0 * a * v0;
    let roots = if discriminant > 0.0 {
        let q = -(b + discriminant.sqrt().copysign(b));
        let (one, two) = (q / (3.0 * a), v0 / q); // not finite if the root does not exist
        [one.max(two), one.min(two)]
    } else {
        [0.0; 2]
    };
    roots.into_iter().filter(|t| *t > 0.0 && *t < 1.0).chain([0.0])
}

/// How often a sample is halved to find a crossing. The resulting 2^-32 of a sample is much finer than the resolution
/// of an edge's age, which is 2^-16.
const HALVINGS: u32 = 32;
/// Number of parts into which [`HALVINGS`] halvings divide a sample.
const PARTS: f64 = (1u64 << HALVINGS) as f64;
/// Number of Newton steps that find a crossing. They start from the middle of the sample. Each step doubles the number
/// of correct digits.
const NEWTON_STEPS: u32 = 4;

/// Zero of a monotone function between two points at which its signs differ.
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

/// The same number as [`crossing`] from 0 to 1, in a third of the time. `None` if the number might differ from
/// [`crossing`]. The numbers are certain to agree if the function exceeds its rounding error `rounded` at the borders
/// of [`PARTS`] on both sides of the sign change.
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
            // a monotone cubic over a border, with any speed and position
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
