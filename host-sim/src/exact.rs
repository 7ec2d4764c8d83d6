//! The exact step of a linear plant whose input is constant over the step (zero-order hold).
//!
//! ```text
//! z' = A z + b u,   u constant over dt
//! z(t + dt) = phi z(t) + gamma u,   phi = exp(A dt),   gamma = integral of exp(A s) b ds over 0..dt
//! ```
//!
//! [`oscillator_step`] has closed forms for the mass-spring-damper, [`discretise`] the general case: an
//! amplifier pole, an arm or a second mode beside it. Both are deterministic to the bit on every machine
//! (`libm` and plain IEEE operations in a fixed order), and neither depends on units: a unit changed by a
//! power of two scales the results exactly and leaves phi's other bits alone.
//!
//! Source: Franklin, Powell, Workman, "Digital Control of Dynamic Systems", 3rd ed., section 4.3; checked
//! against 50-digit values (`tests/golden/plant_step.csv`).

use nalgebra::{SMatrix, SVector};

/// Largest `|pole| dt` for which [`oscillator_step`] sums the power series: its terms then lose no more
/// than a digit to each other, while the closed forms would cancel as `1 - phi11` does.
const SERIES_LIMIT: f64 = 1.0;
/// Terms of the series. With both poles inside |z| <= 1, |h_n| <= n + 1: what is left out is below
/// 22 / 22! = 2e-20.
const SERIES_TERMS: u32 = 21;
/// Slow pole times dt below which gamma1 is a divided difference and not `(1 - phi11) / w^2`. The fast pole
/// is then above 0.75, so the difference keeps its digits; above it `1 - phi11` is at least 0.06.
const SLOW_POLE_LIMIT: f64 = 0.25;

/// What one step adds: `phi - 1` and `gamma`. Near a short step phi is 1 plus little, and it is the little
/// that carries the dynamics; frequency responses near zero frequency need it with all its digits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Increment {
    /// `phi - 1`, rows (x, v).
    pub phi_minus_one: [[f64; 2]; 2],
    /// Response to a unit acceleration, (m, m/s) per m/s^2.
    pub gamma: [f64; 2],
}

/// One exact step of `x'' = u - stiffness_per_mass x - damping_per_mass x'` for the state (x, v): phi and the
/// response gamma to a unit acceleration u that is constant over `dt`.
///
/// Units: 1/s^2, 1/s and s in; gamma in s^2 and s. For a force F on a mass m, `u = F / m`. All arguments must
/// be finite and not negative; dt may be 0. Every regime keeps its digits: undamped over hundreds of
/// oscillations, overdamped with a time constant far below dt, critically damped, no spring.
#[must_use]
pub fn oscillator_step(
    stiffness_per_mass: f64,
    damping_per_mass: f64,
    dt: f64,
) -> ([[f64; 2]; 2], [f64; 2]) {
    let (phi, gamma, _) = solve(stiffness_per_mass, damping_per_mass, dt);
    (phi, gamma)
}

/// As [`oscillator_step`], with `phi - 1` instead of phi.
pub fn oscillator_increment(stiffness_per_mass: f64, damping_per_mass: f64, dt: f64) -> Increment {
    let (_, gamma, phi_minus_one) = solve(stiffness_per_mass, damping_per_mass, dt);
    Increment {
        phi_minus_one,
        gamma,
    }
}

