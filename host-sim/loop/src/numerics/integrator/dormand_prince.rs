//! Dormand and Prince's pair of orders 5 and 4. It gives one step, the error of the step, and the length of the next
//! step.

use super::{Field, rk4::along};

/// Stage weights (Dormand, Prince 1980, table 2), row by row.
const STAGES: [&[f64]; 6] = [
    &[1.0 / 5.0],
    &[3.0 / 40.0, 9.0 / 40.0],
    &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
    &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0],
    &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0],
    &[35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
];
/// Fifth-order weights minus fourth-order weights.
const ERROR: [f64; 7] = [
    35.0 / 384.0 - 5179.0 / 57600.0,
    0.0,
    500.0 / 1113.0 - 7571.0 / 16695.0,
    125.0 / 192.0 - 393.0 / 640.0,
    -2187.0 / 6784.0 + 92097.0 / 339_200.0,
    11.0 / 84.0 - 187.0 / 2100.0,
    -1.0 / 40.0,
];
/// Safety factor, below 1, for the step length that the error allows.
const SAFETY: f64 = 0.9;
/// Smallest and largest ratio of the lengths of two successive steps.
const CHANGE: (f64, f64) = (0.2, 5.0);

/// One step of length h with the fifth-order weights, and its estimated error.
#[inline]
pub fn step<const N: usize>(field: &impl Field<N>, z: &[f64; N], h: f64) -> ([f64; N], [f64; N]) {
    let mut rates = [[0.0; N]; 7];
    rates[0] = field.rate(z);
    let mut next = *z;
    for (stage, weights) in STAGES.iter().enumerate() {
        let mut sum = [0.0; N];
        for (weight, rate) in weights.iter().zip(&rates) {
            for i in 0..N {
                sum[i] += weight * rate[i];
            }
        }
        next = along(z, h, &sum);
        rates[stage + 1] = field.rate(&next);
    }
    let error = core::array::from_fn(|i| {
        h * ERROR.iter().zip(&rates).map(|(weight, rate)| weight * rate[i]).sum::<f64>()
    });
    (next, error)
}

const fn powi5(x: f64) -> f64 {
    x * x * x * x * x
}

/// Factor for the length of the next step. `error` is the error divided by the tolerance.
pub fn change(error: f64) -> f64 {
    /// Largest error at which the factor is at its upper bound. Then no power has to be computed, which saves time.
    const SMALL: f64 = 1e-4;
    const { assert!(SMALL < powi5(SAFETY / CHANGE.1)) };
    if error < SMALL {
        return CHANGE.1;
    }
    (SAFETY * libm::pow(error, -0.2)).clamp(CHANGE.0, CHANGE.1)
}
