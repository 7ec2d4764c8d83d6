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

/// Windows of a record over which motion is fitted by a parabola: short ones for devices that swing, long ones for noise.
pub(super) const WINDOWS: [usize; 2] = [400, 100];
/// Fewest rows of a window.
const WINDOW_ROWS: usize = 20;
/// Fewest windows in motion.
const FEWEST_WINDOWS: usize = 12;
/// A window counts as motion from this part of the fastest one on.
const IN_MOTION: f64 = 0.02;
/// Change of the voltage within a window from which it is left out, of the largest voltage.
const SAME_VOLTAGE: f64 = 0.05;

/// Reduced parameters and friction per mass, for a device that friction may hold: parabolas through short windows of the
/// record give position, speed and acceleration, and those in motion obey `a = g u - d v - w x + o - f sign(v)`. `None`
/// without enough of them, or if no force drives it forward.
pub(super) fn moving(
    (record, positions_m, first): (&Record, &[f64], usize),
    latency: f64,
    spring: bool,
    windows: usize,
) -> Option<(Reduced, f64)> {
    let held = Held::new(record, latency);
    let rows = ((record.len() - first) / windows).max(WINDOW_ROWS);
    let half_s = 0.5 * rows as f64 * record.step_s;
    let most_v = record.voltage_v.iter().fold(0.0, |most: f64, volt| most.max(volt.abs()));
    let mut windows: Vec<[f64; 4]> = vec![];
    let mut start = first;
    while start + rows <= record.len() {
        let volts = (start..start + rows).map(|row| held.at(row).1);
        let (low, high) =
            volts.clone().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), volt| {
                (low.min(volt), high.max(volt))
            });
        if high - low <= SAME_VOLTAGE * most_v {
            let table = DMatrix::from_fn(rows, 3, |row, power| {
                ((row as f64 + 0.5) * record.step_s / half_s - 1.0)
                    .powi(i32::try_from(power).unwrap_or(0))
            });
            let measured = DVector::from_column_slice(&positions_m[start..start + rows]);
            let normal = table.tr_mul(&table);
            let found = normal.lu().solve(&table.tr_mul(&measured))?;
            let volt = volts.sum::<f64>() / rows as f64;
            windows.push([found[0], found[1] / half_s, 2.0 * found[2] / (half_s * half_s), volt]);
        }
        start += rows;
    }
    let fastest = windows.iter().map(|[_, v, ..]| v.abs()).fold(0.0, f64::max);
    windows.retain(|[_, v, a, _]| v.abs() > (IN_MOTION * fastest).max(a.abs() * half_s));
    if windows.len() < FEWEST_WINDOWS {
        return None;
    }
    let columns = if spring { 5 } else { 4 };
    let table = DMatrix::from_fn(windows.len(), columns, |row, column| {
        let [x, v, _, volt] = windows[row];
        [volt, -v, -v.signum(), 1.0, -x][column]
    });
    let accelerations =
        DVector::from_iterator(windows.len(), windows.iter().map(|[_, _, a, _]| *a));
    let found = least_squares(table, &accelerations, 1e-12)?;
    let w = if spring { found[4].max(0.0) } else { 0.0 };
    let [gain, d, friction, offset] = [found[0], found[1].max(0.0), found[2].max(0.0), found[3]];
    let head = &positions_m[first..first + WINDOW_ROWS];
    let x = head.iter().sum::<f64>() / head.len() as f64;
    let reduced = Reduced { w, d, gain, offset, x, v: 0.0, latency };
    (gain > 0.0 && gain.is_finite()).then_some((reduced, friction))
}

/// Least squares without the directions whose singular values are at most `least`; `None` of what is not finite, which
/// has no decomposition.
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
    let solution = least_squares(table.clone(), &measured, f64::EPSILON)?;
    let left = (&measured - table * &solution).norm_squared();
    let explained = 1.0 - left / measured.add_scalar(-measured.mean()).norm_squared();
    let coefficients = std::array::from_fn(|column| solution[column] / scales[column]);
    coefficients.iter().all(|value: &f64| value.is_finite()).then_some((coefficients, explained))
}
