//! The exact step of a linear plant whose input is constant over the step (zero-order hold).
//!
//! ```text
//! z' = A z + b u,   u constant over dt
//! z(t + dt) = phi z(t) + gamma u,   phi = exp(A dt),   gamma = integral of exp(A s) b ds over 0..dt
//! ```
//!
//! [`oscillator_step`] has closed forms for the mass-spring-damper. [`discretise`] has the general case, for example
//! with an amplifier pole, an arm or a second mode. Both functions give the same bits on every machine, because they
//! use `libm` and plain IEEE operations in a fixed order. If a unit changes by a power of two, the results are scaled
//! exactly.
//!
//! Source: Franklin, Powell, Workman, "Digital Control of Dynamic Systems", 3rd ed., section 4.3. The results are
//! checked against 50-digit values (`tests/golden/plant_step.csv`).

use nalgebra::{SMatrix, SVector};

/// Largest `|pole| dt` for which [`oscillator_step`] sums the power series. Up to this limit, cancellation between
/// terms loses at most one digit. For short steps the closed forms would lose as many digits as `1 - phi11` loses.
const SERIES_LIMIT: f64 = 1.0;
/// Number of terms of the series. If both poles are inside |z| <= 1, |h_n| <= n + 1. The remainder is then below 22 /
/// 22! = 2e-20.
const SERIES_TERMS: u32 = 21;
/// Limit of the slow pole times dt, which selects the formula for gamma1. Below the limit, gamma1 is a divided
/// difference. The fast pole times dt is then above 0.75, so the difference keeps its digits. From the limit on, gamma1
/// is `(1 - phi11) / w^2`. There `1 - phi11` is at least 0.06.
const SLOW_POLE_LIMIT: f64 = 0.25;

/// Increment of one step: `phi - 1` and `gamma`. For a short step phi is near 1, and only the small difference contains
/// the dynamics. Frequency responses near zero frequency need all digits of this difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Increment {
    /// `phi - 1`. The rows are x and v.
    pub phi_minus_one: [[f64; 2]; 2],
    /// Response to a unit acceleration, in (m, m/s) per m/s^2.
    pub gamma: [f64; 2],
}

/// One exact step of `x'' = u - stiffness_per_mass x - damping_per_mass x'`. The state is (x, v), and the acceleration
/// u is constant over `dt`. Returns phi, and the response gamma to a unit acceleration.
///
/// Units: the arguments are in 1/s^2, 1/s and s; gamma is in s^2 and s. For a force F on a mass m, `u = F / m`. All
/// arguments must be finite and not negative; dt may be 0. No digits are lost in any of these cases: undamped over
/// hundreds of oscillations, overdamped with a time constant far below dt, critically damped, without a spring.
#[must_use]
pub fn oscillator_step(
    stiffness_per_mass: f64,
    damping_per_mass: f64,
    dt: f64,
) -> ([[f64; 2]; 2], [f64; 2]) {
    let (phi, gamma, _) = solve(stiffness_per_mass, damping_per_mass, dt);
    (phi, gamma)
}

/// [`oscillator_step`] with `phi - 1` instead of phi.
pub fn oscillator_increment(stiffness_per_mass: f64, damping_per_mass: f64, dt: f64) -> Increment {
    let (_, gamma, phi_minus_one) = solve(stiffness_per_mass, damping_per_mass, dt);
    Increment { phi_minus_one, gamma }
}

/// Computes phi, gamma and `phi - 1`. With the poles l1, l2 and E(l) = exp(l dt):
/// `phi12 = (E(l1) - E(l2)) / (l1 - l2)`, `gamma = (integral of phi12, phi12)`.
fn solve(w2: f64, d: f64, dt: f64) -> ([[f64; 2]; 2], [f64; 2], [[f64; 2]; 2]) {
    let half = 0.5 * d;
    if d * dt <= SERIES_LIMIT && w2 * dt * dt <= SERIES_LIMIT {
        return series(w2, d, dt);
    }
    // The difference is rounded only once. So near critical damping the discriminant keeps all digits of its inputs.
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
        let slow = w2 / fast; // half - r would lose digits
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

/// `(exp(z) - 1) / z`, the mean of exp over 0..z. The value is 1 at z = 0.
fn mean_exp(z: f64) -> f64 {
    if z == 0.0 { 1.0 } else { libm::expm1(z) / z }
}

/// Series for short steps: `phi12 = dt sum h_n / (n+1)!`, `gamma1 = dt^2 sum h_n / (n+2)!`. h_n is the complete
/// symmetric polynomial of the two poles times dt: `h_n = -(d dt) h_(n-1) - (w^2 dt^2) h_(n-2)`.
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
/// Number of terms of the series in [`discretise`]. If |A h| <= 1/2, the remainder is below 0.5^19 / 20! = 8e-25. The
/// norm does not include a chain of integrators, because its series is finite: it has N terms.
const TAYLOR_TERMS: u32 = 19;

/// One exact step of `z' = A z + b u` over `dt` seconds, with constant u. Returns (phi, gamma).
///
/// The function sums a series for the short step `h = dt / 2^n`. Then the step is doubled n times. The function
/// computes with `phi - 1` and the mean of `exp(A t)` over the step, because `phi - 1` keeps the digits of slow states.
///
/// The error grows as `|A| dt` times the rounding error of f64, with |A| in the best units. The number of halvings
/// follows from A's largest cycle: the largest geometric mean of the entries around a loop of states. A change of units
/// does not change this mean. So the results are scaled exactly if the unit of a state changes by a power of two.
///
/// For one mass prefer [`oscillator_step`]. A, b and dt must be finite, and dt must not be negative.
#[must_use]
pub fn discretise<const N: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SVector<f64, N>,
    dt: f64,
) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
    let (less, gamma) = discretise_increment(a, b, dt);
    (SMatrix::<f64, N, N>::identity() + less, gamma)
}

/// [`discretise`] with `phi - 1` instead of phi.
pub fn discretise_increment<const N: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SVector<f64, N>,
    dt: f64,
) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
    let halvings = halvings(a, dt);
    let h = dt * libm::ldexp(1.0, -halvings);
    let ah = a * h;
    // mean = sum (A h)^n / (n+1)!, by Horner's method
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
    (less, gamma * dt)
}

/// How often dt must be halved until `|A h|` is at most [`TAYLOR_LIMIT`], in the units that balance A best. In these
/// units the largest entry of A is the largest cycle mean (a theorem of max-plus algebra). The norm of A is at most N
/// times the largest entry.
fn halvings<const N: usize>(a: &SMatrix<f64, N, N>, dt: f64) -> i32 {
    let mut walks = a.abs(); // largest product of entries along `length` steps between two states
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
        let root = 1.0 / length as f64;
        cycle = cycle.max(libm::pow(walks.diagonal().max(), root));
    }
    let norm = cycle * dt * N as f64;
    let mut halvings = 0;
    while libm::ldexp(norm, -halvings) > TAYLOR_LIMIT && halvings < 1000 {
        halvings += 1;
    }
    halvings
}

/// Matrix product in a fixed order. On some processors nalgebra may use fused operations, which give other bits.
fn product<const N: usize>(
    left: &SMatrix<f64, N, N>,
    right: &SMatrix<f64, N, N>,
) -> SMatrix<f64, N, N> {
    SMatrix::from_fn(|row, column| (0..N).map(|via| left[(row, via)] * right[(via, column)]).sum())
}

#[cfg(test)]
mod tests;