/// phi, gamma, phi - 1. With poles l1, l2 and E(l) = exp(l dt):
/// `phi12 = (E(l1) - E(l2)) / (l1 - l2)`, `gamma = (integral of phi12, phi12)`.
fn solve(w2: f64, d: f64, dt: f64) -> ([[f64; 2]; 2], [f64; 2], [[f64; 2]; 2]) {
    let half = 0.5 * d;
    if d * dt <= SERIES_LIMIT && w2 * dt * dt <= SERIES_LIMIT {
        return series(w2, d, dt);
    }
    // One rounding: near the critical damping the difference keeps all digits that its inputs have.
    let discriminant = libm::fma(half, half, -w2);
    let (phi11, phi12, phi22, gamma1) = if discriminant < 0.0 {
        let w = libm::sqrt(-discriminant);
        let decay = libm::exp(-half * dt);
        let (sin, cos) = (libm::sin(w * dt), libm::cos(w * dt));
        let s = decay * sin / w;
        let phi11 = decay * cos + half * s;
        (phi11, s, decay * cos - half * s, (1.0 - phi11) / w2)
    } else {
        let r = libm::sqrt(discriminant);
        let fast = half + r;
        let slow = w2 / fast; // not half - r, which cancels
        let (z_slow, z_fast, gap) = (-slow * dt, -fast * dt, 2.0 * r * dt);
        let (e_slow, e_fast) = (libm::exp(z_slow), libm::exp(z_fast));
        let phi12 = dt * e_slow * mean_exp(-gap);
        let phi11 = e_slow + slow * phi12;
        let gamma1 = if -z_slow < SLOW_POLE_LIMIT {
            dt * dt * (mean_exp(z_slow) - mean_exp(z_fast)) / gap
        } else {
            (1.0 - phi11) / w2
        };
        (phi11, phi12, e_fast - slow * phi12, gamma1)
    };
    let phi21 = -w2 * phi12;
    (
        [[phi11, phi12], [phi21, phi22]],
        [gamma1, phi12],
        [[-w2 * gamma1, phi12], [phi21, phi22 - 1.0]],
    )
}

/// `(exp(z) - 1) / z`, the mean of exp over 0..z; 1 at z = 0.
fn mean_exp(z: f64) -> f64 {
    if z == 0.0 { 1.0 } else { libm::expm1(z) / z }
}

/// Short steps: `phi12 = dt sum h_n / (n+1)!`, `gamma1 = dt^2 sum h_n / (n+2)!`, where h_n is the complete
/// symmetric polynomial of the two poles times dt, `h_n = -(d dt) h_(n-1) - (w^2 dt^2) h_(n-2)`.
fn series(w2: f64, d: f64, dt: f64) -> ([[f64; 2]; 2], [f64; 2], [[f64; 2]; 2]) {
    let (sum, product) = (-d * dt, w2 * dt * dt);
    let (mut before, mut h) = (0.0, 1.0);
    let mut factorial = 1.0; // (n + 1)!
    let (mut first, mut second) = (0.0, 0.0);
    for n in 0..SERIES_TERMS {
        let n = f64::from(n);
        factorial *= n + 1.0;
        first += h / factorial;
        second += h / (factorial * (n + 2.0));
        (before, h) = (h, sum * h - product * before);
    }
    let (phi12, gamma1) = (dt * first, dt * dt * second);
    let less11 = -w2 * gamma1;
    let less22 = less11 - d * phi12;
    let phi21 = -w2 * phi12;
    (
        [[1.0 + less11, phi12], [phi21, 1.0 + less22]],
        [gamma1, phi12],
        [[less11, phi12], [phi21, less22]],
    )
}

/// Norm of `A h` at which [`discretise`] stops halving dt.
const TAYLOR_LIMIT: f64 = 0.5;
/// Terms of its series: with |A h| <= 1/2 the remainder is below 0.5^19 / 20! = 8e-25. Chains of
/// integrators, which the norm does not see, end by themselves after N terms.
const TAYLOR_TERMS: u32 = 19;

/// One exact step of `z' = A z + b u` over `dt` seconds with u constant: (phi, gamma).
///
/// A series for the short step `h = dt / 2^s`, then s doublings of `phi - 1` and of the mean of `exp(A s)`.
/// Working on `phi - 1` keeps the digits of slow states. The error grows as `|A| dt` times the rounding
/// of f64, |A| taken in the best units. The number of halvings follows from A's largest cycle (the
/// largest geometric mean of entries around a loop of states), which no change of units alters; so results
/// scale exactly when the unit of any state is changed by a power of two. For one mass prefer
/// [`oscillator_step`]. A, b and dt must be finite, dt not negative.
#[must_use]
pub fn discretise<const N: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SVector<f64, N>,
    dt: f64,
) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
    let halvings = halvings(a, dt);
    let h = dt * libm::ldexp(1.0, -halvings);
    let ah = a * h;
    // mean = sum (A h)^n / (n+1)!, by Horner.
    let identity = SMatrix::<f64, N, N>::identity();
    let mut mean = identity;
    for n in (2..=TAYLOR_TERMS).rev() {
        mean = identity + product(&ah, &mean) / f64::from(n);
    }
    let mut less = product(&ah, &mean); // phi - 1
    for _ in 0..halvings {
        mean += product(&less, &mean) * 0.5;
        less = less * 2.0 + product(&less, &less);
    }
    let mut gamma = SVector::<f64, N>::zeros();
    for row in 0..N {
        for column in 0..N {
            gamma[row] += mean[(row, column)] * b[column];
        }
    }
    (identity + less, gamma * dt)
}

