//! The stiffest wall that is linearly stable, for each virtual damping.
//!
//! On the curve `K(w) = -(1/Hx + B Hv/Hx)` ([`super::response`]) a root lies on the unit circle. A stiffness is real,
//! so roots cross the circle where Im K = 0. At a crossing, implicit differentiation gives `d ln|z| / dK = (d Im K /
//! dw) / |dK / dw|^2`. If Im K rises with w, the pair of roots leaves the circle with rising K. If Im K falls, the pair
//! enters. The crossings with K > 0 divide the K axis into intervals. In each interval the number of unstable roots is
//! constant. Eigenvalues give this number in the interval with the clearest result. The crossings give the numbers in
//! the other intervals.
//!
//! The paper's gain margin, eq. (5), is the smallest of these crossings. The gain margin is the boundary only if the
//! loop is stable as K tends to 0. Even then the gain margin gives no information about stable intervals above it.
//! [`StiffnessLimit`] reports the boundary and these intervals.

use super::{
    LinearError, Loop,
    acting::Acting,
    monodromy::Monodromy,
    response::{Point, Response},
};
use core::f64::consts::PI;

/// Lowest frequency of the search, in radians per output period. A crossing with K > 0 at a lower frequency would have
/// a stiffness of about m (1e-8 rate)^2. For the paper's device this is 4e-9 N/m.
const OMEGA_MIN: f64 = 1e-8;
/// Number of search points per decade of frequency. Crossings that are closer together are found as minima of |Im K|
/// between points.
const PER_DECADE: u32 = 32;
/// Number of search points per turn of the phase that the latency causes.
const PER_TURN: f64 = 16.0;
/// Smallest number of search points per half circle.
const PER_HALF_CIRCLE: f64 = 128.0;
/// Smallest distance of a search point from a resonance, in radians per output period.
const MARK_MIN: f64 = 1e-10;
/// Largest number of times that the search is refined. It is refined if eigenvalues and crossings give different
/// numbers of roots.
const REFINEMENTS: u32 = 2;
/// Share of the terms below which the true value of K at a crossing is 0. K is computed as a difference of these terms.
const ZERO_STIFFNESS: f64 = 1e-12;
/// Share of the loop's own stiffnesses below which K at a crossing is a rounding error. Without any damping, every wall
/// is unstable, and the first crossings are rounding errors.
const ROUNDING: f64 = 1e-12;
/// Crossings above this multiple of the loop's own stiffnesses (k, b/T, m/T^2, B/T) are left out. At so large a K, no
/// more roots leave the circle, and a root near z = -1 approaches the sampling zero.
const FAR_STIFFNESS: f64 = 1e3;
/// If the nearest eigenvalue is further from the unit circle than `CLEAR_MARGIN`, the eigenvalues are more reliable
/// than the count of crossings.
const CLEAR_MARGIN: f64 = 1e-6;
/// Largest number of states with which eigenvalues are computed. A long latency gives more states. Then the winding
/// number counts the roots.
const EIGENVALUE_STATES: usize = 64;
/// The radius of the circle on which the winding number is computed, minus 1. Undamped poles on the unit circle are
/// inside this circle.
const OUTSIDE: f64 = 1e-9;

/// A stiffness at which roots cross the unit circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Frequency of the oscillation at the crossing. It is at most half the output rate.
    pub frequency_hz: f64,
    /// Stiffness at the crossing, above 0 N/m.
    pub stiffness_n_per_m: f64,
    /// Whether roots leave the circle with rising stiffness. If this is false, they enter the circle.
    pub outward: bool,
    /// Number of roots that cross: 2, or 1 at half the output rate.
    pub roots: u32,
}

