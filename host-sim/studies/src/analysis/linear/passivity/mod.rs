//! Computes which sampled virtual walls are passive with any hand (after Colgate and Schenkel).
//!
//! ```text
//! b > (T/2) max over 0 <= w <= pi of Re{(1 - z^-1) C(z)} / (1 - cos w),   z = exp(j w),   C = K + B V(z)
//! ```
//! If the force is held over the sample and there is no latency, the condition is necessary and sufficient. J. E.
//! Colgate, G. G. Schenkel, "Passivity of a class of sampled-data systems", J. Robotic Systems 14(1), 1997. The
//! quotient is 0/0 at w = 0. The split `V(z) = V(1) + (1 - z^-1) W(z)` removes the 0/0 for every estimator, because
//! `(1 - z^-1)^2 = -2 (1 - cos w) z^-1`.
//!
//! For a slower output and a latency, see [`Passivity`].

mod running;
#[cfg(test)]
pub(super) mod tests;

pub use running::Passivity;

/// Number of search points per decade of frequency.
const PER_DECADE: u32 = 64;
/// Poles with a larger magnitude are treated as poles on the circle, because a double pole is only exact to about 1e-8.
const STABLE_RADIUS: f64 = 1.0 - 1e-8;

/// What passivity demands of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassivityDemand {
    /// Viscous damping in N s/m. The device with this wall is passive exactly if its own damping is above this value.
    pub damping_n_s_per_m: f64,
    /// Frequency at which the condition is strictest, in Hz.
    pub frequency_hz: f64,
}
