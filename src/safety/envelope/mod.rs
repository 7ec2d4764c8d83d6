//! The envelope: the walls that the simulator predicts to be stable. There is a table for each design and output
//! period, and for each estimator with a cutoff and output period.
//!
//! The tables are part of the [device record](crate::device::record). They are valid for the device and the latency of
//! this record. At each B a table has an interval of K, because at large B a soft wall may chatter although a stiffer
//! wall is stable. A wall outside the interval is refused until the envelope is unlocked. If the estimator, cutoff and
//! period in use have no table, no wall is known to be stable. Then every wall is refused.

mod words;

use core::fmt;

use crate::{crc, velocity::EstimatorName};
use words::Rows;

/// The stable stiffnesses at one damping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Damping B of these walls, in N s/m.
    pub damping_n_s_per_m: f64,
    /// The lowest stable K, in N/m. It is 0 if the softest wall of the study is stable.
    pub stiffness_low_n_per_m: f64,
    /// The highest stable K, in N/m. It is 0 if no wall is stable.
    pub stiffness_high_n_per_m: f64,
}

/// Names a table of the envelope by estimator, cutoff, output period and design.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// Estimator of the boundary.
    pub estimator: EstimatorName,
    /// Nominal cutoff of the estimator, in Hz.
    pub cutoff_hz: f64,
    /// Samples from output to output.
    pub period: u32,
    /// Number of the [design](crate::device::designs) that equals the estimator with all of its parameters. It is 0 if
    /// there is no such design; the further parameters then have their defaults.
    pub design: u8,
}

/// The boundary for one key, from which a table is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Boundary<'a> {
    /// Key of the boundary.
    pub key: Key,
    /// The points of the table, in the order of rising B.
    pub points: &'a [Point],
}

/// All tables of a device, as words of its record. `words.rs` describes their layout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Envelope<'a> {
    /// The words of complete tables. They are already checked.
    words: &'a [u32],
}

/// Why a wall is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outside {
    /// The envelope has no table for this estimator, cutoff and output period.
    UnknownKey,
    /// B is larger than the largest B of the table.
    Damping {
        /// The largest B of the table, in N s/m.
        highest: f64,
    },
    /// K is outside the interval that is stable at this B.
    Stiffness {
        /// Lowest K that is stable, in N/m.
        lowest: f64,
        /// Largest K that is stable, in N/m.
        highest: f64,
    },
    /// No K is predicted to be stable at this B.
    NoStiffness,
    /// K or B is negative or not a number.
    NotAWall,
}

impl Outside {
    /// What is wrong, without numbers.
    pub const fn text(self) -> &'static str {
        match self {
            Self::UnknownKey => "no envelope for this device, estimator, cutoff and output period",
            Self::Damping { .. } => "beyond the envelope: b is allowed from",
            Self::Stiffness { .. } => "beyond the envelope: k at this b is allowed from",
            Self::NoStiffness => "beyond the envelope: no k is allowed at this b",
            Self::NotAWall => "k and b must be numbers from 0",
        }
    }

    /// The lowest and the highest allowed value.
    pub const fn allowed(self) -> Option<[f64; 2]> {
        match self {
            Self::Damping { highest } => Some([0.0, highest]),
            Self::Stiffness { lowest, highest } => Some([lowest, highest]),
            Self::UnknownKey | Self::NoStiffness | Self::NotAWall => None,
        }
    }
}

impl fmt::Display for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.allowed() {
            Some([low, high]) => write!(f, "{} {low} to {high}", self.text()),
            None => f.write_str(self.text()),
        }
    }
}

/// Two cutoffs with a smaller relative difference count as equal. Both come from decimal numbers, so they may differ by
/// rounding.
const SAME: f64 = 1e-9;

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME * a.abs().max(b.abs())
}

impl<'a> Envelope<'a> {
    /// An envelope without tables, in which every wall is refused.
    pub const EMPTY: Self = Self { words: &[] };

    /// Hash of the words. Other words almost certainly have another hash.
    pub fn hash(&self) -> u32 {
        crc::of_words(self.words)
    }