/// The stable stiffnesses at one virtual damping.
#[derive(Clone, Debug, PartialEq)]
pub struct StiffnessLimit {
    /// Upper end of the stable interval that begins at K = 0, in N/m. The loop is stable for every K between 0 and this
    /// value. It is 0 if no stable interval begins at K = 0. It is infinite if no stiffness makes the loop unstable.
    pub stiffness_max: f64,
    /// Whether the loop is unstable as K tends to 0. If so, virtual damping alone makes the loop unstable, and a gain
    /// margin has no meaning.
    pub unstable_at_zero: bool,
    /// All K > 0 with roots on the circle, in ascending order. At these K the phase of the paper's eq. (5) is -180
    /// degrees. Stiffnesses above a thousand times the loop's own stiffness (k + b/T + m/T^2 + B/T) are left out,
    /// because no such wall is stable.
    pub phase_crossings: Vec<Crossing>,
    /// Further intervals of K in which the loop is stable, above `stiffness_max`. Each has its lower and upper end in
    /// N/m.
    pub further_stable: Vec<(f64, f64)>,
}

impl StiffnessLimit {
    /// The gain margin of eq. (5) of the paper, as tools compute it: the smallest crossing. `None` if there is no
    /// crossing. Tools report an infinite gain margin then.
    #[must_use]
    pub fn gain_margin(&self) -> Option<f64> {
        self.phase_crossings.first().map(|crossing| crossing.stiffness_n_per_m)
    }

    /// Whether the gain margin of eq. (5) is correct: the loop is stable from 0 to the gain margin, and nowhere above
    /// it.
    #[must_use]
    pub fn gain_margin_holds(&self) -> bool {
        self.gain_margin() == Some(self.stiffness_max) && self.further_stable.is_empty()
    }
}

/// Stability boundary of one loop. The boundary is prepared once. After that it can be evaluated for any damping.
#[derive(Clone, Debug)]
pub struct Boundary {
    response: Response,
    monodromy: Option<Monodromy>,
    points: Vec<Point>,
    /// Number of unstable poles that the estimator itself has.
    estimator_poles: u32,
    output_hz: f64,
    /// The stiffness `k + b/T + m/T^2` in N/m, where T is the output period.
    own_stiffness: f64,
}

impl Boundary {
    /// Prepares the boundary of a loop.
    ///
    /// # Errors
    /// An error of [`Loop::check`].
    pub fn new(of: &Loop) -> Result<Self, LinearError> {
        let response = Response::new(of)?;
        let states = 1 + Acting::of(&of.chain()).states() + of.estimator.order() + response.late;
        let monodromy = if states <= EIGENVALUE_STATES { Some(Monodromy::new(of)?) } else { None };
        let output_hz = of.rate_hz / f64::from(of.period);
        let device = of.device;
        let own_stiffness = device.stiffness_n_per_m
            + device.damping_n_s_per_m * output_hz
            + device.mass_kg * output_hz * output_hz;
        let estimator_poles = of.estimator.poles_beyond(1.0);
        let points = grid(&response, 1);
        Ok(Self { response, monodromy, points, estimator_poles, output_hz, own_stiffness })
    }

    /// The stable stiffnesses at the virtual damping B, in N s/m. B may have any sign.
    ///
    /// # Errors
    /// The damping is not finite.
    pub fn at(&self, damping_n_s_per_m: f64) -> Result<StiffnessLimit, LinearError> {
        if !damping_n_s_per_m.is_finite() {
            return Err(LinearError::OutOfRange {
                name: "virtual damping",
                low: f64::MIN,
                high: f64::MAX,
            });
        }
        let mut found = self.intervals(&self.points, damping_n_s_per_m);
        for refinement in 1..=REFINEMENTS {
            if found.consistent {
                break;
            }
            let finer = grid(&self.response, 8_u32.pow(refinement));
            found = self.intervals(&finer, damping_n_s_per_m);
        }
        Ok(found.limit())
    }

    #[cfg(test)]
    pub(in crate::analysis) fn unstable_roots(&self, stiffness: f64, damping: f64) -> u32 {
        self.count(&self.points, stiffness, damping).0
    }

