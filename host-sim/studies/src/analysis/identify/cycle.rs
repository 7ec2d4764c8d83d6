//! Finds the cycle of the encoder's error: the strongest period of the residual over the position.
//!
//! The residual is averaged in bins of the position. Then the spectrum of these averages over the position is computed.
//! The error of an encoder is a line in this spectrum. Friction, noise and quantisation make no line. Each line is
//! compared with the median of its neighbours, so that the broad spectrum of a coloured residual is not mistaken for a
//! line. The shortest cycle is eight counts, the longest a quarter of the travel.
//!
//! If the handle passes more than half a cycle between two rows, the cycle has aliases. At a constant speed the aliases
//! are as strong as the cycle. At varying speeds they are weaker. So such a cycle is taken only if no other line is
//! nearly as strong.

use super::fit::Fitted;
use crate::numerics::fft::RealSpectrum;

/// Shortest cycle that the search finds, in bins.
const SHORTEST: usize = 8;
/// Smallest number of cycles in the travel.
const FEWEST: usize = 4;
/// Largest number of bins, in a search of long cycles and of all.
const BINS_MAX: [f64; 2] = [65_536.0, 1_048_576.0];
/// Number of neighbours on each side with which a line is compared.
const NEIGHBOURS: usize = 16;
/// Smallest strength of a cycle that can have aliases, divided by the strength of the next line.
const CLEARER: f64 = 2.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub cycles_per_m: f64,
    /// Number of cycles that were examined.
    pub looked_at: f64,
    /// Power of the line divided by the median power of its neighbours.
    pub strength: f64,
}

/// Cycles that a search can find.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Cycles {
    /// Only this one, in m.
    Known(f64),
    /// Those without aliases.
    Long,
    All,
}

/// Finds the strongest line in the spectrum of `errors`, or the line of a known cycle. `None` if the range of positions
/// is too small.
pub(super) fn strongest(
    records: &[Fitted<'_>],
    (errors, unit_m): (&[f64], f64),
    cycles: Cycles,
) -> Option<Line> {
    if let Cycles::Known(cycle_m) = cycles {
        return Some(Line { cycles_per_m: 1.0 / cycle_m, looked_at: 1.0, strength: f64::INFINITY });
    }
    let positions =
        || records.iter().flat_map(|fitted| fitted.positions_m[fitted.first..].iter().copied());
    let ends = positions()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    let bins_max = BINS_MAX[usize::from(cycles == Cycles::All)];
    let bin_m = unit_m.max((ends.1 - ends.0) / bins_max);
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
    let ways = records.iter().flat_map(|fitted| fitted.positions_m[fitted.first..].windows(2));
    let longest_m = ways.map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below length")]
    let without_aliases = (0.5 * metres / longest_m.max(bin_m)) as usize;
    let first = FEWEST * line;
    let last = length / SHORTEST;
    let end = if cycles == Cycles::All { last } else { last.min(without_aliases) };
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
    let strengths: Vec<f64> = (first..end).map(over_neighbours).collect();
    let strongest = |is_taken: &dyn Fn(usize) -> bool| {
        let lines = (first..end).zip(strengths.iter().copied());
        lines.filter(|(place, _)| is_taken(*place)).max_by(|(_, a), (_, b)| a.total_cmp(b))
    };
    let mut best = strongest(&|_| true)?;
    if best.0 >= without_aliases {
        let other = strongest(&|place| place.abs_diff(best.0) > NEIGHBOURS * line);
        if other.is_some_and(|(_, strength)| best.1 < CLEARER * strength) {
            best = strongest(&|place| place < without_aliases)?;
        }
    }
    Some(Line {
        cycles_per_m: best.0 as f64 / metres,
        strength: best.1,
        looked_at: (strengths.len() as f64 / line as f64).max(1.0),
    })
}
