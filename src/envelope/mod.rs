//! Which walls the simulator predicts to be stable, per device, estimator, cutoff and latency.
//!
//! The table is made when the firmware is built, from the `envelope.csv` of a sweep, by
//! `src/envelope/generate.rs`. Its points are the largest stable K at rising B, the smallest of all
//! repeats. A gain outside is refused until unlocked; so is every gain of a key that the table does
//! not have, because nothing is known about it.

#[cfg(test)]
mod generate;

use core::fmt;

/// The largest stable stiffness at one damping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// B, N s/m.
    pub damping_n_s_per_m: f64,
    /// K, N/m.
    pub stiffness_n_per_m: f64,
}

/// What a boundary holds for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key<'a> {
    /// Name of the device: that of the scene.
    pub device: &'a str,
    /// Name of the estimator, as in the table.
    pub estimator: &'a str,
    /// Nominal cutoff, Hz.
    pub cutoff_hz: f64,
    /// Latency from sample to force, samples.
    pub latency_samples: f64,
}

/// The boundary for one key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Boundary<'a> {
    /// What it holds for.
    pub key: Key<'a>,
    /// By rising B.
    pub points: &'a [Point],
}

/// All boundaries that the firmware knows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Envelope<'a> {
    /// In any order.
    pub boundaries: &'a [Boundary<'a>],
}

/// Why a wall is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outside {
    /// The table says nothing about this device, estimator, cutoff and latency.
    UnknownKey,
    /// B is beyond the last point, N s/m.
    Damping {
        /// Largest B.
        highest: f64,
    },
    /// K is above the boundary at this B, N/m.
    Stiffness {
        /// Largest K.
        highest: f64,
    },
    /// K or B is negative or not a number.
    NotAWall,
}

impl Outside {
    /// What is wrong, without the number.
    pub const fn text(self) -> &'static str {
        match self {
            Self::UnknownKey => "no envelope for this device, estimator, cutoff and latency",
            Self::Damping { .. } => "beyond the envelope: largest b",
            Self::Stiffness { .. } => "beyond the envelope: largest k at this b",
            Self::NotAWall => "k and b must be numbers from 0",
        }
    }

    /// The largest value that would do.
    pub const fn highest(self) -> Option<f64> {
        match self {
            Self::Damping { highest } | Self::Stiffness { highest } => Some(highest),
            Self::UnknownKey | Self::NotAWall => None,
        }
    }
}

impl fmt::Display for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.highest() {
            Some(highest) => write!(f, "{} {highest}", self.text()),
            None => f.write_str(self.text()),
        }
    }
}

/// Two cutoffs or latencies this close are the same: both come from decimal numbers.
const SAME: f64 = 1e-9;

fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME * a.abs().max(b.abs())
}

impl Envelope<'_> {
    /// A firmware that knows nothing: every wall is refused.
    pub const EMPTY: Self = Self { boundaries: &[] };

    /// Whether the wall with K = `k` N/m and B = `b` N s/m is predicted to be stable.
    ///
    /// Between two points the smaller of their K counts, never the line between them. Below the
    /// first B it is the line from K = 0 at B = 0 to the first point: there the boundary is no
    /// lower than this chord, since K grows from at least 0 by a slope that falls. A wall without K
    /// and B exerts no force and is always allowed.
    ///
    /// # Errors
    /// Says what is allowed.
    pub fn allows(&self, key: &Key<'_>, k: f64, b: f64) -> Result<(), Outside> {
        // A NaN is not at least 0.
        if !(k >= 0.0 && b >= 0.0) {
            return Err(Outside::NotAWall);
        }
        if k == 0.0 && b == 0.0 {
            return Ok(());
        }
        let boundary = self
            .boundaries
            .iter()
            .find(|boundary| boundary.key.is(key))
            .ok_or(Outside::UnknownKey)?;
        let highest = stiffness_at(boundary.points, b)?;
        if k <= highest { Ok(()) } else { Err(Outside::Stiffness { highest }) }
    }
}

