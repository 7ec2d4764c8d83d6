//! Finds first values for the fit from the record alone. It uses linear regression on the equation of motion, which is
//! integrated twice.
//!
//! ```text
//! x = x1 + (v1 + d x1) t - d I(x) - w I(I(x)) + g I(I(u)) + o t^2 / 2       I = integral from the first row
//! ```
//! Integrals smooth noise, so no filter and no differentiation is necessary. The same regression without a mass, `x =
//! x1 - (w/d) I(x) + (g/d) I(u) + (o/d) t`, detects a record in which damping hides the mass.

use nalgebra::{DMatrix, DVector};

use super::{
    model::{Held, Reduced},
    record::Record,
};

/// Largest number of rows in a regression. More rows do not improve a first value.
const ROWS: usize = 4000;

/// Time and position at one row, and the integrals up to this row.
struct Sums {
    t: f64,
    x: f64,
    x1: f64,
    x2: f64,
    u1: f64,
    u2: f64,
}

/// First values of a record's reduced parameters. `positions_m` is measured from a reference. `None` if the equations
/// have no solution.
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

/// The share of the motion's variance that a device without a mass explains. `None` if the regression finds no motion
/// in the direction of the voltage.
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

/// Numbers of windows into which a record is divided, one division after the other. Short windows suit devices that
/// oscillate or reverse often. Long windows reduce noise.
pub(super) const WINDOWS: [usize; 3] = [400, 100, 25];
/// Smallest number of rows in a window.
const WINDOW_ROWS: usize = 12;
/// Smallest number of windows that must be in motion.
const FEWEST_WINDOWS: usize = 8;
/// Smallest motion in each quarter of a window in motion, as a share of the motion in the fastest window.
const IN_MOTION: f64 = 0.02;

/// Weight over a window. The weight and its first two derivatives are 0 at both ends. The position `s` in the window is
/// from -1 to 1. Returns four values: the weight's integral, the weight, and its first and second derivative.
fn weight(s: f64) -> [f64; 4] {
    let (s2, left) = (s * s, 1.0 - s * s);
    [
        s * (1.0 - s2 * (1.0 - s2 * (0.6 - s2 / 7.0))),
        left.powi(3),
        -6.0 * s * left.powi(2),
        left * (30.0 * s2 - 6.0),
    ]
}

