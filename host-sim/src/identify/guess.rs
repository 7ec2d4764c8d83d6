//! First values for the fit, from the record alone: linear regression on the equation of motion integrated twice.
//!
//! ```text
//! x = x1 + (v1 + d x1) t - d I(x) - w I(I(x)) + g I(I(u)) + o t^2 / 2       I = integral from the first row
//! ```
//! Integrals smooth noise, so no filter has to be chosen; nothing is differentiated.

use nalgebra::{DMatrix, DVector};

use super::{
    model::{Held, Reduced},
    record::Record,
};

/// Columns of the regression.
const COLUMNS: usize = 6;
/// Rows of the regression: more would not make a first value better.
const ROWS: usize = 4000;

/// Reduced parameters from a record, positions from `reference_m`; `None` if the equations have no solution.
pub(super) fn guess(
    record: &Record,
    positions_m: &[f64],
    first: usize,
    latency: f64,
) -> Option<Reduced> {
    let held = Held::new(record, latency);
    let dt = record.step_s;
    let (early, late) = (held.fraction * dt, (1.0 - held.fraction) * dt);
    let rows = record.len() - first;
    let every = rows.div_ceil(ROWS);
    let (mut x1, mut x2, mut u1, mut u2) = (0.0, 0.0, 0.0, 0.0);
    let mut table = Vec::with_capacity(COLUMNS * rows / every + COLUMNS);
    let mut measured = Vec::with_capacity(rows / every + 1);
    for row in first..record.len() {
        let n = row - first;
        let t = n as f64 * dt;
        if n.is_multiple_of(every) {
            table.extend([1.0, t, -x1, -x2, u2, 0.5 * t * t]);
            measured.push(positions_m[row]);
        }
        if let Some(next) = positions_m.get(row + 1) {
            let mean = f64::midpoint(positions_m[row], *next);
            x2 += x1 * dt + 0.5 * mean * dt * dt;
            x1 += mean * dt;
        }
        let (before, after) = held.at(row);
        u2 += u1 * dt + before * early * (0.5 * early + late) + after * 0.5 * late * late;
        u1 += before * early + after * late;
    }
    let mut table = DMatrix::from_row_slice(measured.len(), COLUMNS, &table);
    let mut scales = [0.0; COLUMNS];
    for (column, scale) in scales.iter_mut().enumerate() {
        *scale = table.column(column).norm();
        if *scale == 0.0 {
            return None;
        }
        table.column_mut(column).unscale_mut(*scale);
    }
    let solution = table.svd(true, true).solve(&DVector::from_vec(measured), f64::EPSILON).ok()?;
    let [x, slope, d, w, gain, offset] =
        [0, 1, 2, 3, 4, 5].map(|column| solution[column] / scales[column]);
    let reduced = Reduced { w, d, gain, offset, x, v: slope - d * x, latency };
    [w, d, gain, offset, x, slope].iter().all(|value| value.is_finite()).then_some(reduced)
}
