//! Tunings that a search may try. The first axis is the bandwidth. The second axis is a second parameter of the
//! estimator. Both axes go from 0 to 1.
//!
//! **First axis**: the same range of [bandwidth](super::bandwidth) for every estimator, from `LOW` to half the rate.
//! The range is shorter if the core refuses a tuning. The length of a window is rounded to a whole number.
//!
//! **Second axis**, with logarithmic scale:
//!
//! | estimator | second parameter |
//! |-----------|------------------|
//! | Levant's differentiator | lambda divided by sqrt(C), as far as the core accepts it |
//! | low-pass | quality, as far as the core accepts it |
//! | biquad | damping, 0.05 to 2 |
//! | smoothing | second pole, up to 100 times the first |
//! | adaptive windowing | noise, 1/4 to 8 counts |
//! | observer | mass, half to twice the device's |

use zwidth::{
    Design, VelocitySettings,
    velocity::{EstimatorName, Parameter, QUALITY, RATIO},
};

use super::bandwidth::bandwidth_hz;

/// Lowest bandwidth of the search, as a fraction of the sample rate. At a rate of 10 kHz the lowest bandwidth is 20 Hz.
const LOW: f64 = 2e-3;
/// An interval that contains every tuning that the core accepts.
const TUNINGS: [f64; 2] = [1e-9, 1e12];
/// Number of times that the interval [`TUNINGS`] is halved on a logarithmic scale.
const HALVINGS: u32 = 60;

/// Tunings of one estimator.
#[derive(Clone, Debug)]
pub struct Axes {
    start: VelocitySettings,
    design: Design,
    /// Whether the tuning must be a whole number, for example the length of a window.
    pub whole: bool,
    /// The tunings with the lowest and the highest bandwidth.
    pub tuning: [f64; 2],
    /// Lowest and highest bandwidth, in Hz.
    pub bandwidth_hz: [f64; 2],
    /// Whether the core refuses every tuning beyond the lower end and beyond the upper end.
    pub refused_beyond: [bool; 2],
    /// Lowest and highest value of the second parameter.
    pub second: Option<[f64; 2]>,
    /// Whether the core refuses a second parameter outside of the range [`second`](Self::second).
    pub second_refused_beyond: bool,
}

impl Axes {
    /// Axes of an estimator. The search for the ends begins at `start`, settings that the core accepts. `None` if the
    /// estimator has no tuning.
    pub fn new(start: &VelocitySettings, design: &Design, mass_kg: f64) -> Option<Self> {
        let (parameter, default) = start.tuning()?;
        let second = start.name().parameters()[1].and_then(|p| second_range(&p, mass_kg));
        let mut axes = Self {
            start: *start,
            design: *design,
            whole: parameter.is_whole(),
            tuning: [default; 2],
            bandwidth_hz: [0.0; 2],
            refused_beyond: [true; 2],
            second,
            second_refused_beyond: false,
        };
        axes.second_refused_beyond = second.is_some_and(|[low, high]| {
            let beyond = [low / 1.001, high * 1.001];
            beyond.iter().all(|&second| !axes.accepts(&start.with_second(second)))
        });
        let mut ends = TUNINGS.map(|far| axes.last_accepted(default, far));
        let mut reached = [axes.bandwidth_at(ends[0])?, axes.bandwidth_at(ends[1])?];
        if reached[0] > reached[1] {
            ends.reverse();
            reached.reverse();
        }
        (axes.tuning, axes.bandwidth_hz) = (ends, reached);
        let wanted = [LOW * design.rate_hz, 0.5 * design.rate_hz];
        axes.bandwidth_hz = [reached[0].max(wanted[0]), reached[1].min(wanted[1])];
        for (side, hz) in axes.bandwidth_hz.into_iter().enumerate() {
            axes.tuning[side] = if axes.whole {
                axes.nearest_whole(ends, hz)
            } else {
                axes.between(ends, hz).unwrap_or(ends[side])
            };
            axes.refused_beyond[side] = (axes.tuning[side] / ends[side] - 1.0).abs() < 1e-9;
        }
        Some(axes)
    }

    /// The estimator's settings at a point on the axes.
    pub fn at(&self, [along, second]: [f64; 2]) -> VelocitySettings {
        let [low, high] = self.bandwidth_hz;
        let hz = low * (high / low).powf(along);
        let tuned = self.start.with_tuning(self.tuning_of(hz));
        self.second.map_or(tuned, |[low, high]| tuned.with_second(low * (high / low).powf(second)))
    }

