//! Confidence of the parameters: 95 % intervals from the residual.
//!
//! At the solution, a small error e of the positions changes an estimate by `sum of q(n) e(n)`, where q is the
//! estimate's row of `(J' J)^-1 J'`. The variance of this sum is computed in two ways. The larger variance is used:
//!
//! 1. From a model of the error: white noise plus the quantiser's sawtooth (see `residual`). The variance of the white
//!    noise is the residual's variance minus the variance of the sawtooth. Over a random start within a count, two
//!    samples of the sawtooth at x and y have the covariance `sum over h of cos(2 pi h (x - y)) / (2 pi^2 h^2)`, so
//!    that `variance = s^2 sum q^2 + sum over h of a^(2 h^2) |sum q(n) exp(2 pi i h x(n))|^2 / (2 pi^2 h^2)`. At rest
//!    the sawtooth acts like a constant error of 1/sqrt(12) count, in motion like white noise.
//! 2. From the residual itself, with any correlation: Newey and West, Econometrica 55 (1987) 703, with the bandwidth of
//!    Andrews, Econometrica 59 (1991) 817, for a first-order autoregression.

use std::{
    f64::consts::TAU,
    sync::atomic::{AtomicBool, Ordering::Relaxed},
};

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF as _, Normal, StudentsT};

use super::{
    fit::Solution,
    joint::{ErrorModel, Joint, NUMBERS},
    layout::{
        DAMPING, Included, Layout, MASS, Parameter,
        Parameter::{
            CogCosine, CogCycles, CogSine, Constant, Cosine, Cycles, Damping, Fall, Friction, Gain,
            Lag, Latency, Mass, Rise, Second, Sine, Stiffness,
        },
        Values,
    },
    residual::{Piece, Weighed},
    weighting::Weighting,
};
use crate::interrupt;

/// Probability with which an interval contains the true value.
pub const CONFIDENCE: f64 = 0.95;
/// Largest allowed condition number of the scaled derivatives. If it is larger, the parameters cannot be distinguished.
const CONDITION_MAX: f64 = 1e8;
/// The weakest direction has a component for each parameter. An error message names a parameter if its component is at
/// least this part of the largest component.
const NAMED_SHARE: f64 = 0.3;

/// A hidden term widens an interval if it could move the value by more than `FAR_OUTSIDE` half-widths.
const FAR_OUTSIDE: f64 = 3.0;

/// A value and its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    pub value: f64,
    pub half_width: f64,
    /// Half-width if the residual is white noise. It is computed from the residual's RMS, and is never above
    /// `half_width`.
    pub white_half_width: f64,
}

impl Estimate {
    /// A given value, with an interval of width 0.
    pub fn given(value: f64) -> Self {
        Self { value, half_width: 0.0, white_half_width: 0.0 }
    }

    pub fn low(&self) -> f64 {
        self.value - self.half_width
    }

    pub fn high(&self) -> f64 {
        self.value + self.half_width
    }

