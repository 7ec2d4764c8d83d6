//! Semi-implicit (symplectic) Euler. Speeds and force use the rates at the start of the step. Then the positions use
//! the new speeds.

use super::Field;

/// One step of length h.
#[inline]
pub fn step<const N: usize>(field: &impl Field<N>, z: &[f64; N], h: f64) -> [f64; N] {
    let rate = field.rate(z);
    let mut next = *z;
    for i in 0..N {
        next[i] += h * rate[i];
    }
    for body in 0..N / 2 {
        next[2 * body] = z[2 * body] + h * next[2 * body + 1];
    }
    next
}