    /// Checks that the wall with K = `k` N/m and B = `b` N s/m is predicted to be stable.
    ///
    /// Between two points of the table, a K is allowed if both points allow it. No line is drawn between the points. If
    /// B is below the B of the first point, the limit is a straight line. This line goes from K = 0, B = 0 to the
    /// highest K of the first point. The boundary is on or above this line, because K rises from at least 0 with a
    /// falling slope. If the lowest K of the first point is above 0, no wall with a smaller B is known to be stable. A
    /// wall without K and B exerts no force and is always allowed.
    ///
    /// # Errors
    /// Says which values are allowed.
    pub fn allows(&self, key: &Key, k: f64, b: f64) -> Result<(), Outside> {
        // A NaN is not >= 0.
        if !(k >= 0.0 && b >= 0.0) {
            return Err(Outside::NotAWall);
        }
        if k == 0.0 && b == 0.0 {
            return Ok(());
        }
        let (_, rows) =
            self.tables().find(|(known, _)| known.is(key)).ok_or(Outside::UnknownKey)?;
        let [lowest, highest] = interval_at(rows, b)?;
        if k >= lowest && k <= highest {
            Ok(())
        } else {
            Err(Outside::Stiffness { lowest, highest })
        }
    }

    /// Returns all tables, each as its key and its points.
    pub fn boundaries(&self) -> impl Iterator<Item = (Key, impl Iterator<Item = Point> + 'a)> {
        self.tables().map(|(key, rows)| (key, rows.points()))
    }

    /// Returns the keys of all tables that have the output period of `key`.
    pub fn beside(&self, key: &Key) -> impl Iterator<Item = Key> {
        let period = key.period;
        self.tables().map(|(key, _)| key).filter(move |known| known.period == period)
    }
}

impl Key {
    fn is(&self, other: &Self) -> bool {
        self.period == other.period
            && (self.estimator, self.design) == (other.estimator, other.design)
            && same(self.cutoff_hz, other.cutoff_hz)
    }
}

