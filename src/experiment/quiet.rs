//! The criterion for a wall that a person would call quiet. At each of [four pushes](PUSHES) three conditions must
//! hold. The handle rests within a [count](rms_limit_m). The force changes by less than people can feel. The wall
//! [stands](QuietWindow::stands): its force is K times its penetration.
//!
//! With a single push the handle can come to rest on a whole count by chance, and the force is then constant. That does
//! not happen at all of four neighbouring pushes. During a hit, motion and codes are summed up in integers. The
//! functions here are called only once, at the end of the hit.

/// Criterion of a stable wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Criterion {
    /// The RMS of the counts is below its limit, as in the paper.
    #[default]
    Rms,
    /// At each of four pushes, handle and force hardly change, and [`QuietWindow::stands`] is true.
    Quiet,
}

impl Criterion {
    /// The word that a person types.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rms => "rms",
            Self::Quiet => "quiet",
        }
    }
}

/// The four pushes of a hit, as shares of the push in the settings. They act one after another.
pub const PUSHES: [f64; 4] = [0.97, 0.99, 1.0, 1.03];
/// Largest share in [`PUSHES`].
pub const PUSH_MAX: f64 = PUSHES[3];
/// Smallest difference of two forces that people feel, as a share of the force (Weber fraction; Jones, Percept.
/// Psychophys. 45, 1989). The RMS of the force must be below this share of the push, unless another limit is set.
pub const FORCE_SHARE: f64 = 0.07;
/// Smallest limit of the RMS of the motion, in m.
const REST_M: f64 = 1e-6;
/// [`QuietWindow::stands`] allows this relative error of the penetration, or one count if that is more.
const STANDS: f64 = 0.1;

/// Limit of the motion's RMS, in m. It is a count, or 1 um at the handle if that is more.
pub fn rms_limit_m(resolution_m: f64) -> f64 {
    resolution_m.max(REST_M)
}

/// Force and wall over the window of a hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuietWindow {
    /// RMS of the force about its mean, in N.
    pub force_rms_n: f64,
    /// Mean force of the wall, in N.
    pub wall_force_n: f64,
    /// K times the mean penetration, divided by `wall_force_n`. It is 1 if the spring carries the whole load, and
    /// `None` if `wall_force_n` is 0.
    pub penetration_ratio: Option<f64>,
    /// K times one count, in N.
    pub count_n: f64,
}

/// K times the mean penetration, divided by the mean force of the wall. `None` if that force is 0.
pub fn penetration_ratio(spring_n: f64, wall_force_n: f64) -> Option<f64> {
    (wall_force_n != 0.0).then(|| spring_n / wall_force_n)
}

impl QuietWindow {
    /// Whether the mean penetration equals the wall's force divided by K. An error of a tenth is allowed, or of one
    /// count if that is more.
    pub fn stands(&self) -> bool {
        let off = STANDS.max(self.count_n / libm::fabs(self.wall_force_n));
        self.penetration_ratio.is_some_and(|ratio| libm::fabs(ratio - 1.0) <= off)
    }

    /// Whether the wall stands, and the RMS of its force is below this limit.
    pub fn is_quiet(&self, force_rms_limit_n: f64) -> bool {
        self.force_rms_n < force_rms_limit_n && self.stands()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT_REST: QuietWindow = QuietWindow {
        force_rms_n: 0.1,
        wall_force_n: 2.0,
        penetration_ratio: Some(1.0),
        count_n: 0.02,
    };

    fn at(spring_n: f64) -> QuietWindow {
        QuietWindow { penetration_ratio: penetration_ratio(spring_n, 2.0), ..AT_REST }
    }

    #[test]
    fn a_wall_stands_within_a_tenth_or_a_count() {
        for (spring_n, count_n, stands) in [
            (2.19, 0.02, true),
            (2.21, 0.02, false),
            (1.81, 0.02, true),
            (1.79, 0.02, false),
            (2.59, 0.6, true),
            (2.61, 0.6, false),
        ] {
            let window = QuietWindow { count_n, ..at(spring_n) };
            assert_eq!(window.stands(), stands, "{spring_n} {count_n}");
        }
        assert_eq!(penetration_ratio(1.0, 0.0), None);
        assert!(!QuietWindow { penetration_ratio: None, ..AT_REST }.stands());
    }

    #[test]
    fn a_quiet_wall_stands_with_a_force_below_its_limit() {
        for (window, limit_n, quiet) in
            [(AT_REST, 0.11, true), (AT_REST, 0.1, false), (at(1.0), 0.11, false)]
        {
            assert_eq!(window.is_quiet(limit_n), quiet, "{window:?} {limit_n}");
        }
    }
}
