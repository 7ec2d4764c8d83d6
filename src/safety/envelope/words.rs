//! The tables of the envelope, as words of the device record. A boundary is one table.
//!
//! ```text
//! boundary: number of the estimator, in its upper half that of the design (0: none), cutoff (an f64, low word first),
//!           samples per output, rows,
//!           then per row, by rising B: B, lowest K, highest K, each an f32
//! ```
//! Intervals are rounded inward, so the words allow no wall that the table does not allow. A boundary is skipped if
//! this build lacks its estimator.

use super::{Boundary, Envelope, Key, Point};
use crate::velocity::EstimatorName;

/// Words before the rows of a boundary.
const HEAD: usize = 5;
/// Lowest bit of the design's number in a boundary's first word.
const DESIGN: u32 = 16;
const ROW: usize = 3;

#[derive(Clone, Copy)]
pub(super) struct Rows<'a>(&'a [[u32; ROW]]);

impl<'a> Rows<'a> {
    pub fn points(self) -> impl Iterator<Item = Point> + 'a {
        self.0.iter().map(|row| {
            let [damping_n_s_per_m, stiffness_low_n_per_m, stiffness_high_n_per_m] =
                row.map(|word| f64::from(f32::from_bits(word)));
            Point { damping_n_s_per_m, stiffness_low_n_per_m, stiffness_high_n_per_m }
        })
    }

    fn are_allowed(self) -> bool {
        let is_number = |value: f64| value.is_finite() && value >= 0.0;
        let mut last = -1.0;
        self.points().all(|point| {
            let Point { damping_n_s_per_m: b, .. } = point;
            let (low, high) = (point.stiffness_low_n_per_m, point.stiffness_high_n_per_m);
            let rises = b > last;
            last = b;
            rises && is_number(b) && is_number(low) && is_number(high) && low <= high
        })
    }
}

/// The boundary at the beginning of some words, as estimator, cutoff, period and rows. The last field are the words
/// after it.
type Split<'a> = ((u32, f64, u32, Rows<'a>), &'a [u32]);

fn split(words: &[u32]) -> Option<Split<'_>> {
    let (&[id, low, high, period, rows], rest) = words.split_first_chunk::<HEAD>()?;
    let length = usize::try_from(rows).ok()?.checked_mul(ROW)?;
    let (rows, rest) = rest.split_at_checked(length)?;
    let cutoff_hz = f64::from_bits(u64::from(low) | u64::from(high) << 32);
    Some(((id, cutoff_hz, period, Rows(rows.as_chunks().0)), rest))
}

impl<'a> Envelope<'a> {
    /// Reads the tables from these words. Returns `None` unless all are complete, and their rows are finite and in the
    /// order of rising B.
    pub fn read(words: &'a [u32]) -> Option<Self> {
        let mut rest = words;
        while !rest.is_empty() {
            let ((.., cutoff_hz, _, rows), after) = split(rest)?;
            if !cutoff_hz.is_finite() || !rows.are_allowed() {
                return None;
            }
            rest = after;
        }
        Some(Self { words })
    }

    /// Writes these boundaries to the front of `words`. Returns the written words, or `None` if there is no room.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "halves, and values that are rounded to f32"
    )]
    pub fn put<'b>(boundaries: &[Boundary<'_>], words: &'b mut [u32]) -> Option<&'b [u32]> {
        let mut length = 0;
        let mut push = |word: u32| {
            *words.get_mut(length)? = word;
            length += 1;
            Some(())
        };
        for Boundary { key, points } in boundaries {
            let bits = key.cutoff_hz.to_bits();
            let rows = u32::try_from(points.len()).ok()?;
            let id = key.estimator.id() | u32::from(key.design) << DESIGN;
            for word in [id, bits as u32, (bits >> 32) as u32, key.period, rows] {
                push(word)?;
            }
            let last = points.len().saturating_sub(1);
            for (n, point) in points.iter().enumerate() {
                let b = point.damping_n_s_per_m;
                push(if n == last { below(b) } else { b as f32 }.to_bits())?;
                let (low, high) = inward(point.stiffness_low_n_per_m, point.stiffness_high_n_per_m);
                push(low.to_bits())?;
                push(high.to_bits())?;
            }
        }
        words.get(..length)
    }

    /// Returns the boundaries whose estimator this build has.
    pub(super) fn tables(&self) -> impl Iterator<Item = (Key, Rows<'a>)> + use<'a> {
        let mut rest = self.words;
        core::iter::from_fn(move || {
            let (boundary, after) = split(rest)?;
            rest = after;
            Some(boundary)
        })
        .filter_map(|(id, cutoff_hz, period, rows)| {
            let estimator = EstimatorName::from_id(id & ((1 << DESIGN) - 1))?;
            let design = u8::try_from(id >> DESIGN).ok()?;
            Some((Key { estimator, cutoff_hz, period, design }, rows))
        })
    }
}

/// Rounds both ends of a range to the inside. If no f32 is inside, for example because both ends are equal, both become
/// the nearest f32. This is allowed, because the stiffness is known only to one step of the walk, which is far larger.
#[expect(clippy::cast_possible_truncation, reason = "rounded")]
fn inward(low: f64, high: f64) -> (f32, f32) {
    let (inside, top) = (above(low), below(high));
    if low <= high && inside > top { (high as f32, high as f32) } else { (inside, top) }
}

