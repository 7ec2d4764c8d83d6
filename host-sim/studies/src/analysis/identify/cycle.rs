//! Finds the cycle of the encoder's error: the strongest period of the residual over the position.
//!
//! The residual is averaged in bins of the position. Then the spectrum of these averages over the position is computed.
//! The error of an encoder is a line in this spectrum. Friction, noise and quantisation make no line. Each line is
//! compared with the median of its neighbours, so that the broad spectrum of a coloured residual is not mistaken for a
//! line. The shortest cycle is eight counts, and at least twice the longest distance between successive rows, because
//! of aliasing. The longest cycle is a quarter of the travel.

use super::fit::Fitted;
use crate::numerics::fft::RealSpectrum;

/// Shortest cycle that the search finds, in bins.
const SHORTEST: usize = 8;
/// Smallest number of cycles in the travel.
const FEWEST: usize = 4;
const BINS_MAX: f64 = 65_536.0;
/// Number of neighbours on each side with which a line is compared.
const NEIGHBOURS: usize = 16;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub cycles_per_m: f64,
    /// Number of cycles that were examined.
    pub looked_at: f64,
    /// Power of the line divided by the median power of its neighbours.
    pub strength: f64,
}

/// Finds the strongest line in the spectrum of `errors`, or the line of a known cycle. `None` if the range of positions
/// is too small.
pub(super) fn strongest(
    records: &[Fitted<'_>],
    (errors, unit_m): (&[f64], f64),
    known_m: Option<f64>,
) -> Option<Line> {
    if let Some(cycle_m) = known_m {
        return Some(Line { cycles_per_m: 1.0 / cycle_m, looked_at: 1.0, strength: f64::INFINITY });
    }
    let positions =
        || records.iter().flat_map(|fitted| fitted.positions_m[fitted.first..].iter().copied());
    let ends = positions()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    let bin_m = unit_m.max((ends.1 - ends.0) / BINS_MAX);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "up to BINS_MAX")]
    let bin_of = |x: f64| ((x - ends.0) / bin_m) as usize;
    let bins = bin_of(ends.1) + 1;
    let mut sums = vec![(0.0, 0.0); bins];
    for (x, residual_m) in positions().zip(errors) {
        let (sum, rows) = &mut sums[bin_of(x)];
        (*sum, *rows) = (*sum + residual_m, *rows + 1.0);
    }
    let means: Vec<f64> =
        sums.iter().map(|(sum, rows)| if *rows > 0.0 { sum / rows } else { 0.0 }).collect();
    let spectrum = RealSpectrum::new(2 * bins);
    let length = spectrum.length();
    // Number of frequencies per cycle over the travel.
    let line = length / bins;
    let ways = records.iter().flat_map(|fitted| fitted.positions_m[fitted.first..].windows(2));
    let longest_m = ways.map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    let shortest = (2.0 * longest_m / bin_m).max(SHORTEST as f64);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below length")]
    let (first, end) = (FEWEST * line, (length as f64 / shortest) as usize);
    if first + 2 * line >= end {
        return None;
    }
    let powers = spectrum.powers(&means, 0..end);
    let over_neighbours = |place: usize| {
        let (low, high) =
            (place.saturating_sub(NEIGHBOURS * line).max(1), (place + NEIGHBOURS * line).min(end));
        let mut near = powers[low..high].to_vec();
        let middle = near.len() / 2;
        let (_, median, _) = near.select_nth_unstable_by(middle, f64::total_cmp);
        powers[place] / median.max(f64::MIN_POSITIVE)
    };
    let best = (first..end)
        .map(|place| (place, over_neighbours(place)))
        .max_by(|(_, a), (_, b)| a.total_cmp(b))?;
    let metres = length as f64 * bin_m;
    Some(Line {
        cycles_per_m: best.0 as f64 / metres,
        strength: best.1,
        looked_at: ((end - first) as f64 / line as f64).max(1.0),
    })
}