/// First values of the reduced parameters and of the friction per mass, for a device that may stick. The equation of
/// motion times a weight is integrated by parts over windows in which the handle moves in one direction. So no measured
/// value is differentiated (Shinbrot, Trans. ASME 79 (1957) 579). `None` if there are too few windows, or if no window
/// shows motion in the direction of the force.
pub(super) fn moving(
    (record, positions_m, first): (&Record, &[f64], usize),
    latency: f64,
    (spring, constant): (bool, bool),
    windows: usize,
) -> Option<(Reduced, f64)> {
    let held = Held::new(record, latency);
    let rows = ((record.len() - first) / windows).max(WINDOW_ROWS).next_multiple_of(4);
    let half_s = 0.5 * rows as f64 * record.step_s;
    let place = |row: f64| 2.0 * row / rows as f64 - 1.0;
    let weights: Vec<[f64; 4]> = (0..=rows).map(|row| weight(place(row as f64))).collect();
    let until: Vec<f64> =
        (0..rows).map(|row| weight(place(row as f64 + held.fraction))[0]).collect();
    let mut windows = vec![];
    for start in (first..).step_by(rows / 2).take_while(|start| start + rows < record.len()) {
        let x = |row: usize| positions_m[start + row];
        let quarter = rows / 4;
        let quarters = [0, 1, 2, 3].map(|n| x((n + 1) * quarter) - x(n * quarter));
        let mut sums = [0.0; 4];
        for (row, [_, itself, first, second]) in weights.iter().enumerate() {
            let from_middle = x(row) - x(rows / 2);
            sums[0] += second * from_middle / half_s;
            sums[1] += first * from_middle;
            sums[2] += itself * x(row) * half_s;
        }
        for row in 0..rows {
            let (before, after) = held.at(start + row);
            let [from, to] = [weights[row][0], weights[row + 1][0]];
            sums[3] += (before * (until[row] - from) + after * (to - until[row])) * half_s;
        }
        let step_s = record.step_s / half_s;
        windows.push((quarters, [sums[0] * step_s, sums[1] * step_s, sums[2] * step_s, sums[3]]));
    }
    let slowest = |quarters: &[f64; 4]| {
        let one_way = quarters.iter().all(|moved| moved * quarters[0] > 0.0);
        let least = quarters.iter().fold(f64::INFINITY, |least: f64, moved| least.min(moved.abs()));
        if one_way { least } else { 0.0 }
    };
    let fastest = windows.iter().map(|(quarters, _)| slowest(quarters)).fold(0.0, f64::max);
    windows.retain(|(quarters, _)| slowest(quarters) > IN_MOTION * fastest);
    if windows.len() < FEWEST_WINDOWS {
        return None;
    }
    let all = 2.0 * weight(1.0)[0] * half_s;
    // A parameter whose column is zero has no effect.
    let mut table = DMatrix::from_fn(windows.len(), 5, |row, column| {
        let (quarters, [_, x1, x0, volts]) = &windows[row];
        let constant = if constant { all } else { 0.0 };
        let x0 = if spring { -x0 } else { 0.0 };
        [*volts, *x1, -quarters[0].signum() * all, constant, x0][column]
    });
    let scales: Vec<f64> =
        table.column_iter().map(|column| column.norm().max(f64::MIN_POSITIVE)).collect();
    for (mut column, scale) in table.column_iter_mut().zip(&scales) {
        column.unscale_mut(*scale);
    }
    let accelerations =
        DVector::from_iterator(windows.len(), windows.iter().map(|(_, [x2, ..])| *x2));
    let mut found = least_squares(table, &accelerations, 1e-12)?;
    found.iter_mut().zip(scales).for_each(|(value, scale)| *value /= scale);
    let [gain, d, friction, offset] = [found[0], found[1].max(0.0), found[2].max(0.0), found[3]];
    let w = found[4].max(0.0);
    let [x, v] = begins(record, positions_m, first, rows)?;
    let reduced = Reduced { w, d, gain, offset, x, v, latency };
    (gain > 0.0 && gain.is_finite()).then_some((reduced, friction))
}

/// Position and speed at the first row. They come from a parabola that is fitted to the first rows.
fn begins(record: &Record, positions_m: &[f64], first: usize, rows: usize) -> Option<[f64; 2]> {
    let rows = rows.min(record.len() - first);
    let table = DMatrix::from_fn(rows, 3, |row, power| {
        (row as f64 / rows as f64).powi(i32::try_from(power).unwrap_or(0))
    });
    let measured = DVector::from_column_slice(&positions_m[first..first + rows]);
    let found = least_squares(table, &measured, 1e-12)?;
    Some([found[0], found[1] / (rows as f64 * record.step_s)])
}

/// Solves a least-squares problem. Directions with a singular value of at most `least` are left out. `None` if a value
/// is not finite.
pub(super) fn least_squares(
    table: DMatrix<f64>,
    wanted: &DVector<f64>,
    least: f64,
) -> Option<DVector<f64>> {
    let is_finite = table.iter().chain(wanted.iter()).all(|value| value.is_finite());
    is_finite.then(|| table.svd(true, true).solve(wanted, least).ok())?
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

/// Coefficients of the columns, and the share of the variance of x that they explain.
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
    let solution = least_squares(table.clone(), &measured, f64::EPSILON)?;
    let left = (&measured - table * &solution).norm_squared();
    let explained = 1.0 - left / measured.add_scalar(-measured.mean()).norm_squared();
    let coefficients = std::array::from_fn(|column| solution[column] / scales[column]);
    coefficients.iter().all(|value: &f64| value.is_finite()).then_some((coefficients, explained))
}
