//! Passivity of a sampled virtual wall in any passive hand, after Colgate and Schenkel.
//!
//! ```text
//! b > (T/2) max over 0 <= w <= pi of Re{(1 - z^-1) C(z)} / (1 - cos w),   z = exp(j w),   C = K + B V(z)
//! ```
//! necessary and sufficient, no latency, force held over the sample. J. E. Colgate, G. G. Schenkel, "Passivity
//! of a class of sampled-data systems", J. Robotic Systems 14(1), 1997. The quotient is 0/0 at w = 0; splitting
//! `V(z) = V(1) + (1 - z^-1) W(z)` removes it for every estimator, since `(1 - z^-1)^2 = -2 (1 - cos w) z^-1`:
//! ```text
//! b > T (K + B V(1)) / 2 + T max over w of -B Re{z^-1 W(z)}
//! ```
//! For the plain difference W = 1/T, and the maximum is |B|: the known `b > K T/2 + |B|`.
//!
//! A slower output and a latency: [`Passivity`].

mod running;
#[cfg(test)]
pub(super) mod tests;

pub use running::Passivity;

/// Search points per decade of frequency.
const PER_DECADE: u32 = 64;
/// Poles beyond this count as on the circle: a double one is found to about 1e-8.
const STABLE_RADIUS: f64 = 1.0 - 1e-8;

/// What passivity asks of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassivityDemand {
    /// The device is passive behind the wall exactly if its viscous damping is larger than this, N s/m.
    pub damping_n_s_per_m: f64,
    /// Where the condition binds, Hz.
    pub frequency_hz: f64,
}
