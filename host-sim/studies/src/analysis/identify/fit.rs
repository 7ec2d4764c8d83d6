//! Least squares over all parameters and all records at once.
//!
//! The parameters are m, b, the gain, the latency and the terms of [`super::terms`]. With a spring, k and c = k (x0 -
//! reference) are also parameters. Position and speed of each record at its first fitted row come last. Residual and
//! model are in metres. Without friction, lag and encoder error the derivatives are exact. Otherwise the derivatives
//! are differences of the exact motion.

use std::{
    f64::consts::TAU,
    sync::atomic::{AtomicBool, Ordering::Relaxed},
};

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::{DMatrix, DVector, Dyn, Owned};

use super::{
    layout::{
        DAMPING, MASS, Parameter,
        Parameter::{
            CogCosine, CogCycles, CogSine, Constant, Cosine, Cycles, Damping, Fall, Friction, Gain,
            Lag, Latency, Mass, Rise, Second, Sine, Stiffness,
        },
        Values,
    },
    model::{Point, Reduced, response},
    motion::{self, Motion},
    record::Record,
    weighting::Weighting,
};

/// Largest number of evaluations per parameter. The solver usually needs about five evaluations in total.
const PATIENCE: usize = 50;
/// Like [`PATIENCE`], for a fit with further terms. It is lower, because such searches fail often and each evaluation
/// takes longer.
const PATIENCE_OF_TERMS: usize = 8;
/// Change of the sum of squares and of the values below which a search with derivatives by differences ends, as a
/// share.
const TOLERANCE: f64 = 1e-10;
/// Replaces a model value that is not finite. The solver then takes a shorter step.
const FAR: f64 = 1e100;

/// Change of a parameter for a derivative by differences, as a share of its resolution.
const DIFFERENCE: f64 = 1e-6;
/// Like [`DIFFERENCE`], if the motion is computed in short stretches.
const DIFFERENCE_CURVED: f64 = 1e-4;
/// Largest number of times that derivatives are computed again as differences. For these differences, the parameters
/// change by their standard errors.
const SECANTS: usize = 6;
/// Largest difference of two sets of derivatives that count as equal, as a share.
const SECANT_SAME: f64 = 0.02;

/// Largest number of Gauss-Newton steps, and of halvings of one step.
const POLISHES: usize = 20;
const HALVINGS: i32 = 6;
/// Smallest reduction of the sum of squares by a useful step, as a share of the mean square. [`PROFILED`] is this share
/// for a fit with one fixed value.
const POLISHED: f64 = 1e-2;
const PROFILED: f64 = 0.1;

/// A record prepared for the fit.
#[derive(Clone, Debug)]
pub(super) struct Fitted<'a> {
    pub record: &'a Record,
    /// Position of each row in m, measured from the reference. If the quantiser rounds down, half a count is added.
    pub positions_m: Vec<f64>,
    /// First row that is fitted. Commands from before the record still act at earlier rows, so these are left out.
    pub first: usize,
    /// Mass that was added to the device for this record, in kg.
    pub added_kg: f64,
    /// Becomes true when the search must stop.
    pub stop: &'a AtomicBool,
}

impl Fitted<'_> {
    pub(super) fn rows(&self) -> usize {
        self.record.len() - self.first
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stop.load(Relaxed)
    }
}

/// The least-squares problem at its current parameters.
#[derive(Clone, Debug)]
pub(super) struct Problem<'a> {
    pub records: &'a [Fitted<'a>],
    pub values: Values,
    /// Weighting that makes the residual white.
    pub weighting: &'a Weighting,
}

