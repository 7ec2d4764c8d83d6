//! Tests of the exact step: 50-digit values, composition, convergence and scaling.

use super::*;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

const GOLDEN: &str = include_str!("../../../../../tests/golden/plant_step.csv");
/// Tolerance of phi and gamma. The rounding of the inputs b/m and k/m alone changes phi by about 1e-16 |A| T. The rest
/// is margin.
const GOLDEN_TOLERANCE: f64 = 1e-12;
/// Tolerance of the closed forms. It allows a few rounding errors.
const CLOSED_FORM_TOLERANCE: f64 = 4e-15;

struct Row {
    mass: f64,
    damping: f64,
    stiffness: f64,
    dt: f64,
    phi: [[f64; 2]; 2],
    gamma: [f64; 2],
}

fn golden() -> Vec<Row> {
    let rows: Vec<Row> = GOLDEN
        .lines()
        .skip(1)
        .map(|line| {
            let v: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            let (mass, phi) = (v[0], [[v[4], v[5]], [v[6], v[7]]]);
            // the gamma of the table is the response to a force, the gamma of the step is the response to an
            // acceleration
            let gamma = [v[8] * mass, v[9] * mass];
            Row { mass, damping: v[1], stiffness: v[2], dt: v[3], phi, gamma }
        })
        .collect();
    assert!(rows.len() >= 40);
    rows
}

/// Largest error in the energy norm, relative to max(1, |A| T). x is scaled by w. Without a spring, x is scaled by 1/T.
fn error(row: &Row, phi: [[f64; 2]; 2], gamma: [f64; 2]) -> f64 {
    let w = (row.stiffness / row.mass).sqrt();
    let scale = if w > 0.0 { w } else { 1.0 / row.dt };
    let difference = |r: usize, c: usize| phi[r][c] - row.phi[r][c];
    assert!(phi.iter().flatten().chain(&gamma).all(|v| v.is_finite())); // max() below ignores NaN
    [
        difference(0, 0),
        difference(0, 1) * scale,
        difference(1, 0) / scale,
        difference(1, 1),
        (gamma[0] - row.gamma[0]) * scale / row.dt,
        (gamma[1] - row.gamma[1]) / row.dt,
    ]
    .iter()
    .fold(0.0, |worst: f64, e| worst.max(e.abs()))
        / (w.max(row.damping / row.mass) * row.dt).max(1.0)
}

fn general(w2: f64, d: f64, dt: f64) -> ([[f64; 2]; 2], [f64; 2]) {
    let (phi, gamma) = discretise(&Matrix2::new(0.0, 1.0, -w2, -d), &Vector2::new(0.0, 1.0), dt);
    ([[phi[(0, 0)], phi[(0, 1)]], [phi[(1, 0)], phi[(1, 1)]]], [gamma[0], gamma[1]])
}

#[test]
fn oscillator_matches_fifty_digits() {
    let mut worst = 0.0_f64;
    for row in golden() {
        let (phi, gamma) =
            oscillator_step(row.stiffness / row.mass, row.damping / row.mass, row.dt);
        let e = error(&row, phi, gamma);
        worst = worst.max(e);
        assert!(
            e <= CLOSED_FORM_TOLERANCE,
            "m {} b {} k {} T {}: {e:e}",
            row.mass,
            row.damping,
            row.stiffness,
            row.dt
        );
    }
    println!("worst error of oscillator_step: {worst:e}");
}

#[test]
fn general_step_matches_fifty_digits() {
    let mut worst = 0.0_f64;
    for row in golden() {
        let (phi, gamma) = general(row.stiffness / row.mass, row.damping / row.mass, row.dt);
        let e = error(&row, phi, gamma);
        worst = worst.max(e);
        assert!(
            e <= GOLDEN_TOLERANCE,
            "m {} b {} k {} T {}: {e:e}",
            row.mass,
            row.damping,
            row.stiffness,
            row.dt
        );
    }
    println!("worst error of discretise: {worst:e}");
}

#[test]
fn short_steps_keep_every_entry_to_relative_precision() {
    // With a soft spring, an error of gamma1 is hardly visible in the energy norm. A frequency response shows this
    // error.
    for row in golden()
        .iter()
        .filter(|r| r.damping / r.mass * r.dt <= 1.0 && r.stiffness / r.mass * r.dt * r.dt <= 1.0)
    {
        let (phi, gamma) =
            oscillator_step(row.stiffness / row.mass, row.damping / row.mass, row.dt);
        for (ours, exact) in
            phi.iter().flatten().chain(&gamma).zip(row.phi.iter().flatten().chain(&row.gamma))
        {
            assert!(
                (ours - exact).abs() <= CLOSED_FORM_TOLERANCE * exact.abs(),
                "{ours:e} is not {exact:e}"
            );
        }
    }
}

