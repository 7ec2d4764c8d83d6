//! Levant's differentiator into a Kalman filter that integrates it: "a sliding-mode differentiator as input to a Kalman
//! integrator", the best in general of the thirteen of Sinclair, Wanderley and Hayward (IEEE Trans. Haptics 7(4), 2014).
//! Of that paper abstract and introduction were read; the filter below is the plain one of that description.
//!
//! The steady-state filter has position and velocity, driven by an acceleration that differs from sample to sample
//! ([`kalman`](super::kalman)). It is shown two things: the count `p`, and the velocity `u` of Levant's
//! explicit form ([`levant`](super::levant), `lambda = sqrt(C)`). In counts and samples:
//!
//! ```text
//! predict: x += v
//! correct: x += k11 (p - x) + k12 (u - v),  v += k21 (p - x) + k22 (u - v),   both with x and v as predicted
//! ```
//!
//! **Noise.** `c = C T^2 / resolution`, counts per sample^2:
//!
//! ```text
//! acceleration  ratio c                     RMS
//! count         1 / sqrt(12)                RMS, its rounding
//! u             sqrt(c / sqrt(12) + c^2)    RMS: the differentiator's sqrt(c noise), and its chattering, c
//! ```
//!
//! Over constant speeds Levant's error is that to a third, which a test measures. With a `ratio` far below 1 the filter
//! believes neither and is late; far above it is the differentiator without its chattering. All three are RMS
//! values of the same `c`: one number tunes it, as one tunes each of its halves.
//!
//! **Gains.** `K = P (P + R)^-1`, `P` the steady covariance before a measurement, by doubling (Anderson, Int. J. Control
//! 28(2), 1978): each step is as many samples as all before it.
//!
//! **Delay.** `u` is half a sample ahead. For a constant acceleration the recursion gives
//!
//! ```text
//! (k11 - k21 (1 - 3 k12) / 2 - 3 k11 k22 / 2) / (k21 (1 - k12) + k11 k22)    samples
//! ```
//!
//! **Fixed point.** As the Kalman filters: the position is its distance from the count, 32 fractional bits, and what
//! rounding the output drops is carried on. `u` is the velocity that `levant-explicit` would say.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Form, Levant, LevantDesign, Senses, Word, called, kept::kept, levant::LevantState};
use crate::{
    Design, Gain,
    range::{SettingsError, within},
    units::Velocity,
};

/// Largest accelerations that are accepted, counts per sample^2.
const C: [f64; 2] = [1e-5, 10.0];
/// Accepted ratios of the filter's RMS acceleration to C.
pub const RMS_RATIO: core::ops::RangeInclusive<f64> = 0.1..=10.0;
/// Doublings of the time that the covariance has had: the slowest filter takes 2^14 samples.
const DOUBLINGS: u32 = 20;

type Matrix = [[f64; 2]; 2];

/// Sizes of the differentiator and gains as real numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevantKalmanDesign {
    /// Of the differentiator.
    pub levant: LevantDesign,
    /// From what the count and the differentiator's velocity differ by to position, `gains[0]`, and velocity.
    pub gains: Matrix,
}

#[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
impl LevantKalmanDesign {
    /// For that largest acceleration of the differentiator, m/s^2, and the filter's RMS acceleration over it.
    ///
    /// # Errors
    /// Names the parameter and its range; the acceleration's follows from rate and resolution.
    pub fn new(
        acceleration_max: f64,
        rms_ratio: f64,
        design: &Design,
    ) -> Result<Self, SettingsError> {
        let unit = design.resolution_m * design.rate_hz * design.rate_hz;
        let [low, high] = C.map(|c| c * unit);
        let c = within("acceleration_max_m_per_s2", acceleration_max, low..=high)? / unit;
        let ratio = within("rms_ratio", rms_ratio, RMS_RATIO)?;
        let acceleration = ratio * c;
        let noise = [1.0 / 12.0, c / libm::sqrt(12.0) + c * c];
        Ok(Self {
            levant: LevantDesign::new(acceleration_max, 1.0, design)?,
            gains: gains(acceleration * acceleration, noise),
        })
    }

    /// Delay of a slow motion, samples.
    pub fn delay_samples(&self) -> f64 {
        let [[k11, k12], [k21, k22]] = self.gains;
        let late = k11 - k21 * (0.5 - 1.5 * k12) - 1.5 * k11 * k22;
        late / (k21 * (1.0 - k12) + k11 * k22)
    }