/// Halvings of dt after which `|A h|` is at most [`TAYLOR_LIMIT`] in the units that balance A best. There the
/// largest entry is the largest cycle mean (a theorem of max-plus algebra), and the norm at most N times it.
fn halvings<const N: usize>(a: &SMatrix<f64, N, N>, dt: f64) -> i32 {
    let mut walks = a.abs(); // heaviest walk of `length` steps between two states
    let mut cycle = walks.diagonal().max();
    for length in 2..=N {
        let mut longer = SMatrix::<f64, N, N>::zeros();
        for row in 0..N {
            for column in 0..N {
                for via in 0..N {
                    longer[(row, column)] =
                        longer[(row, column)].max(walks[(row, via)] * a[(via, column)].abs());
                }
            }
        }
        walks = longer;
        #[expect(clippy::cast_precision_loss, reason = "a number of states")]
        let root = 1.0 / length as f64;
        cycle = cycle.max(libm::pow(walks.diagonal().max(), root));
    }
    #[expect(clippy::cast_precision_loss, reason = "a number of states")]
    let norm = cycle * dt * N as f64;
    let mut halvings = 0;
    while libm::ldexp(norm, -halvings) > TAYLOR_LIMIT && halvings < 1000 {
        halvings += 1;
    }
    halvings
}

