//! Least squares over all parameters and all records at once.
//!
//! The parameters are m, b; where they are asked for k and c = k (x0 - reference), the gain, the latency; then
//! position and speed of each record at its first fitted row. Residual and model are in metres.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::{DMatrix, DVector, Dyn, Owned};

use super::{
    model::{Point, Reduced, response},
    record::Record,
};

/// Evaluations per parameter before the solver gives up; it needs about five in all.
const PATIENCE: usize = 50;
/// Stands for a model that is not finite: the solver then takes a shorter step.
const FAR: f64 = 1e100;

pub(super) const MASS: usize = 0;
pub(super) const DAMPING: usize = 1;
/// Parameters that every fit has.
const COMMON: usize = 2;

/// A record prepared for the fit.
#[derive(Clone, Debug)]
pub(super) struct Fitted<'a> {
    pub record: &'a Record,
    /// Position at each row from the reference, half a count above the floor, m.
    pub positions_m: Vec<f64>,
    /// First row that is fitted: before it, commands from before the record still act.
    pub first: usize,
    /// Mass that was added to the device, kg.
    pub added_kg: f64,
}

impl Fitted<'_> {
    pub(super) fn rows(&self) -> usize {
        self.record.len() - self.first
    }
}

/// Which parameters are fitted, and the values of the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Layout {
    /// The device has a spring; without one k and c are 0.
    pub spring: bool,
    /// Force per volt if it is known, N/V.
    pub gain: Option<f64>,
    /// Latency if it is known, s.
    pub latency_s: Option<f64>,
}

impl Layout {
    /// Place of the stiffness, if it is fitted; that of c follows.
    pub(super) fn spring_place(&self) -> Option<usize> {
        self.spring.then_some(COMMON)
    }

    /// Place of the gain, if it is fitted.
    pub(super) fn gain_place(&self) -> Option<usize> {
        self.gain.is_none().then_some(COMMON + 2 * usize::from(self.spring))
    }

    /// Place of the latency, if it is fitted.
    pub(super) fn latency_place(&self) -> Option<usize> {
        let before = 2 * usize::from(self.spring) + usize::from(self.gain.is_none());
        self.latency_s.is_none().then_some(COMMON + before)
    }

    /// Place of a record's first position; its speed follows.
    pub(super) fn state_place(&self, record: usize) -> usize {
        let free = 2 * usize::from(self.spring)
            + usize::from(self.gain.is_none())
            + usize::from(self.latency_s.is_none());
        COMMON + free + 2 * record
    }

    /// Number of parameters.
    pub(super) fn count(&self, records: usize) -> usize {
        self.state_place(records)
    }

    /// k and c.
    pub(super) fn spring_of(&self, values: &DVector<f64>) -> [f64; 2] {
        self.spring_place().map_or([0.0; 2], |place| [values[place], values[place + 1]])
    }

    pub(super) fn gain_of(&self, values: &DVector<f64>) -> f64 {
        let fitted = self.gain_place().map(|place| values[place]);
        self.gain.or(fitted).unwrap_or_default()
    }

    pub(super) fn latency_of(&self, values: &DVector<f64>) -> f64 {
        let fitted = self.latency_place().map(|place| values[place]);
        self.latency_s.or(fitted).unwrap_or_default()
    }
}

/// The problem, at its current parameters.
#[derive(Clone, Debug)]
pub(super) struct Problem<'a> {
    pub records: &'a [Fitted<'a>],
    pub layout: Layout,
    pub values: DVector<f64>,
}

