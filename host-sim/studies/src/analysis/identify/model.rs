//! Computes the exact response of the device to a record's voltage, and the derivatives with respect to every
//! parameter.
//!
//! ```text
//! x'' = -w x - d x' + g u + o       w = k / m, d = b / m, g = gain / m, o = k x0 / m
//! ```
//! x is measured from a reference position near the record. u is the voltage, delayed by the latency. u is constant
//! between its changes, so a step of the state is exact ([`discretise`]). The derivatives by w and d have the same
//! equation with inputs -x and -x'. These derivatives are additional states of the same exact step. g, o and the
//! initial state enter linearly, so their derivatives are unit responses. The derivative by the latency is minus the
//! speed of the response to u. The first voltage acts at the first row for any latency, so the part of the first
//! voltage is subtracted from this speed.

use nalgebra::{SMatrix, SVector};

use super::record::Record;
use crate::numerics::exact::discretise;

/// The parameters of one record, divided by the mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reduced {
    /// Stiffness per mass, in 1/s^2.
    pub w: f64,
    /// Damping per mass, in 1/s.
    pub d: f64,
    /// Acceleration per volt, in m/s^2/V.
    pub gain: f64,
    /// Constant part of the acceleration, in m/s^2.
    pub offset: f64,
    /// Position at the first fitted row in m, measured from the reference.
    pub x: f64,
    /// Speed at the first fitted row, in m/s.
    pub v: f64,
    /// Time until the voltage of a row acts, in rows. A search may try negative values.
    pub latency: f64,
}

/// Position of the model at one row, and its derivatives with respect to each parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Point {
    pub x: f64,
    pub by_w: f64,
    pub by_d: f64,
    pub by_gain: f64,
    pub by_offset: f64,
    pub by_x: f64,
    pub by_v: f64,
    /// Derivative with respect to the latency in rows.
    pub by_latency: f64,
}

type Pair = [f64; 2];

/// One exact step, and its derivatives with respect to w and d.
struct Step {
    phi: [Pair; 2],
    gamma: Pair,
    phi_w: [Pair; 2],
    gamma_w: Pair,
    phi_d: [Pair; 2],
    gamma_d: Pair,
}

impl Step {
    fn new(w: f64, d: f64, dt: f64) -> Self {
        #[rustfmt::skip]
        let a = SMatrix::<f64, 6, 6>::from_row_slice(&[
            0.0, 1.0, 0.0, 0.0, 0.0, 0.0,
            -w,  -d,  0.0, 0.0, 0.0, 0.0,
            0.0, 0.0, 0.0, 1.0, 0.0, 0.0,
            -1.0, 0.0, -w, -d,  0.0, 0.0,
            0.0, 0.0, 0.0, 0.0, 0.0, 1.0,
            0.0, -1.0, 0.0, 0.0, -w, -d,
        ]);
        let b = SVector::<f64, 6>::from_column_slice(&[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        let (phi, gamma) = discretise(&a, &b, dt);
        let block =
            |row: usize| [[phi[(row, 0)], phi[(row, 1)]], [phi[(row + 1, 0)], phi[(row + 1, 1)]]];
        let part = |row: usize| [gamma[row], gamma[row + 1]];
        Self {
            phi: block(0),
            gamma: part(0),
            phi_w: block(2),
            gamma_w: part(2),
            phi_d: block(4),
            gamma_d: part(4),
        }
    }
}

/// State that is carried from row to row.
#[derive(Clone, Copy)]
struct Carried {
    /// State: position and speed.
    z: Pair,
    /// Derivatives of the state with respect to w and d.
    z_w: Pair,
    z_d: Pair,
    /// Responses of the state to one unit of the voltage, of a constant, of the first x and of the first v.
    voltage: Pair,
    constant: Pair,
    from_x: Pair,
    from_v: Pair,
}

impl Carried {
    /// The state after one step with `volts`.
    fn advance(&self, step: &Step, reduced: &Reduced, volts: f64) -> Self {
        let acceleration = reduced.gain * volts + reduced.offset;
        let free = |z: &Pair| times(&step.phi, z);
        let also = |own: &Pair, phi: &[Pair; 2], gamma: &Pair| {
            let (own, by_state) = (free(own), times(phi, &self.z));
            [0, 1].map(|i| own[i] + by_state[i] + gamma[i] * acceleration)
        };
        let forced = |z: &Pair, by: f64| {
            let z = free(z);
            [0, 1].map(|i| z[i] + step.gamma[i] * by)
        };
        Self {
            z: forced(&self.z, acceleration),
            z_w: also(&self.z_w, &step.phi_w, &step.gamma_w),
            z_d: also(&self.z_d, &step.phi_d, &step.gamma_d),
            voltage: forced(&self.voltage, volts),
            constant: forced(&self.constant, 1.0),
            from_x: free(&self.from_x),
            from_v: free(&self.from_v),
        }
    }
}

/// Position of the model and its derivatives at each row. The first row is `first`.
pub(super) fn response(record: &Record, first: usize, reduced: &Reduced) -> Vec<Point> {
    let voltages = Held::new(record, reduced.latency);
    let dt = record.step_s;
    let early = Step::new(reduced.w, reduced.d, voltages.fraction * dt);
    let late = Step::new(reduced.w, reduced.d, (1.0 - voltages.fraction) * dt);
    let zero = [0.0; 2];
    let mut now = Carried {
        z: [reduced.x, reduced.v],
        z_w: zero,
        z_d: zero,
        voltage: zero,
        constant: zero,
        from_x: [1.0, 0.0],
        from_v: [0.0, 1.0],
    };
    let start_v = if voltages.fraction > 0.0 { voltages.at(first).0 } else { voltages.at(first).1 };
    let mut points = Vec::with_capacity(record.len() - first);
    for row in first..record.len() {
        let speed = now.voltage[1] - start_v * now.from_v[0];
        points.push(Point {
            x: now.z[0],
            by_w: now.z_w[0],
            by_d: now.z_d[0],
            by_gain: now.voltage[0],
            by_offset: now.constant[0],
            by_x: now.from_x[0],
            by_v: now.from_v[0],
            by_latency: -reduced.gain * speed * dt,
        });
        let (before, after) = voltages.at(row);
        if voltages.fraction > 0.0 {
            now = now.advance(&early, reduced, before);
        }
        now = now.advance(&late, reduced, after);
    }
    points
}

/// A record's voltage after the latency, as the device gets it.
pub(super) struct Held<'a> {
    command: &'a [f64],
    /// Latency in whole rows.
    rows: i64,
    /// The rest of the latency, at least 0 and below 1 row. The older voltage acts during this part of a row.
    pub fraction: f64,
}

impl<'a> Held<'a> {
    pub(super) fn new(record: &'a Record, latency: f64) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "the cast saturates")]
        let rows = latency.floor() as i64;
        Self { command: &record.command, rows, fraction: latency - latency.floor() }
    }

