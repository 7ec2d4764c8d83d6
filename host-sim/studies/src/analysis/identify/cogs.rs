//! Finds the pitch of cogging: the periods over the position that the missing force follows best.
//!
//! The missing force at a row is a mean over two strides, with triangular weights (see [`super::weighting`]). So a wave
//! `sin(2 pi f x)` is seen with the factor `sinc(f d)^2`, if the handle moves by d in a stride. Each f is tried: sine
//! and cosine of the position, with this factor, are fitted to the missing force by least squares. The factor of each
//! row is known, so speed and log rate may vary: a pitch that is short for one part of a record is long for another.
//! Rows at rest are left out, because friction hides the force there.

use std::f64::consts::{PI, TAU};

use super::fit::Fitted;

/// Smallest number of cogs in the travel.
const FEWEST: f64 = 2.0;
/// Largest number of cogs in the travel.
const MOST: f64 = 1000.0;
/// Number of pitches that are tried per cog in the travel.
const PER_COG: f64 = 3.0;
/// Shortest pitch, in counts.
const SHORTEST: f64 = 8.0;
/// Smallest motion in two strides of a handle that is not at rest, in counts.
const MOVES: f64 = 2.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub cogs_per_m: f64,
    /// The share of the missing force that the wave explains.
    pub share: f64,
    /// Number of independent pitches that were tried.
    pub looked_at: f64,
}

/// A row of the scan: position, motion in a stride, missing force.
struct Row {
    x: f64,
    moves: f64,
    force: f64,
}

/// Up to `count` lines of the missing force over `stride` rows. The strongest line comes first. `forces` has the missing
/// force at each fitted row of each record.
pub(super) fn strongest(
    records: &[Fitted<'_>],
    forces: &[Vec<f64>],
    (stride, unit_m): (usize, f64),
    count: usize,
) -> Vec<Line> {
    let rows = rows(records, forces, (stride, unit_m));
    let ends = rows.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), row| {
        (row.x.min(low), row.x.max(high))
    });
    let travel_m = ends.1 - ends.0;
    // Beyond this, the handle passes more than a cog in a stride in most rows.
    let slowest_m = {
        let mut moves: Vec<f64> = rows.iter().map(|row| row.moves.abs()).collect();
        moves.sort_by(f64::total_cmp);
        moves.get(moves.len() / 10).copied().unwrap_or(f64::INFINITY)
    };
    let most = (travel_m / (SHORTEST * unit_m).max(slowest_m)).min(MOST);
    if rows.len() < 100 || most.is_nan() || most <= FEWEST {
        return vec![];
    }
    let by = 1.0 / (PER_COG * travel_m);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "up to MOST")]
    let (first, end) = ((FEWEST * PER_COG) as usize, (most * PER_COG) as usize + 1);
    let shares = shares(&rows, by, first..end);
    let is_peak = |n: &usize| {
        let near = n.saturating_sub(2)..(n + 3).min(shares.len());
        near.into_iter().all(|other| shares[other] <= shares[*n])
    };
    let mut peaks: Vec<usize> = (0..shares.len()).filter(is_peak).collect();
    peaks.sort_by(|a, b| shares[*b].total_cmp(&shares[*a]));
    let line = |place: usize| Line {
        cogs_per_m: (first + place) as f64 * by,
        share: shares[place],
        looked_at: most - FEWEST,
    };
    peaks.into_iter().take(count).map(line).collect()
}

/// The rows in motion. The mean force of each direction is subtracted, because friction makes it.
fn rows(records: &[Fitted<'_>], forces: &[Vec<f64>], (stride, unit_m): (usize, f64)) -> Vec<Row> {
    let mut rows = vec![];
    for (Fitted { positions_m, first, .. }, forces) in records.iter().zip(forces) {
        let x = &positions_m[*first..];
        let inner = stride..x.len().saturating_sub(stride);
        rows.extend(inner.step_by(stride.div_ceil(4)).filter_map(|n| {
            let moves = 0.5 * (x[n + stride] - x[n - stride]);
            let moves_on = 2.0 * moves.abs() >= MOVES * unit_m;
            moves_on.then(|| Row { x: x[n], moves, force: forces[n] })
        }));
    }
    for is_up in [false, true] {
        let one_way = |row: &&mut Row| (row.moves > 0.0) == is_up;
        let (sum, number) = rows
            .iter_mut()
            .filter(one_way)
            .fold((0.0, 0.0), |(sum, number), row| (sum + row.force, number + 1.0));
        rows.iter_mut().filter(one_way).for_each(|row| row.force -= sum / number);
    }
    rows
}

/// The share of the squared force that a wave explains, for each multiple of `by` cogs per metre.
fn shares(rows: &[Row], by: f64, places: std::ops::Range<usize>) -> Vec<f64> {
    let all: f64 = rows.iter().map(|row| row.force * row.force).sum();
    let share = |place: usize| {
        let per_m = place as f64 * by;
        let [mut ss, mut sc, mut cc, mut fs, mut fc] = [0.0; 5];
        for Row { x, moves, force } in rows {
            let half = PI * per_m * moves;
            let sinc = if half == 0.0 { 1.0 } else { half.sin() / half };
            let (s, c) = (TAU * per_m * x).sin_cos();
            let (s, c) = (sinc * sinc * s, sinc * sinc * c);
            ss += s * s;
            sc += s * c;
            cc += c * c;
            fs += force * s;
            fc += force * c;
        }
        let determinant = ss * cc - sc * sc;
        let explained = (fs * fs * cc - 2.0 * fs * fc * sc + fc * fc * ss) / determinant;
        if explained.is_finite() { explained / all } else { 0.0 }
    };
    places.map(share).collect()
}