#[test]
fn increment_agrees_with_phi() {
    for row in golden() {
        let (w2, d) = (row.stiffness / row.mass, row.damping / row.mass);
        let (phi, gamma) = oscillator_step(w2, d, row.dt);
        let increment = oscillator_increment(w2, d, row.dt);
        assert_eq!(gamma, increment.gamma);
        for (index, (less, whole)) in
            increment.phi_minus_one.iter().flatten().zip(phi.iter().flatten()).enumerate()
        {
            let identity = if index % 3 == 0 { 1.0 } else { 0.0 };
            assert!(
                (identity + less - whole).abs() <= CLOSED_FORM_TOLERANCE * whole.abs().max(1.0)
            );
        }
    }
}

#[test]
fn forms_join_without_a_step() {
    // At each border of two regimes, the formulas of both sides differ only by rounding.
    for (w2, d) in [(1.0, 0.5), (1.0, 1.0), (1e-9, 1.0), (0.2, 1.0), (1.0, 1e-9), (0.24, 1.0)] {
        let below = oscillator_step(w2, d, 1.0);
        let above = oscillator_step(w2, d, 1.0 + f64::EPSILON * 4.0);
        for (p, q) in
            below.0.iter().flatten().chain(&below.1).zip(above.0.iter().flatten().chain(&above.1))
        {
            assert!((p - q).abs() <= CLOSED_FORM_TOLERANCE, "{p} {q}");
        }
    }
    // The closed forms change at critical damping. There too, both sides differ only by rounding.
    let critical = oscillator_step(4e6, 4e3, 1e-3);
    for d in [4e3 * (1.0 - f64::EPSILON), 4e3 * (1.0 + f64::EPSILON)] {
        let near = oscillator_step(4e6, d, 1e-3);
        let row = Row {
            mass: 1.0,
            damping: d,
            stiffness: 4e6,
            dt: 1e-3,
            phi: critical.0,
            gamma: critical.1,
        };
        assert!(error(&row, near.0, near.1) <= CLOSED_FORM_TOLERANCE);
    }
}

#[test]
fn steps_compose() {
    // phi(a + b) = phi(b) phi(a). The split of a step at the latency relies on this equation.
    let (w2, d) = (11.0626 / 0.4160, 5.5195 / 0.4160);
    let (whole, gamma) = oscillator_step(w2, d, 1e-4);
    let (first, g1) = oscillator_step(w2, d, 0.3e-4);
    let (second, g2) = oscillator_step(w2, d, 0.7e-4);
    for r in 0..2 {
        for c in 0..2 {
            let product = second[r][0] * first[0][c] + second[r][1] * first[1][c];
            assert!((product - whole[r][c]).abs() <= CLOSED_FORM_TOLERANCE * whole[r][c].abs());
        }
        let joined = second[r][0] * g1[0] + second[r][1] * g1[1] + g2[r];
        assert!((joined - gamma[r]).abs() <= CLOSED_FORM_TOLERANCE * gamma[r].abs());
    }
}

/// A mass with spring, damper and an amplifier pole. The state is (x, v, force).
fn amplified(w2: f64, d: f64, pole: f64) -> (Matrix3<f64>, Vector3<f64>) {
    (Matrix3::new(0.0, 1.0, 0.0, -w2, -d, 1.0, 0.0, 0.0, -pole), Vector3::new(0.0, 0.0, pole))
}

#[test]
fn general_step_converges_to_euler_at_second_order() {
    let (a, b) = amplified(26.6, 13.3, 2e3);
    let mut last = f64::NAN;
    for halving in 0..6 {
        let dt = 1e-4 * 0.5_f64.powi(halving);
        let (phi, _) = discretise(&a, &b, dt);
        let euler = Matrix3::identity() + a * dt;
        let e = (phi - euler).norm();
        if halving > 0 {
            let ratio = last / e;
            assert!((ratio - 4.0).abs() < 0.3, "Euler's error falls by {ratio} and not by 4");
        }
        last = e;
    }
}