    /// Counts the unstable roots. Returns their number, and the distance of the nearest root from the unit circle.
    fn count(&self, points: &[Point], stiffness: f64, damping: f64) -> (u32, f64) {
        let eigenvalues = self.monodromy.as_ref().and_then(|m| m.eigenvalues(stiffness, damping));
        let Some(eigenvalues) = eigenvalues else {
            return (self.winding(points, stiffness, damping), f64::INFINITY);
        };
        let (mut unstable, mut margin) = (0, f64::INFINITY);
        for z in eigenvalues {
            // |z|^2 - 1, in a form that keeps the digits near the circle.
            let beyond = (z.re - 1.0) * (z.re + 1.0) + z.im * z.im;
            unstable += u32::from(beyond > 0.0);
            margin = beyond.abs().min(margin);
        }
        (unstable, margin)
    }

    /// Number of unstable roots by the argument principle. It follows from the turns of `1 + K Hx + B Hv` along the
    /// circle.
    fn winding(&self, points: &[Point], stiffness: f64, damping: f64) -> u32 {
        let value = |omega: f64| {
            let p = self.response.at_radius(omega, OUTSIDE);
            (p.inverse + p.velocity * damping + stiffness) / p.inverse
        };
        let mut turns = 0.0;
        let mut stack: Vec<(f64, f64, u32)> = Vec::new();
        let edges = core::iter::once(0.0).chain(points.iter().map(|p| p.omega));
        for (low, high) in edges.clone().zip(edges.skip(1)) {
            stack.push((low, high, 0));
            while let Some((low, high, depth)) = stack.pop() {
                let middle = 0.5 * (low + high);
                let (a, b, c) = (value(low), value(middle), value(high));
                let (first, second) = ((b / a).arg(), (c / b).arg());
                if (first.abs() < 0.5 && second.abs() < 0.5) || depth > 50 {
                    turns += first + second;
                } else {
                    stack.push((low, middle, depth + 1));
                    stack.push((middle, high, depth + 1));
                }
            }
        }
        let roots = f64::from(self.estimator_poles) - turns / PI;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most the number of states"
        )]
        let roots = roots.round().max(0.0) as u32;
        roots
    }

    fn intervals(&self, points: &[Point], damping: f64) -> Intervals {
        let mut crossings = self.crossings(points, damping);
        crossings.sort_by(|a, b| a.stiffness_n_per_m.total_cmp(&b.stiffness_n_per_m));
        let ends: Vec<f64> = crossings.iter().map(|c| c.stiffness_n_per_m).collect();
        // A stiffness inside each interval between crossings.
        let inside: Vec<f64> = (0..=ends.len())
            .map(|i| match (i.checked_sub(1).map(|j| ends[j]), ends.get(i)) {
                (None, None) => self.own_stiffness,
                (None, Some(high)) => 0.5 * high,
                (Some(low), None) => (2.0 * low).min((low * self.far(damping)).sqrt()),
                (Some(low), Some(high)) => (low * high).sqrt(),
            })
            .collect();
        // A winding number needs many frequencies, which takes long. So only the two lowest intervals are counted.
        let few = if self.monodromy.is_some() { inside.len() } else { inside.len().min(2) };
        let counted: Vec<(u32, f64)> =
            inside[..few].iter().map(|k| self.count(points, *k, damping)).collect();
        // The count is most reliable where the nearest root is farthest from the circle. The numbers in the other
        // intervals follow from this count.
        let anchor =
            (0..few).rev().max_by(|a, b| counted[*a].1.total_cmp(&counted[*b].1)).unwrap_or(0);
        let change = |c: &Crossing| {
            if c.outward { i64::from(c.roots) } else { -i64::from(c.roots) }
        };
        let mut unstable = vec![i64::from(counted[anchor].0); inside.len()];
        for i in anchor..crossings.len() {
            unstable[i + 1] = unstable[i] + change(&crossings[i]);
        }
        for i in (0..anchor).rev() {
            unstable[i] = unstable[i + 1] - change(&crossings[i]);
        }
        let agrees = |walked: i64, (count, margin): (u32, f64)| {
            walked == i64::from(count) || margin < CLEAR_MARGIN
        };
        let consistent = unstable.iter().all(|u| *u >= 0)
            && unstable.iter().zip(&counted).all(|(u, c)| agrees(*u, *c));
        if !consistent {
            for (walked, (count, _)) in unstable.iter_mut().zip(&counted) {
                *walked = i64::from(*count);
            }
        }
        Intervals { crossings, unstable, consistent }
    }

    /// All crossings: the frequencies at which K > 0 and Im K = 0.
    fn crossings(&self, points: &[Point], damping: f64) -> Vec<Crossing> {
        let imaginary = |omega: f64| self.response.at(omega).stiffness(damping).im;
        let values: Vec<f64> = points.iter().map(|p| p.stiffness(damping).im).collect();
        let mut found = Vec::new();
        // The last point is at half the output rate. Im K is 0 there by symmetry.
        let inner = values.len() - 1;
        for i in 1..inner {
            let (low, high) = (points[i - 1].omega, points[i].omega);
            let (before, here, after) = (values[i - 1], values[i], values[i + 1]);
            let mut cross = |[low, high]: [f64; 2], [at_low, at_high]: [f64; 2], outward| {
                let omega = root(&imaginary, low, high, at_low, at_high);
                self.keep(&mut found, damping, omega, outward, 2);
            };
            if before < 0.0 && here >= 0.0 || before >= 0.0 && here < 0.0 {
                cross([low, high], [before, here], here >= 0.0);
            } else if i + 1 < inner && dips(before, here, after) {
                let sign = here.signum();
                let end = points[i + 1].omega;
                let turn = minimum(|omega| imaginary(omega) * sign, low, end);
                let there = imaginary(turn);
                if there * sign < 0.0 {
                    cross([low, turn], [before, there], there > 0.0);
                    cross([turn, end], [there, after], after > 0.0);
                }
            }
        }
        self.keep(&mut found, damping, PI, values[inner - 1] < 0.0, 1);
        found
    }

    /// Crossings above this stiffness are left out.
    fn far(&self, damping: f64) -> f64 {
        FAR_STIFFNESS * (self.own_stiffness + damping.abs() * self.output_hz)
    }

    fn keep(&self, found: &mut Vec<Crossing>, damping: f64, omega: f64, outward: bool, roots: u32) {
        let point = self.response.at(omega);
        let stiffness = point.stiffness(damping).re;
        let half = libm::sin(0.5 * omega);
        let terms =
            (point.velocity * damping).norm_sqr().sqrt() + self.own_stiffness * 4.0 * half * half;
        let zero = (ZERO_STIFFNESS * terms).max(ROUNDING * self.own_stiffness);
        if stiffness > zero && stiffness < self.far(damping) {
            let frequency_hz = omega / (2.0 * PI) * self.output_hz;
            found.push(Crossing { frequency_hz, stiffness_n_per_m: stiffness, outward, roots });
        }
    }
}