impl Problem<'_> {
    /// Mass of the handle in a record, including the mass that was added.
    fn mass(&self, index: usize) -> f64 {
        self.values.of(Mass) + self.records[index].added_kg
    }

    fn reduced(&self, index: usize) -> Reduced {
        let (values, mass) = (&self.values, self.mass(index));
        let [stiffness, constant] = values.spring();
        let [x, v] = values.start(index);
        Reduced {
            w: stiffness / mass,
            d: values.of(Damping) / mass,
            gain: values.of(Gain) / mass,
            offset: constant / mass,
            x,
            v,
            latency: values.of(Latency) / self.records[index].record.step_s,
        }
    }

    /// The parameters of the motion in [`super::motion`]. That motion has dry friction and a slow amplifier.
    pub(super) fn motion(&self, index: usize) -> Motion {
        let Reduced { w, d, gain, offset, x, v, latency } = self.reduced(index);
        let [friction_n, lag_s] = self.values.slow();
        let friction = friction_n / self.mass(index);
        let [rise, fall, sine, cosine, cycles] =
            [Rise, Fall, CogSine, CogCosine, CogCycles].map(|one| self.values.of(one));
        let (mass, terms) = (self.mass(index), self.values.layout().terms);
        let stribeck = (terms.stribeck && rise > 0.0 && fall > 0.0).then_some([rise / mass, fall]);
        let cogging = terms.cogging.then_some([sine / mass, cosine / mass, TAU * cycles]);
        Motion { w, d, gain, offset, friction, stribeck, cogging, lag_s, x, v, latency }
    }

    /// Adds the encoder's error to positions. The positions are in m, measured from the reference.
    fn add_error(&self, positions_m: &mut [f64]) {
        let [sine, cosine, second, cycles_per_m] =
            [Sine, Cosine, Second, Cycles].map(|parameter| self.values.of(parameter));
        let start = cosine.atan2(sine);
        for x in positions_m {
            let phase = TAU * *x * cycles_per_m;
            let (sin, cos) = phase.sin_cos();
            *x += sine * sin + cosine * cos;
            if second != 0.0 {
                *x += second * (2.0 * (phase + start)).sin();
            }
        }
    }

    fn sane(&self, index: usize) -> Option<Reduced> {
        let reduced = self.reduced(index);
        let mass = self.values.of(Mass);
        let sane = mass > 0.0 && reduced.w.abs() < FAR && reduced.d.abs() < FAR;
        (sane && self.values.vector().iter().all(|value| value.is_finite())).then_some(reduced)
    }

    /// The position and speed of the model at each fitted row of a record. `None` if the model is not finite or the
    /// mass is not positive.
    fn points(&self, index: usize) -> Option<Vec<Point>> {
        let reduced = self.sane(index)?;
        let points = response(self.records[index].record, self.records[index].first, &reduced);
        points.iter().all(|point| point.x.abs() < FAR).then_some(points)
    }

    /// What the encoder of the model reads at each fitted row of a record. `None` if [`points`](Self::points) returns
    /// `None`.
    fn readings(&self, index: usize) -> Option<Vec<f64>> {
        let Fitted { record, first, .. } = &self.records[index];
        let terms = self.values.layout().terms;
        if terms.plain() {
            return Some(self.points(index)?.iter().map(|point| point.x).collect());
        }
        self.sane(index).filter(|_| !self.records[index].is_stopped())?;
        let mut positions_m = motion::positions(record, *first, &self.motion(index));
        if terms.phase {
            self.add_error(&mut positions_m);
        }
        positions_m.iter().all(|x| x.abs() < FAR).then_some(positions_m)
    }

    /// Fills the rows of one record in `jacobian`, the derivatives with respect to the parameters.
    fn fill(&self, index: usize, points: &[Point], top: usize, jacobian: &mut DMatrix<f64>) {
        let (reduced, mass, layout) = (self.reduced(index), self.mass(index), self.values.layout());
        let [stiffness, constant, gain, latency] =
            [Stiffness, Constant, Gain, Latency].map(|parameter| layout.place(parameter));
        let rest_m = layout.rest_m.unwrap_or_default();
        let (position, speed) = (layout.position_place(index), layout.speed_place(index));
        for (n, point) in points.iter().enumerate() {
            let row = top + n;
            let by_mass = reduced.w * point.by_w
                + reduced.d * point.by_d
                + reduced.gain * point.by_gain
                + reduced.offset * point.by_offset;
            jacobian[(row, MASS)] = -by_mass / mass;
            jacobian[(row, DAMPING)] = point.by_d / mass;
            if let Some(place) = stiffness {
                jacobian[(row, place)] = (point.by_w + rest_m * point.by_offset) / mass;
            }
            if let Some(place) = constant {
                jacobian[(row, place)] = point.by_offset / mass;
            }
            if let Some(place) = gain {
                jacobian[(row, place)] = point.by_gain / mass;
            }
            if let Some(place) = latency {
                jacobian[(row, place)] = point.by_latency / self.records[index].record.step_s;
            }
            jacobian[(row, position)] = point.by_x;
            if let Some(place) = speed {
                jacobian[(row, place)] = point.by_v;
            }
        }
    }

    /// How much each parameter changes for a derivative by differences. The changes are shares of the mass, the largest
    /// force and the motion.
    fn differences(&self) -> Vec<f64> {
        let (mass, gain) = (self.values.of(Mass), self.values.of(Gain));
        let all = |pick: fn(&Record) -> &[f64]| -> f64 {
            let largest =
                |record: &Record| pick(record).iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            self.records
                .iter()
                .map(|fitted| largest(fitted.record))
                .fold(f64::MIN_POSITIVE, f64::max)
        };
        let force_n = (gain * all(|record| &record.command)).abs();
        let travel_m = self.records.iter().flat_map(|fitted| &fitted.positions_m);
        let travel_m = travel_m.fold(f64::MIN_POSITIVE, |most, x| most.max(x.abs()));
        let step_s = self.records[0].record.step_s;
        let seconds = self.records.iter().map(|fitted| fitted.rows() as f64 * step_s);
        let seconds = seconds.fold(step_s, f64::max);
        let of = |parameter| match parameter {
            Mass => mass,
            Damping => self.values.of(Damping).abs() + mass / seconds,
            Stiffness => mass / seconds.powi(2) + force_n / travel_m,
            Constant | Friction | Rise | CogSine | CogCosine => force_n,
            Fall => self.values.of(Fall).abs(),
            Gain => gain.abs(),
            Latency | Lag => 1e3 * step_s,
            Sine | Cosine | Second => travel_m,
            Cycles | CogCycles => 1.0 / travel_m,
        };
        let layout = self.values.layout();
        let part = if layout.terms.is_curved() { DIFFERENCE_CURVED } else { DIFFERENCE };
        let mut all: Vec<f64> = layout.fitted().map(|parameter| part * of(parameter)).collect();
        for record in 0..self.records.len() {
            all.push(part * travel_m);
            all.extend(layout.speed_place(record).map(|_| part * travel_m / seconds.min(1.0)));
        }
        all
    }

    /// Derivatives of the residuals by small differences. The parameters are only increased, so that friction and lag
    /// stay above 0.
    pub(super) fn by_differences(&self) -> Option<DMatrix<f64>> {
        let middle = self.stacked()?;
        let mut jacobian = DMatrix::zeros(self.rows(), self.values.vector().len());
        for (place, by) in self.differences().into_iter().enumerate() {
            jacobian.set_column(place, &self.difference(&middle, place, by)?);
        }
        jacobian.iter().all(|value| value.is_finite()).then_some(jacobian)
    }

    fn difference(&self, middle: &DVector<f64>, place: usize, by: f64) -> Option<DVector<f64>> {
        let mut moved = self.clone();
        moved.values.slice_mut()[place] += by;
        Some((moved.stacked()? - middle) / by)
    }

    pub(super) fn by(&self, parameter: Parameter) -> Option<DVector<f64>> {
        let place = self.values.layout().place(parameter)?;
        self.difference(&self.stacked()?, place, self.differences()[place])
    }

    /// Continues to the minimum by Gauss-Newton steps. The derivatives are differences over a change of one standard
    /// error, because derivatives at one point fail where the model has kinks. Returns the derivatives at the minimum,
    /// or `None` if no minimum is reached. If `is_done` is true, it returns the last derivatives instead of `None`.
    fn polish(&mut self, is_done: bool) -> Option<DMatrix<f64>> {
        let mut residual = self.residuals()?;
        let mut jacobian = self.by_differences()?;
        let freedom = (self.weighting.rows(self.rows()) - jacobian.ncols() as f64).max(1.0);
        for _ in 0..POLISHES {
            let square = residual.norm_squared() / freedom;
            jacobian = self.settled(jacobian, square.sqrt());
            let step = least_squares_step(&jacobian, &residual)?;
            let promised = (&jacobian * &step).norm_squared();
            if promised < POLISHED * square {
                return Some(jacobian);
            }
            let better = self.shortened(&residual, &step);
            let Some((values, left)) = better else {
                return (is_done || promised < square).then_some(jacobian);
            };
            let gained = residual.norm_squared() - left.norm_squared();
            (self.values, residual) = (values, left);
            if gained < POLISHED * square {
                return Some(self.settled(jacobian, square.sqrt()));
            }
        }
        is_done.then_some(jacobian)
    }

    /// Repeats [`secants`](Self::secants) until the derivatives no longer change.
    fn settled(&self, mut jacobian: DMatrix<f64>, deviation_m: f64) -> DMatrix<f64> {
        for _ in 0..SECANTS {
            let Some(secants) = self.secants(&jacobian, deviation_m) else { break };
            let change = (&secants - &jacobian).norm() / secants.norm();
            jacobian = secants;
            if change < SECANT_SAME {
                break;
            }
        }
        jacobian
    }

    /// Computes the derivatives as differences. The parameters change by one standard error along the principal axes of
    /// `jacobian`. Stick and slip of friction give the model several kinks within an interval. So the derivative at one
    /// point does not represent the interval.
    fn secants(&self, jacobian: &DMatrix<f64>, deviation_m: f64) -> Option<DMatrix<f64>> {
        let scales: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        let mut scaled = jacobian.clone();
        for (mut column, scale) in scaled.column_iter_mut().zip(&scales) {
            column.unscale_mut(*scale);
        }
        let triangle = scaled.qr().unpack_r();
        if !triangle.iter().all(|value| value.is_finite()) {
            return None;
        }
        let svd = triangle.svd(false, true);
        let axes = svd.v_t?;
        let middle = self.stacked()?;
        let mut along = DMatrix::zeros(self.rows(), scales.len());
        for (axis, singular) in svd.singular_values.iter().enumerate() {
            let size = deviation_m / singular;
            let moved = |by: f64| {
                let mut moved = self.clone();
                let (values, parts) = (moved.values.slice_mut(), axes.row(axis));
                for ((value, scale), part) in values.iter_mut().zip(&scales).zip(&parts) {
                    *value += by * size * part / scale;
                }
                moved.values.is_allowed().then(|| moved.stacked()).flatten()
            };
            let change = match (moved(1.0), moved(-1.0)) {
                (Some(up), Some(down)) => (up - down) / 2.0,
                (Some(up), None) => up - &middle,
                (None, Some(down)) => &middle - down,
                (None, None) => return None,
            };
            along.set_column(axis, &(change / size));
        }
        let mut found = along * axes;
        for (mut column, scale) in found.column_iter_mut().zip(&scales) {
            column.scale_mut(*scale);
        }
        found.iter().all(|value| value.is_finite()).then_some(found)
    }

    /// Fits all other values while one value is fixed. Returns all values and their sum of squares. `square` is the
    /// mean square of the residual.
    pub(super) fn beside(mut self, place: usize, value: f64, square: f64) -> Option<(Values, f64)> {
        self.values.slice_mut()[place] = value;
        self.values.is_allowed().then_some(())?;
        let others: Vec<usize> =
            (0..self.values.vector().len()).filter(|one| *one != place).collect();
        let residual = self.only(&others, PROFILED * square)?;
        Some((self.values, residual.norm_squared()))
    }

    /// Fits position and speed at the first row of each record to the positions. All other values are fixed. Returns the
    /// residual, which is the model minus the measured value.
    pub(super) fn fit_starts(&mut self) -> Option<DVector<f64>> {
        let layout = *self.values.layout();
        let of = |record| [Some(layout.position_place(record)), layout.speed_place(record)];
        let starts: Vec<usize> = (0..self.records.len()).flat_map(of).flatten().collect();
        let square = self.residuals()?.norm_squared() / self.rows() as f64;
        self.only(&starts, PROFILED * square)
    }

    /// Fits the values at these places by Gauss-Newton steps. Ends when a step reduces the sum of squares by less than
    /// `least`. Returns the residual.
    fn only(&mut self, places: &[usize], least: f64) -> Option<DVector<f64>> {
        let mut residual = self.residuals()?;
        for _ in 0..POLISHES {
            let (middle, by) = (self.stacked()?, self.differences());
            let columns = places.iter().map(|&place| self.difference(&middle, place, by[place]));
            let jacobian = DMatrix::from_columns(&columns.collect::<Option<Vec<_>>>()?);
            let mut step = DVector::zeros(by.len());
            for (place, one) in places.iter().zip(&least_squares_step(&jacobian, &residual)?) {
                step[*place] = *one;
            }
            let Some((values, left)) = self.shortened(&residual, &step) else { break };
            let gained = residual.norm_squared() - left.norm_squared();
            (self.values, residual) = (values, left);
            if gained < least {
                break;
            }
        }
        Some(residual)
    }

    /// Takes this step, or the longest part of it that reduces the sum of squares. Returns the values and their
    /// residual. The step is halved up to [`HALVINGS`] times.
    fn shortened(
        &self,
        residual: &DVector<f64>,
        step: &DVector<f64>,
    ) -> Option<(Values, DVector<f64>)> {
        (0..HALVINGS).find_map(|halvings| {
            let mut moved = self.clone();
            let part = 0.5_f64.powi(halvings);
            let values = moved.values.slice_mut().iter_mut();
            values.zip(step).for_each(|(value, step)| *value -= part * step);
            let left = moved.residuals().filter(|_| moved.values.is_allowed())?;
            (left.norm_squared() < residual.norm_squared()).then_some((moved.values, left))
        })
    }

    /// What the model reads at all fitted rows, weighted. The records follow each other.
    fn stacked(&self) -> Option<DVector<f64>> {
        let mut all = Vec::with_capacity(self.rows());
        for index in 0..self.records.len() {
            all.extend(self.weighting.weighed(index, self.readings(index)?));
        }
        Some(DVector::from_vec(all))
    }

    fn rows(&self) -> usize {
        self.records.iter().map(Fitted::rows).sum()
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, values: &DVector<f64>) {
        self.values.slice_mut().copy_from_slice(values.as_slice());
    }

    fn params(&self) -> DVector<f64> {
        self.values.vector().clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        if self.records.iter().any(Fitted::is_stopped) {
            return None; // `None` ends the solver
        }
        let mut residuals = Vec::with_capacity(self.rows());
        for (index, fitted) in self.records.iter().enumerate() {
            let Some(readings) = self.readings(index) else {
                return Some(DVector::from_element(self.rows(), FAR));
            };
            let measured = &fitted.positions_m[fitted.first..];
            let errors = readings.iter().zip(measured).map(|(reading, x)| reading - x);
            residuals.extend(self.weighting.weighed(index, errors.collect()));
        }
        Some(DVector::from_vec(residuals))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        if !self.values.layout().terms.plain() {
            return self.by_differences();
        }
        let mut jacobian = DMatrix::zeros(self.rows(), self.values.vector().len());
        let mut top = 0;
        for (index, fitted) in self.records.iter().enumerate() {
            let points = self.points(index)?;
            self.fill(index, &points, top, &mut jacobian);
            for mut column in
                jacobian.column_iter_mut().filter(|_| !matches!(self.weighting, Weighting::White))
            {
                let mut own = column.rows_mut(top, fitted.rows());
                own.copy_from_slice(&self.weighting.weighed(index, own.iter().copied().collect()));
            }
            top += fitted.rows();
        }
        jacobian.iter().all(|value| value.is_finite()).then_some(jacobian)
    }
}

