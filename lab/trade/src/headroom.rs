//! Measures the largest speed at which the filter neither wraps nor clips.

use filter_forms::Filter;

use super::{Bench, LSB_PER_COUNT, larger, reference::Reference};

/// Number of periods of the cutoff for which the handle moves before it reverses. The output is then measured for
/// `AFTER` periods. The overshoot comes 0.7 periods after the reversal.
const BEFORE: f64 = 2.0;
const AFTER: f64 = 1.2;
/// The lowest speed that is tried, as a share of Q15's full scale. `FASTEST_COUNTS` is the highest one, in counts per
/// sample. Each speed is `STEP` times the one before.
const SLOWEST: f64 = 1.0 / 16.0;
const FASTEST_COUNTS: f64 = 32_767.0;
const STEP: f64 = 1.25;
const HALVINGS: u32 = 8;

/// The output of the exact filter when a handle with a speed of 1 count per sample reverses. All variants use the same
/// reversal.
#[derive(Clone, Debug)]
pub struct Reversal {
    before: u32,
    slowest: f64,
    exact: Vec<f64>,
}

impl Reversal {
    pub fn new(bench: &Bench, cutoff_hz: f64) -> Self {
        let before = bench.samples(BEFORE, cutoff_hz) + 20;
        let after = bench.samples(AFTER, cutoff_hz) + 20;
        let mut reference = Reference::new(cutoff_hz, bench.rate_hz);
        let speed = |n| if n < before { 1.0 } else { -1.0 };
        let exact = (0..before + after).map(|n| reference.step(speed(n))).collect();
        Self { before, slowest: SLOWEST * bench.q15_full_scale_counts(), exact }
    }

    /// Largest speed, in counts per sample, at which the filter neither wraps nor saturates during the reversal. The
    /// lowest and highest output must differ from those of the exact filter by at most a twentieth of the overshoot. A
    /// filter may have other errors. Then it is enough that its outputs agree with its own outputs at half the speed.
    /// Returns `None` if these errors hide the overflow at every speed.
    pub fn measure(&self, filter: &Filter) -> Option<f64> {
        let mut low = FASTEST_COUNTS;
        let mut high = None;
        while !self.fits(filter, low) {
            high = Some(low);
            low /= STEP;
            if low < self.slowest {
                return None;
            }
        }
        if let Some(mut high) = high {
            for _ in 0..HALVINGS {
                let middle = f64::midpoint(low, high);
                if self.fits(filter, middle) {
                    low = middle;
                } else {
                    high = middle;
                }
            }
        }
        Some(low)
    }

    fn fits(&self, filter: &Filter, speed: f64) -> bool {
        const TOLERANCE: f64 = 0.004; // share of the speed; the overshoot is 0.086
        let [low, high] = self.extremes(filter, speed);
        let [half_low, half_high] = self.extremes(filter, speed / 2.0);
        let exact = self
            .exact
            .iter()
            .fold([0.0, 0.0], |[low, high]: [f64; 2], &v| [low.min(v), high.max(v)]);
        // An output that hardly moves does not show an overflow.
        let near = |a: f64, b: f64| b.abs() > 0.5 && (a - b).abs() <= TOLERANCE * b.abs();
        (near(low, exact[0]) || near(low, half_low))
            && (near(high, exact[1]) || near(high, half_high))
    }

    /// The lowest and the highest output, each divided by the speed.
    fn extremes(&self, filter: &Filter, speed: f64) -> [f64; 2] {
        #[expect(clippy::cast_possible_truncation, reason = "saturates")]
        let bits = (speed * LSB_PER_COUNT) as i32;
        let mut filter = *filter;
        let (mut low, mut high) = (0f64, 0f64);
        let samples = u32::try_from(self.exact.len()).unwrap_or(u32::MAX);
        filter.run(
            samples,
            |n| if n < self.before { bits } else { -bits },
            |_, out| (low, high) = (-larger(-low, -out), larger(high, out)),
        );
        [low / speed, high / speed]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Variant, scene::NamedScene};
    use filter_forms::{Form, Format};

    /// After the reversal the output overshoots by 8.6 %. This overshoot must also fit into the full scale.
    #[test]
    fn it_is_full_scale_less_the_overshoot() {
        let bench = Bench::of(&NamedScene::load("paper-1um").unwrap().scene);
        let reversal = Reversal::new(&bench, 500.0);
        let of = |format, form| {
            reversal.measure(&bench.filter(Variant { format, form }, 500.0).unwrap())
        };
        let core = of(Format::I32Feedback, Form::Direct1).unwrap();
        assert!((core / (32_767.0 / 1.086) - 1.0).abs() < 0.01, "{core}");
        for format in [Format::Q15, Format::Q15Feedback] {
            let half = of(format, Form::Direct1).unwrap();
            assert!((half / (128.0 / 1.086) - 1.0).abs() < 0.02, "{format:?}: {half}");
        }
        assert_eq!(of(Format::F32, Form::Delta), Some(FASTEST_COUNTS));
        // A filter that wraps has the same headroom as a filter that saturates.
        let wraps = of(Format::CmsisQ31, Form::Direct1).unwrap();
        assert!((wraps / core - 1.0).abs() < 0.01, "{wraps}");
    }
}