/// Matrix product in a fixed order: nalgebra may pick fused operations by processor, and bits would differ.
fn product<const N: usize>(
    left: &SMatrix<f64, N, N>,
    right: &SMatrix<f64, N, N>,
) -> SMatrix<f64, N, N> {
    SMatrix::from_fn(|row, column| {
        (0..N)
            .map(|via| left[(row, via)] * right[(via, column)])
            .sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

    const GOLDEN: &str = include_str!("../../tests/golden/plant_step.csv");
    /// Rounding of the inputs b/m and k/m alone moves phi by about 1e-16 |A| T; the rest is margin.
    const GOLDEN_TOLERANCE: f64 = 1e-12;
    /// The closed forms do better: a few roundings.
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
                // The table is per force, the step per acceleration.
                let gamma = [v[8] * mass, v[9] * mass];
                Row {
                    mass,
                    damping: v[1],
                    stiffness: v[2],
                    dt: v[3],
                    phi,
                    gamma,
                }
            })
            .collect();
        assert!(rows.len() >= 40);
        rows
    }

    /// Largest error in the energy norm, relative to max(1, |A| T). x is scaled by w, or by 1/T without a spring.
    fn error(row: &Row, phi: [[f64; 2]; 2], gamma: [f64; 2]) -> f64 {
        let w = (row.stiffness / row.mass).sqrt();
        let scale = if w > 0.0 { w } else { 1.0 / row.dt };
        let difference = |r: usize, c: usize| phi[r][c] - row.phi[r][c];
        assert!(phi.iter().flatten().chain(&gamma).all(|v| v.is_finite())); // max() below drops a NaN
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
        let (phi, gamma) = discretise(
            &Matrix2::new(0.0, 1.0, -w2, -d),
            &Vector2::new(0.0, 1.0),
            dt,
        );
        (
            [[phi[(0, 0)], phi[(0, 1)]], [phi[(1, 0)], phi[(1, 1)]]],
            [gamma[0], gamma[1]],
        )
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
        // The energy norm forgives a coarse gamma1 of a soft spring; a frequency response does not.
        for row in golden().iter().filter(|r| {
            r.damping / r.mass * r.dt <= 1.0 && r.stiffness / r.mass * r.dt * r.dt <= 1.0
        }) {
            let (phi, gamma) =
                oscillator_step(row.stiffness / row.mass, row.damping / row.mass, row.dt);
            for (ours, exact) in phi
                .iter()
                .flatten()
                .chain(&gamma)
                .zip(row.phi.iter().flatten().chain(&row.gamma))
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
            for (index, (less, whole)) in increment
                .phi_minus_one
                .iter()
                .flatten()
                .zip(phi.iter().flatten())
                .enumerate()
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
        // Across each border of the regimes the two formulas differ by rounding only.
        for (w2, d) in [
            (1.0, 0.5),
            (1.0, 1.0),
            (1e-9, 1.0),
            (0.2, 1.0),
            (1.0, 1e-9),
            (0.24, 1.0),
        ] {
            let below = oscillator_step(w2, d, 1.0);
            let above = oscillator_step(w2, d, 1.0 + f64::EPSILON * 4.0);
            for (p, q) in below
                .0
                .iter()
                .flatten()
                .chain(&below.1)
                .zip(above.0.iter().flatten().chain(&above.1))
            {
                assert!((p - q).abs() <= CLOSED_FORM_TOLERANCE, "{p} {q}");
            }
        }
        // And at the critical damping, where the closed forms change.
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
        // phi(a + b) = phi(b) phi(a): what splitting a step at the latency relies on.
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

    /// Mass, spring, damper and an amplifier pole: (x, v, force).
    fn amplified(w2: f64, d: f64, pole: f64) -> (Matrix3<f64>, Vector3<f64>) {
        (
            Matrix3::new(0.0, 1.0, 0.0, -w2, -d, 1.0, 0.0, 0.0, -pole),
            Vector3::new(0.0, 0.0, pole),
        )
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
                assert!(
                    (ratio - 4.0).abs() < 0.3,
                    "Euler's error falls by {ratio} and not by 4"
                );
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
        // Halving the lag of the amplifier halves the velocity that it costs: first order, as the theory says.
        let (_, plain) = oscillator_step(26.6, 13.3, 1e-4);
        let deficit = [1e6, 2e6, 4e6, 8e6].map(|pole| {
            let (a, b) = amplified(26.6, 13.3, pole);
            plain[1] - discretise(&a, &b, 1e-4).1[1]
        });
        for pair in deficit.windows(2) {
            assert!(
                (pair[0] / pair[1] - 2.0).abs() < 0.01,
                "{}",
                pair[0] / pair[1]
            );
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
                let (other, g) =
                    discretise(&scaled, &Vector3::from_fn(|r, _| b[r] * unit[r]), 1e-3);
                for r in 0..3 {
                    assert_eq!(g[r], gamma[r] * unit[r]);
                    for c in 0..3 {
                        assert_eq!(other[(r, c)], phi[(r, c)] * unit[r] / unit[c]);
                    }
                }
            }
        }
        // A step of the oscillator knows the ratios k/m and b/m only; time scales exactly too.
        let (phi, gamma) = oscillator_step(26.6, 13.3, 1e-4);
        let (other, g) = oscillator_step(26.6 * 16.0, 13.3 * 4.0, 1e-4 / 4.0);
        assert_eq!(
            (
                other[0][0],
                other[1][1],
                other[0][1] * 4.0,
                other[1][0] / 4.0
            ),
            (phi[0][0], phi[1][1], phi[0][1], phi[1][0])
        );
        assert_eq!((g[0] * 16.0, g[1] * 4.0), (gamma[0], gamma[1]));
    }

    #[test]
    fn nothing_happens_in_no_time() {
        for (w2, d) in [(0.0, 0.0), (1e12, 0.0), (0.0, 1e9), (1e12, 1e9)] {
            assert_eq!(
                oscillator_step(w2, d, 0.0),
                ([[1.0, 0.0], [-0.0, 1.0]], [0.0, 0.0])
            );
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
                        // A passive plant does not gain energy.
                        let (phi, _) = oscillator_step(w2, d, dt);
                        let determinant = phi[0][0] * phi[1][1] - phi[0][1] * phi[1][0];
                        assert!(determinant.abs() <= 1.0 + GOLDEN_TOLERANCE, "{determinant}");
                    }
                }
            }
        }
    }
}