/// The lowest and the highest K that are stable at `b`.
fn interval_at(rows: Rows<'_>, b: f64) -> Result<[f64; 2], Outside> {
    let (Some(first), Some(last)) = (rows.points().next(), rows.points().last()) else {
        return Err(Outside::UnknownKey);
    };
    if b > last.damping_n_s_per_m {
        return Err(Outside::Damping { highest: last.damping_n_s_per_m });
    }
    let interval = if b < first.damping_n_s_per_m {
        let part = b / first.damping_n_s_per_m;
        let known = first.stiffness_low_n_per_m == 0.0;
        [0.0, if known { first.stiffness_high_n_per_m * part } else { 0.0 }]
    } else {
        let below = rows.points().take_while(|point| point.damping_n_s_per_m <= b).last();
        let above = rows.points().find(|point| point.damping_n_s_per_m >= b);
        let (Some(below), Some(above)) = (below, above) else { return Err(Outside::UnknownKey) };
        [
            f64::max(below.stiffness_low_n_per_m, above.stiffness_low_n_per_m),
            f64::min(below.stiffness_high_n_per_m, above.stiffness_high_n_per_m),
        ]
    };
    let [lowest, highest] = interval;
    if highest > 0.0 && lowest <= highest { Ok(interval) } else { Err(Outside::NoStiffness) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const fn point(b: f64, low: f64, high: f64) -> Point {
        Point { damping_n_s_per_m: b, stiffness_low_n_per_m: low, stiffness_high_n_per_m: high }
    }

    const KEY: Key =
        Key { estimator: EstimatorName::Butterworth, cutoff_hz: 1500.0, period: 10, design: 0 };

    const POINTS: [Point; 5] = [
        point(10.0, 0.0, 8000.0),
        point(20.0, 0.0, 20_000.0),
        point(30.0, 3000.0, 6000.0),
        point(40.0, 7000.0, 9000.0),
        point(50.0, 0.0, 0.0),
    ];

    /// Asks a table with these points whether it allows K and B.
    fn of(points: &[Point], key: &Key, k: f64, b: f64) -> Result<(), Outside> {
        let mut words = [0; 64];
        let words = Envelope::put(&[Boundary { key: KEY, points }], &mut words).unwrap();
        Envelope::read(words).unwrap().allows(key, k, b)
    }

    fn allows(k: f64, b: f64) -> Result<(), Outside> {
        of(&POINTS, &KEY, k, b)
    }

    #[test]
    fn points_themselves_are_allowed_and_what_both_neighbours_allow_between_them() {
        for (b, lowest, highest) in [
            (10.0, 0.0, 8000.0),
            (10.1, 0.0, 8000.0),
            (19.9, 0.0, 8000.0),
            (20.0, 0.0, 20_000.0),
            (20.1, 3000.0, 6000.0),
            (30.0, 3000.0, 6000.0),
            (40.0, 7000.0, 9000.0),
            (5.0, 0.0, 4000.0),
        ] {
            let outside = Outside::Stiffness { lowest, highest };
            assert_eq!(allows(highest, b), Ok(()), "{b}");
            assert_eq!(allows(lowest, b), Ok(()), "{b}");
            assert_eq!(allows(highest + 0.5, b), Err(outside), "{b}");
            if lowest > 0.0 {
                assert_eq!(allows(lowest - 0.5, b), Err(outside), "{b}");
            }
        }
        assert_eq!(allows(0.0, 50.1), Err(Outside::Damping { highest: 50.0 }));
        // The cases are: two neighbouring points that have no K in common, a point without any stable K, and a wall
        // without B.
        for (k, b) in [(6500.0, 35.0), (0.0, 50.0), (1.0, 45.0), (1.0, 0.0)] {
            assert_eq!(allows(k, b), Err(Outside::NoStiffness), "{b}");
        }
        assert_eq!(allows(0.0, 0.0), Ok(()));
    }

    #[test]
    fn below_a_first_point_with_a_lowest_k_nothing_is_known() {
        let points = [point(10.0, 500.0, 8000.0)];
        assert_eq!(of(&points, &KEY, 100.0, 5.0), Err(Outside::NoStiffness));
        assert_eq!(of(&points, &KEY, 600.0, 10.0), Ok(()));
    }

    #[test]
    fn every_part_of_the_key_counts() {
        let others = [
            Key { estimator: EstimatorName::ButterworthPrewarped, ..KEY },
            Key { cutoff_hz: 1500.1, ..KEY },
            Key { period: 1, ..KEY },
            Key { design: 1, ..KEY },
            Key { cutoff_hz: f64::NAN, ..KEY },
        ];
        for key in others {
            assert_eq!(of(&POINTS, &key, 1.0, 10.0), Err(Outside::UnknownKey), "{key:?}");
        }
        assert_eq!(Envelope::EMPTY.allows(&KEY, 1.0, 10.0), Err(Outside::UnknownKey));
        assert_eq!(of(&[], &KEY, 1.0, 10.0), Err(Outside::UnknownKey));
    }

    #[test]
    fn a_cutoff_that_was_rounded_is_the_same() {
        for (factor, known) in [(1.0 + 5e-10, true), (1.0 - 5e-10, true), (1.0 + 5e-9, false)] {
            let key = Key { cutoff_hz: KEY.cutoff_hz * factor, ..KEY };
            assert_eq!(of(&POINTS, &key, 1.0, 10.0).is_ok(), known, "{factor}");
        }
    }

    #[test]
    fn a_refusal_says_what_is_allowed_if_anything_is() {
        use std::string::ToString;
        let highest = Outside::Stiffness { lowest: 3000.0, highest: 6000.0 };
        let said = "beyond the envelope: k at this b is allowed from 3000 to 6000";
        assert_eq!(highest.to_string(), said);
        let none = "beyond the envelope: no k is allowed at this b";
        assert_eq!(Outside::NoStiffness.to_string(), none);
    }

    #[test]
    fn what_is_no_wall_is_refused() {
        for (k, b) in [(f64::NAN, 1.0), (1.0, f64::NAN), (-1.0, 1.0), (1.0, -1.0)] {
            assert_eq!(allows(k, b), Err(Outside::NotAWall));
        }
        assert!(allows(f64::INFINITY, 10.0).is_err());
        assert!(allows(1.0, f64::INFINITY).is_err());
    }

    proptest! {
        #[test]
        fn it_never_allows_what_a_neighbour_does_not(k in 0.0..30_000.0f64, b in 10.0..60.0f64) {
            let holds = |p: &Point| {
                k >= p.stiffness_low_n_per_m && k <= p.stiffness_high_n_per_m
                    && p.stiffness_high_n_per_m > 0.0
            };
            let near = |p: &Point| (p.damping_n_s_per_m - b).abs() < 10.0;
            let expected = b <= 50.0 && POINTS.iter().filter(|p| near(p)).all(holds);
            prop_assert_eq!(allows(k, b).is_ok(), expected);
        }
    }
}