#[test]
fn general_step_is_the_limit_of_many_small_ones() {
    let (a, b) = amplified(2e6, 40.0, 2e4);
    let (phi, gamma) = discretise(&a, &b, 1e-3);
    let (small_phi, small_gamma) = discretise(&a, &b, 1e-3 / 64.0);
    let (mut state, mut power) = (Vector3::zeros(), Matrix3::identity());
    for _ in 0..64 {
        state = small_phi * state + small_gamma;
        power = small_phi * power;
    }
    assert!((power - phi).norm() <= GOLDEN_TOLERANCE * phi.norm());
    assert!((state - gamma).norm() <= GOLDEN_TOLERANCE * gamma.norm());
}

#[test]
fn fast_amplifier_tends_to_the_plain_oscillator() {
    // If the lag of the amplifier is halved, the loss of velocity is halved too. So the error is of first order, as in
    // theory.
    let (_, plain) = oscillator_step(26.6, 13.3, 1e-4);
    let deficit = [1e6, 2e6, 4e6, 8e6].map(|pole| {
        let (a, b) = amplified(26.6, 13.3, pole);
        plain[1] - discretise(&a, &b, 1e-4).1[1]
    });
    for pair in deficit.windows(2) {
        assert!((pair[0] / pair[1] - 2.0).abs() < 0.01, "{}", pair[0] / pair[1]);
    }
}

#[test]
fn powers_of_two_scale_exactly() {
    for (w2, d, pole) in [(26.6, 13.3, 2e3), (2.4e6, 40.0, 2e4), (1e12, 0.0, 1e5)] {
        let (a, b) = amplified(w2, d, pole);
        let (phi, gamma) = discretise(&a, &b, 1e-3);
        for powers in [[0, 0, 7], [-12, -12, 3], [5, -9, 20]] {
            let unit = powers.map(|p| 2.0_f64.powi(p));
            let scaled = Matrix3::from_fn(|r, c| a[(r, c)] * unit[r] / unit[c]);
            let (other, g) = discretise(&scaled, &Vector3::from_fn(|r, _| b[r] * unit[r]), 1e-3);
            for r in 0..3 {
                assert_eq!(g[r], gamma[r] * unit[r]);
                for c in 0..3 {
                    assert_eq!(other[(r, c)], phi[(r, c)] * unit[r] / unit[c]);
                }
            }
        }
    }
    // A step of the oscillator depends only on the ratios k/m and b/m. A scaling of time is exact too.
    let (phi, gamma) = oscillator_step(26.6, 13.3, 1e-4);
    let (other, g) = oscillator_step(26.6 * 16.0, 13.3 * 4.0, 1e-4 / 4.0);
    assert_eq!(
        (other[0][0], other[1][1], other[0][1] * 4.0, other[1][0] / 4.0),
        (phi[0][0], phi[1][1], phi[0][1], phi[1][0])
    );
    assert_eq!((g[0] * 16.0, g[1] * 4.0), (gamma[0], gamma[1]));
}

#[test]
fn nothing_happens_in_no_time() {
    for (w2, d) in [(0.0, 0.0), (1e12, 0.0), (0.0, 1e9), (1e12, 1e9)] {
        assert_eq!(oscillator_step(w2, d, 0.0), ([[1.0, 0.0], [-0.0, 1.0]], [0.0, 0.0]));
        assert_eq!(general(w2, d, 0.0), ([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0]));
    }
}

#[test]
fn no_corner_of_the_accepted_range_breaks_it() {
    for mass in [1e-3, 0.4, 100.0] {
        for stiffness in [0.0, 5e-324, 1e-9, 1.0, 1e4, 1e9] {
            for damping in [0.0, 5e-324, 1e-9, 1.0, 1e3, 1e6] {
                for dt in [2e-5, 1e-3, 1.0] {
                    let (w2, d) = (stiffness / mass, damping / mass);
                    for (phi, gamma) in [oscillator_step(w2, d, dt), general(w2, d, dt)] {
                        assert!(phi.iter().flatten().chain(&gamma).all(|v| v.is_finite()));
                    }
                    // A passive plant must not gain energy.
                    let (phi, _) = oscillator_step(w2, d, dt);
                    let determinant = phi[0][0] * phi[1][1] - phi[0][1] * phi[1][0];
                    assert!(determinant.abs() <= 1.0 + GOLDEN_TOLERANCE, "{determinant}");
                }
            }
        }
    }
}