impl Key<'_> {
    fn is(&self, other: &Key<'_>) -> bool {
        self.device == other.device
            && self.estimator == other.estimator
            && same(self.cutoff_hz, other.cutoff_hz)
            && same(self.latency_samples, other.latency_samples)
    }
}

/// Largest K at `b`.
fn stiffness_at(points: &[Point], b: f64) -> Result<f64, Outside> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return Err(Outside::UnknownKey);
    };
    if b > last.damping_n_s_per_m {
        return Err(Outside::Damping { highest: last.damping_n_s_per_m });
    }
    if b < first.damping_n_s_per_m {
        return Ok(first.stiffness_n_per_m * b / first.damping_n_s_per_m);
    }
    let below = points.iter().rfind(|point| point.damping_n_s_per_m <= b);
    let above = points.iter().find(|point| point.damping_n_s_per_m >= b);
    match (below, above) {
        (Some(below), Some(above)) => Ok(below.stiffness_n_per_m.min(above.stiffness_n_per_m)),
        _ => Err(Outside::UnknownKey),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const fn point(damping_n_s_per_m: f64, stiffness_n_per_m: f64) -> Point {
        Point { damping_n_s_per_m, stiffness_n_per_m }
    }

    const KEY: Key<'static> = Key {
        device: "paper-1um",
        estimator: "butterworth",
        cutoff_hz: 1500.0,
        latency_samples: 10.0,
    };

    static TABLE: Envelope<'static> = Envelope {
        boundaries: &[Boundary {
            key: KEY,
            points: &[point(10.0, 8000.0), point(20.0, 20_000.0), point(30.0, 6000.0)],
        }],
    };

    fn allows(k: f64, b: f64) -> Result<(), Outside> {
        TABLE.allows(&KEY, k, b)
    }

    #[test]
    fn points_themselves_are_allowed_and_the_lower_neighbour_counts_between_them() {
        for (b, highest) in [
            (10.0, 8000.0),
            (10.1, 8000.0),
            (19.9, 8000.0),
            (20.0, 20_000.0),
            (20.1, 6000.0),
            (30.0, 6000.0),
            (5.0, 4000.0),
        ] {
            assert_eq!(allows(highest, b), Ok(()), "{b}");
            assert_eq!(allows(highest + 0.5, b), Err(Outside::Stiffness { highest }), "{b}");
        }
        assert_eq!(allows(0.0, 30.1), Err(Outside::Damping { highest: 30.0 }));
        assert_eq!(allows(1.0, 0.0), Err(Outside::Stiffness { highest: 0.0 }));
        assert_eq!(allows(0.0, 0.0), Ok(()));
    }

    #[test]
    fn every_part_of_the_key_counts() {
        let others = [
            Key { device: "paper-2um", ..KEY },
            Key { estimator: "butterworth-prewarped", ..KEY },
            Key { cutoff_hz: 1500.1, ..KEY },
            Key { latency_samples: 9.0, ..KEY },
            Key { cutoff_hz: f64::NAN, ..KEY },
        ];
        for key in others {
            assert_eq!(TABLE.allows(&key, 1.0, 10.0), Err(Outside::UnknownKey), "{key:?}");
        }
        assert_eq!(Envelope::EMPTY.allows(&KEY, 1.0, 10.0), Err(Outside::UnknownKey));
        let empty = [Boundary { key: KEY, points: &[] }];
        let envelope = Envelope { boundaries: &empty };
        assert_eq!(envelope.allows(&KEY, 1.0, 10.0), Err(Outside::UnknownKey));
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
        fn it_never_allows_more_than_both_neighbours(k in 0.0..30_000.0f64, b in 10.0..40.0f64) {
            let [p, q, r]: [f64; 3] = [8000.0, 20_000.0, 6000.0];
            let bound = if b == 10.0 { p } else if b < 20.0 { p.min(q) }
                else if b == 20.0 { q } else if b <= 30.0 { q.min(r) } else { -1.0 };
            prop_assert_eq!(allows(k, b).is_ok(), k <= bound);
        }
    }
}