/// The largest f32 that is at most `value`.
#[expect(clippy::cast_possible_truncation, reason = "rounded")]
fn below(value: f64) -> f32 {
    let near = value as f32;
    if f64::from(near) > value { near.next_down() } else { near }
}

/// The smallest f32 that is at least `value`.
#[expect(clippy::cast_possible_truncation, reason = "rounded")]
fn above(value: f64) -> f32 {
    let near = value as f32;
    if f64::from(near) < value { near.next_up() } else { near }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const KEY: Key =
        Key { estimator: EstimatorName::Butterworth, cutoff_hz: 1234.567, period: 10, design: 3 };

    fn point([b, low, high]: [f64; 3]) -> Point {
        Point { damping_n_s_per_m: b, stiffness_low_n_per_m: low, stiffness_high_n_per_m: high }
    }

    #[test]
    fn what_f32_holds_comes_back_and_what_it_does_not_hold_is_rounded_inward() {
        let points = [point([10.0, 0.0, 117_000.0]), point([20.1, 0.1, 8000.1])];
        let other = Key { period: 1, ..KEY };
        let boundaries =
            [Boundary { key: KEY, points: &points }, Boundary { key: other, points: &[] }];
        let mut words = [0; 64];
        let words = Envelope::put(&boundaries, &mut words).unwrap();
        let envelope = Envelope::read(words).unwrap();
        let read: Vec<(Key, Vec<Point>)> =
            envelope.boundaries().map(|(key, points)| (key, points.collect())).collect();
        assert_eq!((read[0].0, read[1].0, read.len()), (KEY, other, 2));
        assert_eq!((read[0].1[0], read[1].1.len()), (points[0], 0));
        let Point {
            damping_n_s_per_m: b,
            stiffness_low_n_per_m: low,
            stiffness_high_n_per_m: high,
        } = read[0].1[1];
        for (made, table) in [(20.1, b), (low, 0.1), (8000.1, high)] {
            assert!(made > table && made / table < 1.0 + 1e-6, "{made} {table}");
        }
    }

    #[test]
    fn rounding_goes_inward_to_the_next_f32_and_no_farther() {
        let ulp = f64::from(f32::EPSILON);
        assert_eq!((above(1.0), below(1.0)), (1.0, 1.0));
        for part in [0.1, 0.5, 0.9] {
            let value = 1.0 + part * ulp;
            assert_eq!((above(value), below(value)), (1.0 + f32::EPSILON, 1.0), "{part}");
        }
        // If one f32 is inside, both ends become this f32, although the upper end is nearer to the next f32.
        assert_eq!(inward(1.0, 1.0 + 0.9 * ulp), (1.0, 1.0));
    }

    /// This row comes from a rotary device. It allows a single stiffness, which no f32 equals.
    #[test]
    fn a_row_of_a_single_stiffness_keeps_it() {
        let k = 13_074.827_751_962_837;
        let points = [point([39.7, 0.0, 20_000.0]), point([52.5, k, k])];
        let mut words = [0; 64];
        let boundaries = [Boundary { key: KEY, points: &points }];
        let words = Envelope::put(&boundaries, &mut words).unwrap();
        let envelope = Envelope::read(words).expect("it is a table");
        let (_, read) = envelope.boundaries().next().unwrap();
        let last = read.last().unwrap();
        assert_eq!(last.stiffness_low_n_per_m, last.stiffness_high_n_per_m);
        assert!((last.stiffness_high_n_per_m / k - 1.0).abs() < 1e-7);
    }

    #[test]
    fn words_that_are_no_table_are_refused_and_an_unknown_estimator_is_passed_over() {
        let rows = |rows: &[[f64; 3]]| {
            let points: Vec<Point> = rows.iter().copied().map(point).collect();
            let mut words = [0; 64];
            Envelope::put(&[Boundary { key: KEY, points: &points }], &mut words).unwrap().to_vec()
        };
        let whole = rows(&[[1.0, 0.0, 1.0], [2.0, 0.0, 1.0]]);
        assert!(Envelope::read(&whole).is_some());
        assert!((1..whole.len()).all(|length| Envelope::read(&whole[..length]).is_none()));
        for bad in [
            rows(&[[1.0, 0.0, 1.0], [1.0, 0.0, 1.0]]),
            rows(&[[2.0, 0.0, 1.0], [1.0, 0.0, 1.0]]),
            rows(&[[1.0, 2.0, 1.0]]),
            rows(&[[1.0, 0.0, f64::NAN]]),
            rows(&[[f64::NAN, 0.0, 1.0]]),
            rows(&[[1.0, 0.0, f64::INFINITY]]),
            rows(&[[-1.0, 0.0, 1.0]]),
        ] {
            assert!(Envelope::read(&bad).is_none(), "{bad:?}");
        }
        let mut unknown = whole.clone();
        unknown[0] = 999;
        assert_eq!(Envelope::read(&unknown).unwrap().boundaries().count(), 0);
        assert!(Envelope::put(&[Boundary { key: KEY, points: &[] }], &mut [0; HEAD - 1]).is_none());
    }

    proptest! {
        #[test]
        fn arbitrary_words_never_panic(words in proptest::collection::vec(any::<u32>(), 0..40), rows in 0..9u32) {
            let mut words = words;
            if let Some(place) = words.get_mut(4) {
                *place = rows;
            }
            if let Some(envelope) = Envelope::read(&words) {
                let _ = envelope.allows(&KEY, 1.0, 1.0);
            }
        }
    }
}