    /// Whether the interval contains this value.
    pub fn holds(&self, value: f64) -> bool {
        (value - self.value).abs() <= self.half_width
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Estimates {
    pub mass: Estimate,
    pub damping: Estimate,
    /// Stiffness in N/m, and rest position in m, measured from the reference.
    pub spring: Option<[Estimate; 2]>,
    pub gain: Option<Estimate>,
    pub latency: Option<Estimate>,
    pub friction: Option<Estimate>,
    /// Time constant of the amplifier, in s.
    pub lag: Option<Estimate>,
    pub offset: Option<Estimate>,
    /// Three values of Stribeck friction: static minus Coulomb friction in N, static friction in N, and Stribeck speed
    /// in m/s.
    pub stribeck: Option<[Estimate; 3]>,
    /// Three values of cogging: amplitude in N, phase at position 0 in rad, and pitch in m.
    pub cogging: Option<[Estimate; 3]>,
    /// Four values of the encoder's error: amplitude of the part that repeats once per cycle and of the part that
    /// repeats twice, in m, phase at position 0 in rad, and cycle in m.
    pub phase: Option<[Estimate; 4]>,
    /// The largest ratio of an interval's half-width to its half-width for white noise.
    pub widening: f64,
    /// The terms that are not in the model and have widened an interval.
    pub hidden: Included,
    pub joint: Joint,
}

impl Estimates {
    /// Widens each interval until it contains the interval of `other`.
    pub fn hold(&mut self, other: &Self) {
        let widen = |own: &mut Estimate, other: &Estimate| {
            own.half_width = own.half_width.hypot(own.value - other.value);
        };
        let before = *self;
        widen(&mut self.mass, &other.mass);
        widen(&mut self.damping, &other.damping);
        for (own, other) in self.spring.iter_mut().flatten().zip(other.spring.iter().flatten()) {
            widen(own, other);
        }
        for (own, other) in [
            (&mut self.gain, &other.gain),
            (&mut self.latency, &other.latency),
            (&mut self.friction, &other.friction),
            (&mut self.lag, &other.lag),
            (&mut self.offset, &other.offset),
        ] {
            own.iter_mut().zip(other).for_each(|(own, other)| widen(own, other));
        }
        self.follow(&before);
    }

    /// Widens the joint error as much as the intervals have grown. `before` has the intervals before they grew.
    fn follow(&mut self, before: &Self) {
        let wider = self.numbers().into_iter().zip(before.numbers());
        for (deviation, wider) in self.joint.deviations.iter_mut().zip(wider) {
            if let (Some(own), Some(was)) = wider
                && was.half_width > 0.0
            {
                *deviation *= own.half_width / was.half_width;
            }
        }
    }

    /// Widens the intervals until they contain the values `other`. These values explain the record as well as `own`
    /// does.
    pub fn reach(&mut self, own: &Values, other: &Values) {
        let [before, after] = [own, other].map(|values| (values, values.layout()));
        let of = |(values, layout): (&Values, &Layout)| {
            let [stiffness, constant] = values.spring();
            let rest = layout.rest_m.unwrap_or(constant / stiffness);
            (stiffness, rest, wave(values, COGS))
        };
        let (a, b) = (of(before), of(after));
        let far = |own: &mut Estimate, by: f64| {
            if own.half_width > 0.0 && by.is_finite() {
                own.half_width = own.half_width.max(by.abs());
            }
        };
        let by = |parameter| other.of(parameter) - own.of(parameter);
        let was = *self;
        far(&mut self.mass, by(Mass));
        far(&mut self.damping, by(Damping));
        if let Some([stiffness, rest]) = &mut self.spring {
            far(stiffness, b.0 - a.0);
            far(rest, b.1 - a.1);
        }
        for (estimate, parameter) in [
            (&mut self.gain, Gain),
            (&mut self.latency, Latency),
            (&mut self.friction, Friction),
            (&mut self.lag, Lag),
            (&mut self.offset, Constant),
        ] {
            estimate.iter_mut().for_each(|one| far(one, by(parameter)));
        }
        if let Some([rise, at_rest, fall]) = &mut self.stribeck {
            far(rise, by(Rise));
            far(at_rest, by(Rise) + by(Friction));
            far(fall, by(Fall));
        }
        if let Some(cogging) = &mut self.cogging {
            let moves = a.2.into_iter().zip(b.2);
            cogging.iter_mut().zip(moves).for_each(|(one, (a, b))| far(one, b - a));
        }
        self.follow(&was);
    }

    /// The estimates in the order of [`NUMBERS`](super::joint::NUMBERS).
    fn numbers(&self) -> [Option<Estimate>; NUMBERS] {
        let [stiffness, rest] = self.spring.map_or([None; 2], |spring| spring.map(Some));
        [Some(self.mass), Some(self.damping), stiffness, rest, self.gain, self.latency]
    }
}

/// The parameters of a wave over the position: the sine part and the cosine part at the reference, and the cycles per
/// metre.
const COGS: [Parameter; 3] = [CogSine, CogCosine, CogCycles];
const ENCODER: [Parameter; 3] = [Sine, Cosine, Cycles];

/// Amplitude of a wave, its phase at position 0, and the length of its cycle.
fn wave(values: &Values, parameters: [Parameter; 3]) -> [f64; 3] {
    let [sine, cosine, cycles] = parameters.map(|one| values.of(one));
    let phase = cosine.atan2(sine) - TAU * values.layout().reference_m * cycles;
    [sine.hypot(cosine), phase, 1.0 / cycles]
}

/// Half-width of an interval divided by the standard error, if the record has many rows.
pub(super) fn quantile() -> f64 {
    Normal::standard().inverse_cdf(f64::midpoint(1.0, CONFIDENCE))
}

/// Standard error of an estimate, computed from its interval. It holds for many rows.
pub(super) fn standard_error(estimate: &Estimate) -> f64 {
    estimate.half_width / quantile()
}

/// A parameter that is not part of the model.
pub(super) struct Hidden {
    /// Derivative of the positions with respect to the parameter.
    pub by: DVector<f64>,
    /// The part of this derivative that is orthogonal to the model's own derivatives.
    pub left: DVector<f64>,
    /// The parameter is never larger than this value, whatever the record is.
    pub most: f64,
    /// The largest change of a value that has widened its interval, in half-widths; 0 if no interval was widened.
    pub widens: f64,
}

/// The estimates of a solution. A `hidden` parameter may have any size that the record allows. Suppose that it could
/// move a value far outside of the value's interval. Then the interval is widened to contain the change.
///
/// # Errors
/// The record cannot distinguish some parameters, or `stop` was set. The message names these parameters.
pub(super) fn estimates(
    solution: &Solution,
    (weighed, weighting): (&Weighed, &Weighting),
    hidden: &mut [&mut Hidden],
    stop: &AtomicBool,
) -> Result<Estimates, String> {
    let (pieces, residual) = (&weighed.pieces()[..], &weighed.found);
    let (values, layout) = (&solution.values, solution.values.layout());
    let influence = influence(solution, weighed.unit_m)?;
    let rows = weighting.rows(influence.nrows());
    let freedom = (rows - values.vector().len() as f64).max(1.0);
    let weighed_unit = weighed.unit_m;
    let weighed: Vec<f64> =
        solution.weighed_m.iter().map(|error_m| error_m / weighed_unit).collect();
    let variance = weighed.iter().map(|r| r * r).sum::<f64>() / freedom;
    let quantile = StudentsT::new(0.0, 1.0, freedom)
        .map_err(|error| format!("no intervals: {error}"))?
        .inverse_cdf(f64::midpoint(1.0, CONFIDENCE));
    let mut widening: f64 = 1.0;
    let mut half_widths = vec![];
    let raw: Vec<f64> = match weighting.is_force() {
        true => weighed.clone(),
        false => pieces.iter().flat_map(|piece| piece.residual).copied().collect(),
    };
    let of_rows = raw.iter().map(|r| r * r).sum::<f64>() / raw.len() as f64;
    let model = ErrorModel::new(residual, of_rows, weighting.is_force());
    let columns: Vec<Vec<f64>> = influence
        .column_iter()
        .map(|column| {
            let mut column: Vec<f64> = column.iter().copied().collect();
            weighting.of_rows(&mut column);
            column
        })
        .collect();
    let mut seen = vec![];
    for (column, weighed) in columns.iter().zip(influence.column_iter()) {
        interrupt::unless(stop).map_err(|error| error.to_string())?;
        let white = variance * weighed.norm_squared();
        seen.push(model.seen(column, pieces));
        let modelled = seen.last().map_or(0.0, |seen| model.covariance(seen, seen));
        let larger = modelled.max(robust(column, (&raw, pieces), stop));
        let stated = larger.max(white);
        if white > 0.0 {
            widening = widening.max((stated / white).sqrt());
        }
        half_widths.push([stated, white].map(|variance| quantile * variance.sqrt()));
    }
    for Hidden { by, left, most, widens } in hidden.iter_mut().map(|one| &mut **one) {
        let per_square = 1.0 / left.norm_squared();
        let mut column: Vec<f64> =
            left.iter().map(|value| value * per_square * weighed_unit).collect();
        let white = variance * column.iter().map(|q| q * q).sum::<f64>();
        weighting.of_rows(&mut column);
        let seen = model.seen(&column, pieces);
        let larger = model.covariance(&seen, &seen).max(robust(&column, (&raw, pieces), stop));
        let value = left.dot(&solution.weighed_m) * per_square;
        let size = (value.abs() + quantile * larger.max(white).sqrt()).min(*most);
        for (own, [stated, _]) in influence.column_iter().zip(&mut half_widths) {
            let change = (own.dot(by) / weighed_unit).abs() * size;
            if change > FAR_OUTSIDE * *stated {
                *widens = widens.max(change / *stated);
                *stated += change;
            }
        }
    }
    let joint = joint(layout, &model.correlations(&seen), &half_widths);
    let mut half_widths = half_widths.into_iter();
    let mut next = |value: f64| {
        let [half_width, white_half_width] = half_widths.next().unwrap_or([f64::INFINITY; 2]);
        Estimate { value, half_width, white_half_width }
    };
    let [stiffness, constant] = values.spring();
    let free = |parameter| values.fitted(parameter);
    // The order of these estimates is the order of the columns of `influence`.
    Ok(Estimates {
        mass: next(values.of(Mass)),
        damping: next(values.of(Damping)),
        spring: layout.spring.then(|| {
            let stiffness_estimate = next(stiffness);
            let rest = layout.rest_m.map(Estimate::given);
            [stiffness_estimate, rest.unwrap_or_else(|| next(constant / stiffness))]
        }),
        gain: free(Gain).map(&mut next),
        latency: free(Latency).map(&mut next),
        friction: free(Friction).map(&mut next),
        lag: free(Lag).map(&mut next),
        offset: layout.terms.offset.then(|| next(free(Constant).unwrap_or_default())),
        stribeck: free(Rise)
            .zip(free(Fall))
            .map(|(rise, fall)| [rise, values.of(Friction) + rise, fall].map(&mut next)),
        cogging: layout.terms.cogging.then(|| {
            let [amplitude, phase, pitch] = wave(values, COGS);
            let (amplitude, phase) = (next(amplitude), next(phase));
            let known = layout.cogs_per_m.map(|_| Estimate::given(pitch));
            [amplitude, phase, known.unwrap_or_else(|| next(pitch))]
        }),
        phase: layout.terms.phase.then(|| {
            let [first, phase, cycle] = wave(values, ENCODER);
            let first = next(first);
            let second = free(Second).map_or(Estimate::given(0.0), &mut next);
            let phase = next(phase);
            let known = layout.cycles_per_m.map(|_| Estimate::given(cycle));
            [first, second, phase, known.unwrap_or_else(|| next(cycle))]
        }),
        widening,
        hidden: Included::default(),
        joint,
    })
}

/// Joint error of the device's parameters. It is computed from the half-widths of the intervals. In `half_widths` these
/// parameters come first.
fn joint(layout: &Layout, correlations: &[Vec<f64>], half_widths: &[[f64; 2]]) -> Joint {
    let free = |parameter| layout.place(parameter).is_some();
    let fitted: [bool; NUMBERS] = [
        true,
        true,
        layout.spring,
        layout.spring && layout.rest_m.is_none(),
        free(Gain),
        free(Latency),
    ];
    let places: Vec<usize> = (0..NUMBERS).filter(|place| fitted[*place]).collect();
    let mut joint = Joint::default();
    for (n, &place) in places.iter().enumerate() {
        let half_width = half_widths[n][0];
        joint.deviations[place] =
            standard_error(&Estimate { value: 0.0, half_width, white_half_width: half_width });
        for (m, &other) in places.iter().enumerate() {
            joint.correlations[place][other] = correlations[n][m];
        }
    }
    joint
}

/// Gradient of each estimate at the solution. A gradient is a list of pairs: the index of a fitted parameter, and the
/// derivative with respect to it.
fn gradients(values: &Values) -> Vec<Vec<(usize, f64)>> {
    let layout = values.layout();
    let place = |parameter| layout.place(parameter);
    let mut all = vec![vec![(MASS, 1.0)], vec![(DAMPING, 1.0)]];
    let alone = |place: Option<usize>| place.map(|place| vec![(place, 1.0)]);
    if let Some(stiffness) = place(Stiffness) {
        all.push(vec![(stiffness, 1.0)]);
        if let (None, Some(constant)) = (layout.rest_m, place(Constant)) {
            let [k, c] = values.spring();
            all.push(vec![(stiffness, -c / (k * k)), (constant, 1.0 / k)]);
        }
    }
    all.extend([Gain, Latency, Friction, Lag].into_iter().filter_map(|one| alone(place(one))));
    if layout.terms.offset {
        all.extend(alone(place(Constant)));
    }
    if let (Some(friction), Some(rise), Some(fall)) = (place(Friction), place(Rise), place(Fall)) {
        all.extend([vec![(rise, 1.0)], vec![(friction, 1.0), (rise, 1.0)], vec![(fall, 1.0)]]);
    }
    for [sine, cosine, cycles] in [COGS, ENCODER] {
        let (Some(at_sine), Some(at_cosine)) = (place(sine), place(cosine)) else { continue };
        let (s, c) = (values.of(sine), values.of(cosine));
        let squared = (s * s + c * c).max(f64::MIN_POSITIVE);
        let amplitude = squared.sqrt();
        all.push(vec![(at_sine, s / amplitude), (at_cosine, c / amplitude)]);
        if sine == Sine {
            all.extend(alone(place(Second)));
        }
        let mut phase = vec![(at_sine, -c / squared), (at_cosine, s / squared)];
        phase.extend(place(cycles).map(|place| (place, -TAU * layout.reference_m)));
        all.push(phase);
        all.extend(place(cycles).map(|place| vec![(place, -1.0 / values.of(cycles).powi(2))]));
    }
    all
}

/// How much each estimate changes if the position of one row has an error of one unit. The result has a value for each
/// row.
fn influence(solution: &Solution, unit_m: f64) -> Result<DMatrix<f64>, String> {
    let (layout, count) = (solution.values.layout(), solution.values.vector().len());
    let mut jacobian = solution.jacobian.clone();
    let scales: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
    if let Some(place) = scales.iter().position(|scale| *scale == 0.0) {
        return Err(format!("the record does not depend on {}", names(layout, count)[place]));
    }
    for (mut column, scale) in jacobian.column_iter_mut().zip(&scales) {
        column.unscale_mut(*scale);
    }
    let triangle = jacobian.clone().qr().unpack_r();
    let svd = triangle.clone().svd(false, true);
    let (largest, smallest) = (svd.singular_values.max(), svd.singular_values.min());
    if smallest * CONDITION_MAX < largest || smallest.is_nan() {
        return Err(indistinguishable(&svd, layout, count));
    }
    let gradients = gradients(&solution.values);
    let mut outputs = DMatrix::zeros(count, gradients.len());
    for (column, parts) in gradients.iter().enumerate() {
        for (place, part) in parts {
            outputs[(*place, column)] = *part;
        }
    }
    for (mut row, scale) in outputs.row_iter_mut().zip(&scales) {
        row.unscale_mut(*scale);
    }
    let singular = || "the record cannot tell the parameters apart".to_owned();
    let half = triangle.transpose().solve_lower_triangular(&outputs).ok_or_else(singular)?;
    let inner = triangle.solve_upper_triangular(&half).ok_or_else(singular)?;
    Ok(jacobian * inner * unit_m)
}

/// Error message that names the parameters which the record cannot distinguish. They lie along the direction about
/// which the record has the least information.
fn indistinguishable(
    svd: &nalgebra::SVD<f64, nalgebra::Dyn, nalgebra::Dyn>,
    layout: &Layout,
    count: usize,
) -> String {
    let weakest = svd.v_t.as_ref().map(|v_t| v_t.row(svd.singular_values.imin()).transpose());
    let weakest: DVector<f64> = weakest.unwrap_or_else(|| DVector::zeros(count));
    let largest = weakest.amax();
    let all = names(layout, count);
    let named = weakest.iter().zip(&all).filter(|(part, _)| part.abs() >= NAMED_SHARE * largest);
    let named: Vec<&str> = named.map(|(_, name)| *name).collect();
    format!(
        "the record cannot tell {} apart: they change the response in the same way",
        named.join(", ")
    )
}

fn names(layout: &Layout, count: usize) -> Vec<&'static str> {
    let mut names: Vec<&'static str> = layout.fitted().map(|parameter| parameter.name()).collect();
    while names.len() < count {
        names.extend(["first position", "first speed"]);
    }
    names
}

/// Variance of an estimate. It is computed from the residual itself, including the residual's correlation in time.
fn robust(column: &[f64], (errors, pieces): (&[f64], &[Piece<'_>]), stop: &AtomicBool) -> f64 {
    let scores: Vec<f64> = column.iter().zip(errors).map(|(q, r)| q * r).collect();
    let mut rest = &scores[..];
    let own = pieces.iter().map(|piece| {
        let (own, others) = rest.split_at(piece.residual.len());
        rest = others;
        long_run(own, stop)
    });
    own.sum()
}

/// Newey-West variance of the sum of `scores`. If `stop` is set, the value has no meaning.
fn long_run(scores: &[f64], stop: &AtomicBool) -> f64 {
    let lagged = |lag: usize| -> f64 {
        scores.iter().zip(scores.iter().skip(lag)).map(|(a, b)| a * b).sum()
    };
    let power = lagged(0);
    if !power.is_finite() {
        return f64::INFINITY;
    }
    if power <= 0.0 {
        return 0.0;
    }
    let rho = (lagged(1) / power).clamp(-0.999, 0.999);
    let alpha = 4.0 * rho * rho / ((1.0 - rho * rho).powi(2));
    let rows = scores.len() as f64;
    let bandwidth = (1.1447 * (alpha * rows).cbrt()).min(0.1 * rows);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a tenth of the rows"
    )]
    let lags = bandwidth.floor() as usize;
    let lags = (1..=lags).take_while(|_| !stop.load(Relaxed));
    let weighted = lags.map(|lag| (1.0 - lag as f64 / (bandwidth + 1.0)) * lagged(lag));
    (power + 2.0 * weighted.sum::<f64>()).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::identify::residual::Residual;

    fn modelled(column: &[f64], piece: Piece<'_>, residual: &Residual) -> f64 {
        let model = ErrorModel::new(residual, 1.0 / 12.0, false);
        let seen = model.seen(column, &[piece]);
        model.covariance(&seen, &seen)
    }

    #[test]
    fn at_rest_the_sawtooth_is_one_constant_error() {
        let column = [0.01; 400];
        let piece = Piece { residual: &[0.25; 400], position: &[3.25; 400] };
        let residual = Residual::new(&[piece], 1e-6, 1e-6);
        let variance = modelled(&column, piece, &residual);
        assert!((variance / (16.0 / 12.0) - 1.0).abs() < 0.02, "{variance}");
    }

    #[test]
    fn in_motion_it_is_white_noise() {
        let position: Vec<f64> = (0..4000).map(|n| 1e-3 * f64::from(n).powf(1.9)).collect();
        let error: Vec<f64> = position.iter().map(|x| x.floor() + 0.5 - x).collect();
        let piece = Piece { residual: &error, position: &position };
        let residual = Residual::new(&[piece], 1e-6, 1e-6);
        let column = [0.01; 4000];
        let variance = modelled(&column, piece, &residual);
        let white = 4000.0 * 1e-4 / 12.0;
        println!("in motion {variance:.4}, white {white:.4}");
        assert!((0.9..1.6).contains(&(variance / white)));
    }

    #[test]
    fn the_robust_variance_is_that_of_coloured_noise() {
        use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
        // An autoregression with r = 0.9 has a long-run variance of 1 / (1 - 0.9)^2 per row.
        let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
        let mut mean = 0.0;
        for _ in 0..20 {
            let mut value = 0.0;
            let scores: Vec<f64> = (0..20_000)
                .map(|_| {
                    value = 0.9 * value + (random.random::<f64>() - 0.5) * 12f64.sqrt();
                    value
                })
                .collect();
            mean += long_run(&scores, &AtomicBool::new(false)) / 20_000.0 / 20.0;
        }
        println!("long-run variance {mean:.1}, theory 100");
        assert!((85.0..110.0).contains(&mean));
    }
}
