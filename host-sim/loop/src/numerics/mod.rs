//! Mathematics that knows no device: the exact step of a linear system, integrators, Fourier transform, random numbers, statistics.

pub mod double;
pub mod exact;
pub mod fft;
pub mod integrator;
pub mod random;
pub mod statistics;

/// A number of things: what is below 0 is none.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
pub fn whole(value: f64) -> usize {
    value as usize
}