struct Intervals {
    crossings: Vec<Crossing>,
    /// Number of unstable roots in each interval: below the first crossing, between crossings, and above the last
    /// crossing.
    unstable: Vec<i64>,
    consistent: bool,
}

impl Intervals {
    fn limit(self) -> StiffnessLimit {
        let ends: Vec<f64> = self.crossings.iter().map(|c| c.stiffness_n_per_m).collect();
        let end = |i: usize| ends.get(i).copied().unwrap_or(f64::INFINITY);
        let first_unstable =
            self.unstable.iter().position(|u| *u > 0).unwrap_or(self.unstable.len());
        let stiffness_max = if first_unstable == 0 { 0.0 } else { end(first_unstable - 1) };
        let mut further_stable: Vec<(f64, f64)> = Vec::new();
        for i in first_unstable.max(1)..self.unstable.len() {
            if self.unstable[i] <= 0 {
                match further_stable.last_mut() {
                    Some(last) if last.1 == ends[i - 1] => last.1 = end(i),
                    _ => further_stable.push((ends[i - 1], end(i))),
                }
            }
        }
        StiffnessLimit {
            stiffness_max,
            unstable_at_zero: first_unstable == 0,
            phase_crossings: self.crossings,
            further_stable,
        }
    }
}

/// Frequencies at which the search begins. They are logarithmic from both ends of (0, pi), and dense enough for the
/// phase of the latency.
fn grid(response: &Response, refinement: u32) -> Vec<Point> {
    let fine = f64::from(refinement);
    let ratio = libm::pow(10.0, 1.0 / (fine * f64::from(PER_DECADE)));
    let step = PI / (fine * PER_HALF_CIRCLE.max(PER_TURN * 0.5 * (response.late as f64 + 2.0)));
    let mut omegas = Vec::new();
    let mut omega = OMEGA_MIN;
    while omega < 0.5 * PI {
        omegas.push(omega);
        omega = (omega * ratio).min(omega + step);
    }
    // The sampling zero may be close to pi. So the points near pi mirror the points near 0, down to 1e-6.
    let below: Vec<f64> = omegas.iter().rev().filter(|w| **w > 1e-6).map(|w| PI - w).collect();
    omegas.extend(below);
    omegas.push(PI);
    // Near a resonance the response changes over a range of frequencies. With low damping this range may be very small.
    for mark in response.marks() {
        let mut distance = step;
        while distance > MARK_MIN {
            omegas.extend([mark - distance, mark + distance]);
            distance *= 0.5;
        }
        omegas.push(*mark);
    }
    omegas.retain(|omega| (OMEGA_MIN..=PI).contains(omega));
    omegas.sort_by(f64::total_cmp);
    omegas.dedup();
    omegas.into_iter().map(|omega| response.at(omega)).collect()
}