    /// The same in integers, each gain within 2^-31 of itself.
    pub fn quantise(&self) -> LevantKalman {
        // 2^-20 and more by the ranges
        let gain = |value| Gain::from_f64(value).unwrap_or_default();
        LevantKalman {
            levant: self.levant.quantise(false),
            filter: Integrator { gains: self.gains.map(|row| row.map(gain)) },
        }
    }
}

/// Steady gains for those variances of the acceleration, and of count and velocity.
#[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
fn gains(acceleration: f64, noise: [f64; 2]) -> Matrix {
    // of the time so far: transition, information of the measurements, covariance
    let mut step = [[1.0, 0.0], [1.0, 1.0]];
    let mut known = [[1.0 / noise[0], 0.0], [0.0, 1.0 / noise[1]]];
    let mut p = [[0.25, 0.5], [0.5, 1.0]].map(|row| row.map(|part| part * acceleration));
    for _ in 0..DOUBLINGS {
        let mut both = times(&known, &p);
        both[0][0] += 1.0;
        both[1][1] += 1.0;
        let across = times(&inverse(&both), &step);
        let back = transposed(&step);
        p = plus(&p, &times(&times(&back, &p), &across));
        // step (1 + known p)^-1 known step', by the symmetry of both
        let seen = times(&times(&step, &inverse(&both)), &times(&known, &back));
        known = plus(&known, &seen);
        step = times(&step, &across);
    }
    let measured = plus(&p, &[[noise[0], 0.0], [0.0, noise[1]]]);
    times(&p, &inverse(&measured))
}

#[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
fn times([[a, b], [c, d]]: &Matrix, [[e, f], [g, h]]: &Matrix) -> Matrix {
    [[a * e + b * g, a * f + b * h], [c * e + d * g, c * f + d * h]]
}

#[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
fn plus([[a, b], [c, d]]: &Matrix, [[e, f], [g, h]]: &Matrix) -> Matrix {
    [[a + e, b + f], [c + g, d + h]]
}

#[expect(clippy::float_arithmetic, reason = "design time: settings to coefficients")]
fn inverse([[a, b], [c, d]]: &Matrix) -> Matrix {
    let whole = a * d - b * c;
    [[d / whole, -b / whole], [-c / whole, a / whole]]
}

fn transposed([[a, b], [c, d]]: &Matrix) -> Matrix {
    [[*a, *c], [*b, *d]]
}

/// Fractional bits of position and velocity.
const FRACTION_BITS: u32 = 32;
/// Of these, those that the output has not.
const DROPPED_BITS: u32 = FRACTION_BITS - Velocity::FRACTION_BITS;
/// Largest distance from the count: more than the smallest gains leave of a stop from full speed.
const DISTANCE_MAX: i64 = 1 << (28 + FRACTION_BITS);
/// Largest velocity of the state: twice that of the output, for its overshoot.
const VELOCITY_MAX: i64 = 1 << (16 + FRACTION_BITS);

/// Sizes and gains; made by [`LevantKalmanDesign::quantise`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevantKalman {
    /// The differentiator.
    pub levant: Levant,
    /// The filter behind it.
    pub filter: Integrator,
}

/// The filter: gains from what count and measured velocity differ by to position, `gains[0]`, and velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integrator<G = Gain> {
    /// Those of the count first.
    pub gains: [[G; 2]; 2],
}

/// Estimates of the filter after the last sample.
#[derive(Clone, Copy, Debug)]
pub struct IntegratorState<W: Word = i64> {
    /// Position less the count.
    pub distance: W,
    /// Velocity.
    pub velocity: W,
    /// What rounding the last output dropped.
    pub residue: W::Fraction,
}

kept!(IntegratorState { distance, velocity, residue });

/// Of the differentiator and of the filter.
#[derive(Clone, Copy, Debug)]
pub(super) struct LevantKalmanState {
    levant: LevantState,
    filter: IntegratorState,
}

kept!(LevantKalmanState { levant, filter });

impl Integrator {
    /// Before the first sample.
    pub const REST: IntegratorState =
        IntegratorState { distance: 0, velocity: 0, residue: 1 << (DROPPED_BITS - 1) };
}