    /// The two voltages that act during the step of this row: before and after [`fraction`](Self::fraction). Outside
    /// the record, the nearest voltage is used.
    pub(super) fn at(&self, row: usize) -> (f64, f64) {
        let value = |row: i64| {
            let last = self.command.len() - 1;
            self.command[usize::try_from(row).unwrap_or(0).min(last)]
        };
        // A search may try any latency, so the sum may overflow.
        let row = (row.cast_signed() as i64).saturating_sub(self.rows);
        (value(row.saturating_sub(1)), value(row))
    }
}

fn times(matrix: &[Pair; 2], vector: &Pair) -> Pair {
    matrix.map(|row| row[0] * vector[0] + row[1] * vector[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        plant::{Plant, PlantStep},
        scene::Device,
    };

    fn record() -> Record {
        let command =
            (0..4000).map(|n| if (500..1500).contains(&n) { 4.0 } else { -1.0 }).collect();
        Record {
            name: "test".into(),
            start_s: 0.0,
            step_s: 1e-4,
            command,
            position_m: vec![0.0; 4000],
            drive: Default::default(),
            may_clip: true,
        }
    }

    #[test]
    fn any_latency_has_a_voltage() {
        let record = record();
        for latency in [-1e300, -1e19, -0.5, 1e19, 1e300] {
            let held = Held::new(&record, latency);
            assert_eq!(held.at(3999), (-1.0, -1.0), "{latency}");
        }
    }

    const REDUCED: Reduced =
        Reduced { w: 26.6, d: 13.3, gain: 1.42, offset: 0.4, x: 0.01, v: -0.02, latency: 3.3 };

    #[test]
    fn the_response_is_that_of_the_exact_plant() {
        let device = Device {
            mass_kg: 1.0,
            damping_n_s_per_m: REDUCED.d,
            stiffness_n_per_m: REDUCED.w,
            rest_position_m: 0.0,
            start_position_m: 0.0,
        };
        let (record, first) = (record(), 4);
        let plant = PlantStep::new(&device, record.step_s, REDUCED.latency.fract());
        let points = response(&record, first, &Reduced { v: 0.0, ..REDUCED });
        let mut state = plant.at_rest(REDUCED.x);
        for (n, point) in points.iter().enumerate() {
            assert!((point.x - plant.position_m(&state)).abs() < 1e-13, "row {n}");
            let force = |row: usize| REDUCED.gain * record.command[row] + REDUCED.offset;
            let row = n + first;
            state = plant.advance_split(&state, force(row - 4), force(row - 3));
        }
    }

    #[test]
    fn derivatives_are_those_of_small_changes() {
        let record = record();
        type Change = fn(&mut Reduced) -> &mut f64;
        type Read = fn(&Point) -> f64;
        let all: [(Change, Read, f64); 7] = [
            (|r| &mut r.w, |p| p.by_w, 1e-3),
            (|r| &mut r.d, |p| p.by_d, 1e-3),
            (|r| &mut r.gain, |p| p.by_gain, 1e-3),
            (|r| &mut r.offset, |p| p.by_offset, 1e-3),
            (|r| &mut r.x, |p| p.by_x, 1e-3),
            (|r| &mut r.v, |p| p.by_v, 1e-3),
            (|r| &mut r.latency, |p| p.by_latency, 1e-2),
        ];
        let middle = response(&record, 5, &REDUCED);
        for (index, (change, read, by)) in all.into_iter().enumerate() {
            let moved = |by: f64| {
                let mut reduced = REDUCED;
                *change(&mut reduced) += by;
                response(&record, 5, &reduced)
            };
            let (up, down) = (moved(by), moved(-by));
            let largest = middle.iter().map(|point| read(point).abs()).fold(0.0, f64::max);
            for (n, point) in middle.iter().enumerate() {
                let slope = (up[n].x - down[n].x) / (2.0 * by);
                let error = (slope - read(point)).abs() / largest;
                assert!(error < 1e-5, "parameter {index}, row {n}: {slope} {}", read(point));
            }
        }
    }
}
