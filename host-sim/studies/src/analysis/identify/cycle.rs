//! Finds the cycle of the encoder's error: the strongest periods of the residual over the position.
//!
//! The residual is averaged in bins of the position. Then the spectrum of these averages over the position is computed.
//! The error of an encoder is a line in this spectrum. Friction, noise and quantisation make no line. Each line is
//! compared with the median of its neighbours, so that the broad spectrum of a coloured residual is not mistaken for a
//! line. The shortest cycle is eight counts, the longest a quarter of the travel.
//!
//! If the handle passes more than half a cycle between two rows, the cycle has aliases. At varying speeds they are weaker
//! than the cycle. But in few rows another line may be as strong. So several lines are found, and the caller takes the
//! line that promises most to the fit.

use super::fit::Fitted;
use crate::numerics::fft::RealSpectrum;

/// Shortest cycle that the search finds, in bins.
const SHORTEST: usize = 8;
/// Smallest number of cycles in the travel.
const FEWEST: usize = 4;
const BINS_MAX: f64 = 1_048_576.0;
/// Number of neighbours on each side with which a line is compared.
const NEIGHBOURS: usize = 16;

/// Largest number of lines that are found.
const LINES: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub cycles_per_m: f64,
    /// Number of cycles that were examined.
    pub looked_at: f64,
}

/// Finds the strongest lines in the spectrum of `errors`, up to [`LINES`]. The strongest comes first. There is none if
/// the range of positions is too small.
pub(super) fn strongest(records: &[Fitted<'_>], (errors, unit_m): (&[f64], f64)) -> Vec<Line> {
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
    let metres = length as f64 * bin_m;
    let first = FEWEST * line;
    let end = length / SHORTEST;
    if first + 2 * line >= end {
        return vec![];
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
    let strengths: Vec<f64> = (first..end).map(over_neighbours).collect();
    let mut lines: Vec<usize> = (first..end).collect();
    lines.sort_by(|a, b| strengths[b - first].total_cmp(&strengths[a - first]));
    let is_near = |a: usize, b: usize| a.abs_diff(b) <= NEIGHBOURS * line;
    let mut taken: Vec<usize> = vec![];
    for place in lines {
        if taken.len() == LINES {
            break;
        }
        if !taken.iter().any(|other| is_near(place, *other)) {
            taken.push(place);
        }
    }
    let looked_at = (strengths.len() as f64 / line as f64).max(1.0);
    taken.into_iter().map(|place| Line { cycles_per_m: place as f64 / metres, looked_at }).collect()
}