impl<G: Copy> Integrator<G> {
    /// LSB of the velocity after a move by `moved` counts at a velocity that was `measured`, LSB.
    #[inline(always)] // into what is compiled for a machine's vectors
    pub fn update<W: Word<Gain = G>>(
        &self,
        state: &mut IntegratorState<W>,
        moved: W,
        measured: W,
    ) -> W {
        let ahead = state.distance + state.velocity - (moved << FRACTION_BITS);
        let predicted = ahead.clamped(DISTANCE_MAX);
        let faster = (measured << DROPPED_BITS) - state.velocity;
        let [[k11, k12], [k21, k22]] = self.gains;
        state.distance = predicted - predicted.times(k11) + faster.times(k12);
        state.velocity =
            (state.velocity - predicted.times(k21) + faster.times(k22)).clamped(VELOCITY_MAX);
        let (nearest, residue) = state.velocity.plus(state.residue).split();
        state.residue = residue;
        nearest.clamped(Velocity::LIMIT_BITS.into())
    }
}

impl Form for LevantKalman {
    type State = LevantKalmanState;
    const REST: LevantKalmanState =
        LevantKalmanState { levant: Levant::REST, filter: Integrator::REST };

    fn at(&self, velocity: Velocity) -> LevantKalmanState {
        let bits = i64::from(velocity.bits()) << DROPPED_BITS;
        let filter = IntegratorState { velocity: bits, ..Integrator::REST };
        LevantKalmanState { levant: self.levant.at(velocity), filter }
    }

    #[inline]
    fn step(&self, state: &mut LevantKalmanState, difference: i32, senses: &Senses) -> Velocity {
        let measured = called(&self.levant, &mut state.levant, difference, senses);
        let moved = i64::from(difference.clamp(-Velocity::LIMIT, Velocity::LIMIT));
        let nearest = self.filter.update(&mut state.filter, moved, measured.bits().into());
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 31 bits")]
        Velocity::saturating_from_bits(nearest as i32)
    }
}

#[cfg(test)]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts and samples of a test are small"
)]
mod tests {
    use super::*;
    use crate::{
        design::tests::DESIGN,
        units::Position,
        velocity::{Estimator, EstimatorName, State, VelocitySettings},
    };
    use std::vec::Vec;

    const LSB: f64 = (1u32 << Velocity::FRACTION_BITS) as f64;

    /// Counts per sample^2 to m/s^2 on that device.
    fn unit() -> f64 {
        DESIGN.resolution_m * DESIGN.rate_hz * DESIGN.rate_hz
    }

    fn designs() -> impl Iterator<Item = (f64, f64, LevantKalmanDesign)> {
        // the recursion below takes the longer the smaller they are
        let sizes: &[f64] = if cfg!(miri) { &[0.2] } else { &[1e-5, 1e-3, 0.02, 0.2, 3.0, 10.0] };
        sizes.iter().flat_map(|c| [0.1, 1.0, 10.0].map(|ratio| (*c, ratio))).map(|(c, ratio)| {
            let within = |c: f64| c.clamp(1.000_001e-5, 9.999_999) * unit();
            (c, ratio, LevantKalmanDesign::new(within(c), ratio, &DESIGN).unwrap())
        })
    }

    /// Sample by sample, one measurement after the other.
    #[test]
    fn the_gains_are_those_of_the_riccati_recursion() {
        for (c, ratio, design) in designs() {
            let c = c.clamp(1.000_001e-5, 9.999_999);
            let variance = (ratio * c).powi(2);
            let noise = [1.0 / 12.0, c / 12f64.sqrt() + c * c];
            let (mut p11, mut p12, mut p22) = (1.0, 0.0, 1.0);
            let mut gains = [[0.0; 2]; 2];
            for _ in 0..30_000 {
                (p11, p12, p22) = (
                    p11 + 2.0 * p12 + p22 + variance / 4.0,
                    p12 + p22 + variance / 2.0,
                    p22 + variance,
                );
                // the count, then the velocity
                let s = p11 + noise[0];
                let first = [p11 / s, p12 / s];
                (p11, p12, p22) =
                    (p11 - first[0] * p11, p12 - first[0] * p12, p22 - first[1] * p12);
                let s = p22 + noise[1];
                let second = [p12 / s, p22 / s];
                (p11, p12, p22) =
                    (p11 - second[0] * p12, p12 - second[0] * p22, p22 - second[1] * p22);
                // after the count the velocity is first[1] of it nearer
                gains = [0, 1].map(|n| [first[n] - second[n] * first[1], second[n]]);
            }
            for (got, want) in design.gains.iter().flatten().zip(gains.iter().flatten()) {
                assert!((got - want).abs() <= 1e-8 * want, "{c} {ratio}: {got} against {want}");
            }
        }
    }

    struct Run(Estimator, State);

    impl Run {
        fn of(settings: VelocitySettings) -> Self {
            Self(settings.build(&DESIGN).unwrap(), State::at_rest(Position::default()))
        }