impl Problem<'_> {
    fn reduced(&self, index: usize) -> Reduced {
        let (values, fitted) = (&self.values, &self.records[index]);
        let mass = values[MASS] + fitted.added_kg;
        let state = self.layout.state_place(index);
        let [stiffness, constant] = self.layout.spring_of(values);
        Reduced {
            w: stiffness / mass,
            d: values[DAMPING] / mass,
            gain: self.layout.gain_of(values) / mass,
            offset: constant / mass,
            x: values[state],
            v: values[state + 1],
            latency: self.layout.latency_of(values) / fitted.record.step_s,
        }
    }

    /// The model at each fitted row of a record; `None` where it is not finite or the mass is not positive.
    pub(super) fn points(&self, index: usize) -> Option<Vec<Point>> {
        let reduced = self.reduced(index);
        let mass = self.values[MASS];
        let sane = mass > 0.0 && reduced.w.abs() < FAR && reduced.d.abs() < FAR;
        let points = (sane && self.values.iter().all(|value| value.is_finite()))
            .then(|| response(self.records[index].record, self.records[index].first, &reduced))?;
        points.iter().all(|point| point.x.abs() < FAR).then_some(points)
    }

    /// Rows of the derivatives by the parameters.
    fn fill(&self, index: usize, points: &[Point], top: usize, jacobian: &mut DMatrix<f64>) {
        let reduced = self.reduced(index);
        let mass = self.values[MASS] + self.records[index].added_kg;
        let state = self.layout.state_place(index);
        for (n, point) in points.iter().enumerate() {
            let row = top + n;
            let by_mass = reduced.w * point.by_w
                + reduced.d * point.by_d
                + reduced.gain * point.by_gain
                + reduced.offset * point.by_offset;
            jacobian[(row, MASS)] = -by_mass / mass;
            jacobian[(row, DAMPING)] = point.by_d / mass;
            if let Some(place) = self.layout.spring_place() {
                jacobian[(row, place)] = point.by_w / mass;
                jacobian[(row, place + 1)] = point.by_offset / mass;
            }
            if let Some(place) = self.layout.gain_place() {
                jacobian[(row, place)] = point.by_gain / mass;
            }
            if let Some(place) = self.layout.latency_place() {
                jacobian[(row, place)] = point.by_latency / self.records[index].record.step_s;
            }
            jacobian[(row, state)] = point.by_x;
            jacobian[(row, state + 1)] = point.by_v;
        }
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
        self.values.copy_from(values);
    }

    fn params(&self) -> DVector<f64> {
        self.values.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let mut residuals = Vec::with_capacity(self.rows());
        for (index, fitted) in self.records.iter().enumerate() {
            let Some(points) = self.points(index) else {
                return Some(DVector::from_element(self.rows(), FAR));
            };
            let measured = &fitted.positions_m[fitted.first..];
            residuals.extend(points.iter().zip(measured).map(|(point, x)| point.x - x));
        }
        Some(DVector::from_vec(residuals))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let mut jacobian = DMatrix::zeros(self.rows(), self.values.len());
        let mut top = 0;
        for (index, fitted) in self.records.iter().enumerate() {
            let points = self.points(index)?;
            self.fill(index, &points, top, &mut jacobian);
            top += fitted.rows();
        }
        jacobian.iter().all(|value| value.is_finite()).then_some(jacobian)
    }
}

/// The solution, with residual (measured less model) and derivatives there.
pub(super) struct Solution {
    pub values: DVector<f64>,
    pub residual_m: DVector<f64>,
    pub jacobian: DMatrix<f64>,
    /// Times that the model was computed.
    pub evaluations: usize,
}

/// Solves from the problem's values.
///
/// # Errors
/// Why the solver ended without a solution.
pub(super) fn solve(problem: Problem<'_>) -> Result<Solution, String> {
    let solver = LevenbergMarquardt::new().with_patience(PATIENCE);
    let (problem, report) = solver.minimize(problem);
    // At the limit of rounding the solver says so instead of `converged`: it is the minimum all the same.
    let done = report.termination.was_successful()
        || matches!(report.termination, TerminationReason::NoImprovementPossible(_));
    let hopeless = || {
        "no mass, damping and stiffness describe this record: something else moved or held the handle".to_owned()
    };
    if !done {
        return Err(hopeless());
    }
    let residual = problem.residuals().ok_or_else(hopeless)?;
    let jacobian = problem.jacobian().ok_or_else(hopeless)?;
    let evaluations = report.number_of_evaluations;
    Ok(Solution { values: problem.values, residual_m: -residual, jacobian, evaluations })
}