    /// The second parameter before the search, as a point on its axis from 0 to 1.
    pub fn start_second(&self) -> f64 {
        let (_, [_, before, ..]) = EstimatorName::of(&self.start);
        self.second.map_or(0.0, |[low, high]| (before / low).ln() / (high / low).ln())
    }

    /// Settings whose bandwidth is `factor` times the bandwidth of `settings`. Also returns the factor between the two
    /// bandwidths: if the tuning is a whole number, this factor is only near `factor`. `None` if the core refuses the
    /// tuning.
    pub fn off_by(
        &self,
        settings: &VelocitySettings,
        factor: f64,
    ) -> Option<(VelocitySettings, f64)> {
        let (_, tuning) = settings.tuning()?;
        let here = bandwidth_hz(settings, &self.design).ok()?;
        let other = if self.whole {
            let step = if (factor > 1.0) == (self.tuning[1] > self.tuning[0]) { 1.0 } else { -1.0 };
            let off = |tuning: f64| {
                let hz = self.bandwidth_at(tuning)?;
                Some((hz / here / factor).ln().abs())
            };
            let (mut other, mut least) = (tuning + step, off(tuning + step)?);
            while let Some(next) = off(other + step).filter(|next| *next < least) {
                (other, least) = (other + step, next);
            }
            other
        } else {
            let ends = TUNINGS.map(|far| self.last_accepted(tuning, far));
            self.between(ends, here * factor)?
        };
        let wrong = settings.with_tuning(other);
        let reached = bandwidth_hz(&wrong, &self.design).ok()? / here;
        Some((wrong, reached))
    }

    pub fn accepts(&self, settings: &VelocitySettings) -> bool {
        settings.build(&self.design).is_ok()
    }

    fn accepts_tuning(&self, tuning: f64) -> bool {
        self.accepts(&self.start.with_tuning(tuning))
    }

    fn bandwidth_at(&self, tuning: f64) -> Option<f64> {
        bandwidth_hz(&self.start.with_tuning(tuning), &self.design).ok()
    }

    /// Searches the accepted tuning that is nearest to `far`. The search begins at `near`, which must be accepted.
    fn last_accepted(&self, near: f64, far: f64) -> f64 {
        let nearest = |tuning: f64| if self.whole { tuning.round() } else { tuning };
        let (mut good, mut bad) = (near, far);
        for _ in 0..HALVINGS {
            let middle = (good * bad).sqrt();
            if self.accepts_tuning(nearest(middle)) { good = middle } else { bad = middle }
        }
        nearest(good)
    }

    /// The tuning with this bandwidth. If the bandwidth is beyond an end of the axis, it is the tuning at this end.
    fn tuning_of(&self, hz: f64) -> f64 {
        let [low, high] = self.bandwidth_hz;
        if hz <= low {
            return self.tuning[0];
        }
        if hz >= high {
            return self.tuning[1];
        }
        if self.whole {
            return self.nearest_whole(self.tuning, hz);
        }
        self.between(self.tuning, hz).unwrap_or(self.tuning[0])
    }

    /// The whole number in an interval whose bandwidth is nearest to `hz`.
    fn nearest_whole(&self, [one, other]: [f64; 2], hz: f64) -> f64 {
        let (mut tuning, last) = (one.min(other), one.max(other));
        let (mut nearest, mut least) = (tuning, f64::INFINITY);
        while tuning <= last {
            let off = self.bandwidth_at(tuning).map_or(f64::INFINITY, |at| (at / hz).ln().abs());
            if off < least {
                (nearest, least) = (tuning, off);
            }
            tuning += 1.0;
        }
        nearest
    }

    /// The tuning in an interval that has this bandwidth. `None` if no tuning in the interval has it.
    fn between(&self, ends: [f64; 2], hz: f64) -> Option<f64> {
        let (mut slow, mut fast) = (ends[0], ends[1]);
        if self.bandwidth_at(slow)? > hz || self.bandwidth_at(fast)? < hz {
            return None;
        }
        for _ in 0..HALVINGS {
            let middle = (slow * fast).sqrt();
            if self.bandwidth_at(middle)? < hz { slow = middle } else { fast = middle }
        }
        Some(fast)
    }
}