/// Whether three values have the same sign and the middle one has the smallest magnitude.
fn dips(before: f64, here: f64, after: f64) -> bool {
    let sign = here.signum();
    let (before, here, after) = (before * sign, here * sign, after * sign);
    before > here && after > here
}

/// Finds the root of a function that changes its sign between two arguments. The method is regula falsi with the
/// Illinois modification. The result is exact to the last digits.
fn root(of: &impl Fn(f64) -> f64, low: f64, high: f64, at_low: f64, at_high: f64) -> f64 {
    let (mut a, mut b, mut fa, mut fb) = (low, high, at_low, at_high);
    for iteration in 0..200 {
        if (b - a).abs() <= 2.0 * f64::EPSILON * b.abs() || fb == 0.0 {
            break;
        }
        let secant = (a * fb - b * fa) / (fb - fa);
        // Every fourth step is a bisection, because secant steps are slow if the function is steep at one end.
        let c = if iteration % 4 == 3 || !(secant > a.min(b) && secant < a.max(b)) {
            0.5 * (a + b)
        } else {
            secant
        };
        let fc = of(c);
        if (fc > 0.0) == (fb > 0.0) {
            fa *= 0.5;
        } else {
            (a, fa) = (b, fb);
        }
        (b, fb) = (c, fc);
    }
    b
}

/// Finds the smallest value of a function between two arguments, by golden section.
pub(super) fn minimum(of: impl Fn(f64) -> f64, low: f64, high: f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let (mut a, mut b) = (low, high);
    let (mut x, mut y) = (b - GOLDEN * (b - a), a + GOLDEN * (b - a));
    let (mut fx, mut fy) = (of(x), of(y));
    // 50 sections reduce the interval by a factor of 3e-11. This is enough, because a minimum is flat over 1e-8 of its
    // argument.
    for _ in 0..50 {
        if fx < fy {
            (b, y, fy) = (y, x, fx);
            x = b - GOLDEN * (b - a);
            fx = of(x);
        } else {
            (a, x, fx) = (x, y, fy);
            y = a + GOLDEN * (b - a);
            fy = of(y);
        }
    }
    0.5 * (a + b)
}

#[cfg(test)]
mod tests;
