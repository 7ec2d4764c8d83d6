//! Mathematics that is independent of the device.

pub mod double;
pub mod exact;
pub mod fft;
pub mod integrator;
pub mod random;
pub mod statistics;

/// Converts to a whole number, rounded down. A negative value gives 0.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
pub fn whole(value: f64) -> usize {
    value as usize
}