/// RMS of the measured motion around its mean. All records are taken together.
pub(super) fn motion(fitted: &[Fitted<'_>]) -> f64 {
    let (mut squares, mut rows) = (0.0, 0.0);
    for Fitted { positions_m, first, .. } in fitted {
        let positions = &positions_m[*first..];
        let mean = positions.iter().sum::<f64>() / positions.len() as f64;
        squares += positions.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
        rows += positions.len() as f64;
    }
    (squares / rows).sqrt()
}

/// The solution of a fit with its residual and its derivatives. The residual is the measured value minus the model.
pub(super) struct Solution {
    pub values: Values,
    pub residual_m: DVector<f64>,
    /// The weighted residual.
    pub weighed_m: DVector<f64>,
    pub jacobian: DMatrix<f64>,
    pub evaluations: usize,
}

/// Solves the problem from its current values.
///
/// # Errors
/// The reason why the solver ended without a solution.
pub(super) fn solve(problem: Problem<'_>) -> Result<Solution, String> {
    let solver = LevenbergMarquardt::new();
    let solver = if problem.values.layout().terms.plain() {
        solver.with_patience(PATIENCE)
    } else {
        solver.with_patience(PATIENCE_OF_TERMS).with_ftol(TOLERANCE).with_xtol(TOLERANCE)
    };
    let (mut problem, report) = solver.minimize(problem);
    // At the limit of rounding the solver does not report `converged`, but the minimum is reached.
    let done = report.termination.was_successful()
        || matches!(report.termination, TerminationReason::NoImprovementPossible(_));
    let hopeless = || {
        "no mass, damping and stiffness describe this record: something else moved or held the handle".to_owned()
    };
    let jacobian = match problem.values.layout().terms.plain() {
        true => done.then(|| problem.jacobian()).flatten(),
        false => problem.polish(done),
    };
    let jacobian = jacobian.ok_or_else(hopeless)?;
    let weighed_m = -problem.residuals().ok_or_else(hopeless)?;
    let raw = Problem { weighting: &Weighting::White, ..problem.clone() };
    let residual_m = -raw.residuals().ok_or_else(hopeless)?;
    let evaluations = report.number_of_evaluations;
    Ok(Solution { values: problem.values, residual_m, weighed_m, jacobian, evaluations })
}

/// Standard error of one value, if each row has an error of 1.
pub(super) fn deviation(jacobian: &DMatrix<f64>, place: usize) -> f64 {
    let others = jacobian.clone().remove_column(place);
    let own = jacobian.column(place).into_owned();
    least_squares_step(&others, &own).map_or(0.0, |step| 1.0 / (own - others * step).norm())
}

/// The Gauss-Newton step. Subtract it from the values to move to the minimum.
fn least_squares_step(jacobian: &DMatrix<f64>, residual: &DVector<f64>) -> Option<DVector<f64>> {
    let mut scaled = jacobian.clone();
    let scales: Vec<f64> =
        jacobian.column_iter().map(|column| column.norm().max(f64::MIN_POSITIVE)).collect();
    for (mut column, scale) in scaled.column_iter_mut().zip(&scales) {
        column.unscale_mut(*scale);
    }
    let qr = scaled.qr();
    let mut step = qr.r().solve_upper_triangular(&qr.q().tr_mul(residual))?;
    step.iter_mut().zip(scales).for_each(|(step, scale)| *step /= scale);
    step.iter().all(|step| step.is_finite()).then_some(step)
}
