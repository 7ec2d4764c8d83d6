//! First values for the fit, from the record alone: linear regression on the equation of motion integrated twice.
//!
//! ```text
//! x = x1 + (v1 + d x1) t - d I(x) - w I(I(x)) + g I(I(u)) + o t^2 / 2       I = integral from the first row
//! ```
//! Integrals smooth noise, so no filter has to be chosen; nothing is differentiated. The same without a mass,
//! `x = x1 - (w/d) I(x) + (g/d) I(u) + (o/d) t`, tells a device whose damping hides its mass.

use nalgebra::{DMatrix, DVector};

use super::{
    model::{Held, Reduced},
    record::Record,
};

/// Rows of a regression: more would not make a first value better.
const ROWS: usize = 4000;

/// Time, position and integrals at one row.
struct Sums {
    t: f64,
    x: f64,
    x1: f64,
    x2: f64,
    u1: f64,
    u2: f64,
}

/// Reduced parameters from a record, positions from a reference; `None` if the equations have no solution.
pub(super) fn guess(
    record: &Record,
    positions_m: &[f64],
    first: usize,
    latency: f64,
) -> Option<Reduced> {
    let sums = integrate(record, positions_m, first, latency);
    let columns = |s: &Sums| [1.0, s.t, -s.x1, -s.x2, s.u2, 0.5 * s.t * s.t];
    let ([x, slope, d, w, gain, offset], _) = regress(&sums, columns)?;
    Some(Reduced { w, d, gain, offset, x, v: slope - d * x, latency })
}

/// The part of the motion's variance that a device without a mass explains, if the voltage drives it forward.
pub(super) fn without_mass(
    record: &Record,
    positions_m: &[f64],
    first: usize,
    latency: f64,
) -> Option<f64> {
    let sums = integrate(record, positions_m, first, latency);
    let ([_, _, drive, _], explained) = regress(&sums, |s: &Sums| [1.0, -s.x1, s.u1, s.t])?;
    (drive > 0.0).then_some(explained)
}

fn integrate(record: &Record, positions_m: &[f64], first: usize, latency: f64) -> Vec<Sums> {
    let held = Held::new(record, latency);
    let dt = record.step_s;
    let (early, late) = (held.fraction * dt, (1.0 - held.fraction) * dt);
    let rows = record.len() - first;
    let every = rows.div_ceil(ROWS);
    let (mut x1, mut x2, mut u1, mut u2) = (0.0, 0.0, 0.0, 0.0);
    let mut kept = Vec::with_capacity(rows / every + 1);
    for row in first..record.len() {
        let (n, x) = (row - first, positions_m[row]);
        if n.is_multiple_of(every) {
            kept.push(Sums { t: n as f64 * dt, x, x1, x2, u1, u2 });
        }
        let mean = positions_m.get(row + 1).map_or(x, |next| f64::midpoint(x, *next));
        x2 += x1 * dt + 0.5 * mean * dt * dt;
        x1 += mean * dt;
        let (before, after) = held.at(row);
        u2 += u1 * dt + before * early * (0.5 * early + late) + after * 0.5 * late * late;
        u1 += before * early + after * late;
    }
    kept
}

/// Coefficients of the columns, and the part of the variance of x that they explain.
fn regress<const N: usize>(
    sums: &[Sums],
    columns: impl Fn(&Sums) -> [f64; N],
) -> Option<([f64; N], f64)> {
    let mut table = DMatrix::from_row_iterator(sums.len(), N, sums.iter().flat_map(&columns));
    let measured = DVector::from_iterator(sums.len(), sums.iter().map(|s| s.x));
    let mut scales = [0.0; N];
    for (mut column, scale) in table.column_iter_mut().zip(&mut scales) {
        *scale = column.norm();
        if *scale == 0.0 {
            return None;
        }
        column.unscale_mut(*scale);
    }
    let solution = table.clone().svd(true, true).solve(&measured, f64::EPSILON).ok()?;
    let left = (&measured - table * &solution).norm_squared();
    let explained = 1.0 - left / measured.add_scalar(-measured.mean()).norm_squared();
    let coefficients = std::array::from_fn(|column| solution[column] / scales[column]);
    coefficients.iter().all(|value: &f64| value.is_finite()).then_some((coefficients, explained))
}