        /// Counts per sample.
        fn at(&mut self, count: f64) -> f64 {
            let position = Position::from_counts(count.floor() as i64 as i32);
            f64::from(self.0.update(&mut self.1, position, &Senses::NONE).bits()) / LSB
        }
    }

    /// What the filter takes for the noise of the differentiator.
    #[test]
    #[cfg_attr(miri, ignore = "a hundred thousand samples")]
    fn the_error_of_the_differentiator_is_near_what_the_filter_takes_it_for() {
        for c in [1e-3, 0.01, 0.05, 0.2, 1.0, 5.0] {
            let speeds = [0.013, 0.26, 0.52, 0.77, 1.38, 2.3, 4.61];
            let each = speeds.map(|speed: f64| {
                let mut run =
                    Run::of(EstimatorName::LevantExplicit.defaults().with_tuning(c * unit()));
                let wait = (4.0 * speed / c) as u32 + 500;
                let after = (0..wait + 3000).map(|n| run.at(speed * f64::from(n) + 0.3) - speed);
                (after.skip(wait as usize).map(|off| off * off).sum::<f64>() / 3000.0).sqrt()
            });
            let (measured, taken) =
                (each.iter().sum::<f64>() / 7.0, (c / 12f64.sqrt() + c * c).sqrt());
            assert!((0.75..1.34).contains(&(measured / taken)), "{c}: {measured} {taken}");
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "thousands of samples each")]
    fn the_delay_is_that_of_a_constant_acceleration() {
        for (c, ratio, design) in designs().filter(|(c, ..)| (1e-3..10.0).contains(c)) {
            let settings = EstimatorName::LevantKalman.defaults();
            let mut run = Run::of(settings.with_tuning(c * unit()).with_second(ratio));
            let acceleration = 0.3 * c;
            let samples = (2000.0 / acceleration).min(6000.0) as u32;
            let late = (0..samples).map(|n| {
                let time = f64::from(n);
                (acceleration * time - run.at(acceleration * time * time / 2.0)) / acceleration
            });
            let late: Vec<f64> = late.skip(samples as usize / 2).collect();
            let mean = late.iter().sum::<f64>() / late.len() as f64;
            let stated = design.delay_samples();
            assert!(
                (mean - stated).abs() < 0.1 + 0.01 * stated.abs(),
                "{c} {ratio}: {mean} {stated}"
            );
        }
    }

    /// Every intermediate of the filter is monotone in each argument (see [`crate::bounds`]); what the differentiator
    /// says is a velocity.
    #[test]
    fn no_step_overflows_at_any_corner_of_state_and_input() {
        for (_, _, design) in designs() {
            let form = design.quantise();
            let ends = [DISTANCE_MAX, VELOCITY_MAX, 1 << 40, VELOCITY_MAX].map(|max| [-max, max]);
            for [distance, velocity, ahead, speed] in crate::bounds::corners(ends) {
                for residue in [0, u16::MAX] {
                    for moved in [i32::MIN, 0, i32::MAX] {
                        let levant = LevantState::of(ahead, speed);
                        let filter = IntegratorState { distance, velocity, residue };
                        let mut state = LevantKalmanState { levant, filter };
                        let speed = form.step(&mut state, moved, &Senses::NONE);
                        assert!(speed.bits().abs() <= Velocity::LIMIT_BITS);
                        assert!(state.filter.velocity.abs() <= VELOCITY_MAX);
                    }
                }
            }
        }
    }

    #[test]
    fn at_rest_it_is_at_rest_and_what_is_out_of_range_is_refused_by_name() {
        let form = LevantKalmanDesign::new(20.0, 1.0, &DESIGN).unwrap().quantise();
        let mut state = LevantKalman::REST;
        for _ in 0..300 {
            assert_eq!(form.step(&mut state, 0, &Senses::NONE), Velocity::ZERO);
        }
        for (c, ratio, parameter) in [
            (0.9e-5, 1.0, "acceleration_max_m_per_s2"),
            (10.1, 1.0, "acceleration_max_m_per_s2"),
            (f64::NAN, 1.0, "acceleration_max_m_per_s2"),
            (0.2, 0.09, "rms_ratio"),
            (0.2, 10.1, "rms_ratio"),
            (0.2, f64::NAN, "rms_ratio"),
        ] {
            let refused = LevantKalmanDesign::new(c * unit(), ratio, &DESIGN).unwrap_err();
            assert_eq!(refused.parameter, parameter);
        }
    }
}