fn second_range(parameter: &Parameter, mass_kg: f64) -> Option<[f64; 2]> {
    match parameter.name {
        "lambda_ratio" => Some([0.5, 3.0]),
        "noise" => Some([0.25, 8.0]),
        "lead" => Some([0.1, 10.0]),
        "ratio" => Some([*RATIO.start(), 100.0]),
        "quality" => Some([*QUALITY.start(), *QUALITY.end()]),
        "damping" => Some([0.05, 2.0]),
        "mass" => Some([0.5 * mass_kg, 2.0 * mass_kg]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    fn axes(name: EstimatorName) -> Axes {
        let design = NamedScene::load("paper-1um").unwrap().scene.design();
        Axes::new(&name.defaults(), &design, 0.416).unwrap()
    }

    fn hz(axes: &Axes, settings: &VelocitySettings) -> f64 {
        bandwidth_hz(settings, &axes.design).unwrap()
    }

    #[test]
    fn every_estimator_is_searched_over_the_same_decades_as_far_as_the_core_accepts() {
        for &name in EstimatorName::ALL {
            let Some((_, _)) = name.defaults().tuning() else { continue };
            let axes = axes(name);
            let ends = [0.0, 1.0].map(|along| hz(&axes, &axes.at([along, axes.start_second()])));
            println!(
                "{}: {:?} is {ends:?} Hz, refused beyond {:?}",
                name.text(),
                axes.tuning,
                axes.refused_beyond
            );
            for (side, wanted) in [20.0, 5000.0].into_iter().enumerate() {
                let step = if axes.whole { 1.0 / axes.tuning[0] } else { 1e-3 };
                let outside = match side {
                    0 => ends[0] > (1.0 + step) * wanted,
                    _ => ends[1] < wanted,
                };
                assert!(ends[0] >= 0.999 * 20.0 && ends[1] <= 5000.0);
                // If an end of the axis is inside the search range, the core refuses the next step beyond this end.
                if outside {
                    assert!(axes.refused_beyond[side], "{name:?} {ends:?}");
                    let other = axes.tuning[1 - side];
                    let on = if axes.whole {
                        axes.tuning[side] + (axes.tuning[side] - other).signum()
                    } else {
                        axes.tuning[side] * (axes.tuning[side] / other).powf(1e-3)
                    };
                    assert!(!axes.accepts_tuning(on), "{name:?}: {on} is accepted");
                }
            }
        }
        for name in
            [EstimatorName::FoawEnd, EstimatorName::LeastSquares1, EstimatorName::TimeStamps]
        {
            assert_eq!(axes(name).tuning[1], 1.0, "{name:?}");
        }
    }

    #[test]
    fn a_tuning_is_off_by_as_much_bandwidth_whatever_its_unit() {
        for (name, tuning) in [
            (EstimatorName::Butterworth, 700.0),
            (EstimatorName::LevantExplicit, 5.0),
            (EstimatorName::Kalman3, 1e4),
            (EstimatorName::Observer, 100.0),
        ] {
            let axes = axes(name);
            let best = name.defaults().with_tuning(tuning);
            for factor in [1.0 / 1.2, 1.2] {
                let (wrong, reached) = axes.off_by(&best, factor).unwrap();
                assert!((reached / factor - 1.0).abs() < 1e-6, "{name:?}: {reached}");
                assert!((hz(&axes, &wrong) / hz(&axes, &best) / factor - 1.0).abs() < 1e-6);
            }
        }
        // The bandwidth is proportional to sqrt(C). So a bandwidth larger by 20 % needs a C larger by 44 %.
        let levant = axes(EstimatorName::LevantImplicit);
        let best = EstimatorName::LevantImplicit.defaults();
        let (wrong, _) = levant.off_by(&best, 1.2).unwrap();
        assert!((wrong.tuning().unwrap().1 / (20.0 * 1.44) - 1.0).abs() < 1e-6);
        // The wrong tuning of a window is the nearest other whole number. It is never the same number.
        let window = axes(EstimatorName::FoawEnd);
        let off = |samples: f64, factor| {
            let best = EstimatorName::FoawEnd.defaults().with_tuning(samples);
            window.off_by(&best, factor).map(|(wrong, by)| (wrong.tuning().unwrap().1, by))
        };
        assert_eq!(off(3.0, 1.2).unwrap().0, 2.0);
        assert_eq!(off(12.0, 1.2).unwrap().0, 10.0);
        assert_eq!(off(12.0, 1.0 / 1.2).unwrap().0, 14.0);
        assert!((off(2.0, 1.2).unwrap().1 - 2.0).abs() < 1e-6);
        assert_eq!(off(1.0, 1.2), None);
        // The core refuses this tuning.
        let fast = EstimatorName::TrackingLoop.defaults().with_tuning(2400.0);
        assert_eq!(axes(EstimatorName::TrackingLoop).off_by(&fast, 1.2), None);
    }
}
