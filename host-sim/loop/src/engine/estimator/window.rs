//! Estimators that store nothing but the last differences. A velocity is computed only when an output is due.
//!
//! Counts, weights and their products are whole numbers far below 2^53, so they are exact in `f64` lanes.

use zwidth::{
    units::Velocity,
    velocity::{Estimator, Foaw, WINDOW_MAX},
};

use super::{Beside, VectorForm};
use crate::engine::{
    lanes::Row,
    simd_ops::{SimdOps, lanes_mut},
};

/// The last differences of the counts in one vector, and the estimator that uses them.
pub struct Window<S: SimdOps, K> {
    /// Past differences in counts. The newest difference is just before `end`. Entries from `end` on are old.
    past: Vec<S::f64s>,
    end: usize,
    kind: K,
}

const LENGTH: usize = WINDOW_MAX as usize;
/// Number of entries. When all entries are used, the last differences are copied back to the beginning.
const ROOM: usize = 4 * LENGTH;

/// How an estimator computes a velocity from the window.
pub trait Kind<S: SimdOps>: Sized {
    /// State before any lane has an estimator.
    fn none(simd: S) -> Self;
    fn set(&mut self, simd: S, lane: usize, estimator: &Estimator);
    /// The velocity, as a whole number of LSB. The newest difference is the last entry of `past`.
    fn velocity(&self, simd: S, past: &[S::f64s]) -> S::f64s;
}

impl<S: SimdOps, K: Kind<S>> VectorForm<S> for Window<S, K> {
    type Gains = ();

    fn at_rest(simd: S) -> (Self, ()) {
        let past = vec![simd.splat_f64s(0.0); ROOM];
        (Self { past, end: LENGTH, kind: K::none(simd) }, ())
    }

    fn start(&mut self, simd: S, (): &mut (), lane: usize, estimator: &Estimator, _: Beside<'_>) {
        self.kind.set(simd, lane, estimator);
        for difference in &mut self.past {
            lanes_mut(difference)[lane] = 0.0;
        }
    }

    #[inline(always)]
    fn take<const R: usize>(
        forms: &mut [Self; R],
        simd: S,
        _: &[(); R],
        moved: &[Row<S, R>],
        due: bool,
        velocity: &mut [S::u64s; R],
    ) {
        for r in 0..R {
            let Window { past, end, kind } = &mut forms[r];
            if *end + moved.len() > ROOM {
                past.copy_within(*end - LENGTH..*end, 0);
                *end = LENGTH;
            }
            let Some(next) = past.get_mut(*end..*end + moved.len()) else { return };
            for (place, row) in next.iter_mut().zip(moved) {
                *place = row.0[r];
            }
            *end += moved.len();
            if let (true, Some(past)) = (due, past.get(*end - LENGTH..*end)) {
                velocity[r] = simd.to_low(kind.velocity(simd, past));
            }
        }
    }

    fn is_lost(&self, (): &(), _: usize) -> bool {
        false
    }
}

/// Length of each lane's window, in differences.
#[derive(Default)]
struct Lengths(Vec<usize>);

impl Lengths {
    /// Sets the window length of a lane. Returns the longest window length of all lanes.
    fn set(&mut self, lane: usize, length: usize) -> usize {
        if self.0.len() <= lane {
            self.0.resize(lane + 1, 0);
        }
        self.0[lane] = length;
        self.0.iter().copied().max().unwrap_or(0)
    }
}

/// [`Fir`](zwidth::velocity::Fir) in lanes. If a lane's window is shorter than the longest window, its weights are
/// filled up with zeros.
pub struct Sum<S: SimdOps> {
    weights: Vec<S::f64s>,
    lengths: Lengths,
}

impl<S: SimdOps> Kind<S> for Sum<S> {
    fn none(_: S) -> Self {
        Self { weights: vec![], lengths: Lengths::default() }
    }

    fn set(&mut self, simd: S, lane: usize, estimator: &Estimator) {
        let Estimator::Fir(fir) = estimator else { return };
        let own = fir.weights();
        let longest = self.lengths.set(lane, own.len());
        self.weights.resize(longest, simd.splat_f64s(0.0));
        for (n, weight) in self.weights.iter_mut().enumerate() {
            lanes_mut(weight)[lane] = own.get(n).map_or(0.0, |weight| f64::from(*weight));
        }
    }

    #[inline(always)]
    fn velocity(&self, simd: S, past: &[S::f64s]) -> S::f64s {
        const LSB: f64 = 1.0 / (1u32 << (30 - Velocity::FRACTION_BITS)) as f64;
        let mut sum = simd.splat_f64s(0.5 / LSB);
        for (weight, difference) in self.weights.iter().zip(past.iter().rev()) {
            sum = simd.mul_add_e_f64s(*weight, *difference, sum);
        }
        let bits = simd.floor(simd.mul_f64s(sum, simd.splat_f64s(LSB)));
        let limit = f64::from(Velocity::LIMIT << Velocity::FRACTION_BITS);
        simd.min_of(simd.max_of(bits, simd.splat_f64s(-limit)), simd.splat_f64s(limit))
    }
}

/// [`Foaw`] in lanes. All lanes try one window length at a time, until every lane has found its longest window.
pub struct Adaptive<S: SimdOps, const BEST: bool> {
    noise: S::f64s,
    /// Length of each lane's longest window, in samples.
    window: S::f64s,
    lengths: Lengths,
    longest: usize,
}

impl<S: SimdOps, const BEST: bool> Kind<S> for Adaptive<S, BEST> {
    fn none(simd: S) -> Self {
        let zero = simd.splat_f64s(0.0);
        Self { noise: zero, window: zero, lengths: Lengths::default(), longest: 0 }
    }

    fn set(&mut self, _: S, lane: usize, estimator: &Estimator) {
        let Estimator::Foaw(foaw) = estimator else { return };
        lanes_mut(&mut self.noise)[lane] = f64::from(foaw.noise_steps());
        lanes_mut(&mut self.window)[lane] = f64::from(foaw.window_samples());
        self.longest = self.lengths.set(lane, foaw.window_samples().into());
    }

    #[inline(always)]
    fn velocity(&self, simd: S, past: &[S::f64s]) -> S::f64s {
        const STEPS: f64 = Foaw::NOISE_STEPS as f64;
        let of = |value: f64| simd.splat_f64s(value);
        let zero = of(0.0);
        let noise = self.noise;
        // Bounds of the slope in units of the noise bound. As in the core, a bound is a fraction: numerator and
        // denominator.
        let free = f64::from(Foaw::FREE);
        let ([mut low, mut low_over], [mut high, mut high_over]) =
            ([of(-free), of(1.0)], [of(free), of(1.0)]);
        let (mut number, mut over) = (zero, of(1.0));
        let (mut s, mut sum, mut moment) = (zero, zero, zero);
        let (mut i, mut triangle, mut pyramid) = (0.0, 0.0, 0.0);
        let mut growing = simd.equal_f64s(zero, zero);
        for difference in past.iter().rev().take(self.longest) {
            i += 1.0;
            growing = simd.and_m64s(growing, simd.greater_than_or_equal_f64s(self.window, of(i)));
            s = simd.add_f64s(s, *difference);
            let centre = simd.mul_f64s(s, of(STEPS));
            let [slope, slope_over] = if BEST {
                sum = simd.add_f64s(sum, s);
                moment = simd.mul_add_e_f64s(of(i), s, moment);
                triangle += i;
                pyramid += triangle;
                let slope =
                    simd.sub_f64s(simd.mul_f64s(of(2.0), moment), simd.mul_f64s(of(i), sum));
                [slope, of(pyramid)]
            } else {
                [s, of(i)]
            };
            let scaled = simd.mul_f64s(slope, of(STEPS));
            let least = simd.mul_f64s(low, slope_over);
            let most = simd.mul_f64s(high, slope_over);
            let above = simd.greater_than_or_equal_f64s(simd.mul_f64s(scaled, low_over), least);
            let below = simd.less_than_or_equal_f64s(simd.mul_f64s(scaled, high_over), most);
            growing = simd.and_m64s(growing, simd.and_m64s(above, below));
            if simd.first_true_m64s(growing) >= S::F64_LANES {
                break;
            }
            number = simd.choose(growing, slope, number);
            over = simd.choose(growing, slope_over, over);
            let lower = simd.sub_f64s(centre, noise);
            let upper = simd.add_f64s(centre, noise);
            let raised = simd.mul_f64s(lower, low_over);
            let rises = simd.greater_than_f64s(raised, simd.mul_f64s(low, of(i)));
            low = simd.choose(rises, lower, low);
            low_over = simd.choose(rises, of(i), low_over);
            let lowered = simd.mul_f64s(upper, high_over);
            let falls = simd.less_than_f64s(lowered, simd.mul_f64s(high, of(i)));
            high = simd.choose(falls, upper, high);
            high_over = simd.choose(falls, of(i), high_over);
        }
        // rounds to nearest, and halves away from zero; if the quotient is not whole, it is at least 2^-13 below the
        // next whole number
        let scaled =
            simd.mul_f64s(simd.magnitude(number), of(f64::from(1u32 << Velocity::FRACTION_BITS)));
        let half = simd.floor(simd.mul_f64s(over, of(0.5)));
        let bits = simd.floor(simd.div_f64s(simd.add_f64s(scaled, half), over));
        let down = simd.less_than_f64s(number, zero);
        simd.choose(down, simd.sub_f64s(zero, bits), bits)
    }
}
