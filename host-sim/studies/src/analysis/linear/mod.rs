//! Linear stability and passivity of the sampled loop. The results are the limits of the ideal device, without
//! quantisation, saturation and the one-sided wall.
//!
//! ```text
//! every sample:           v = V(z) x                    estimator, z^-1 = one sample
//! every period-th sample: F = -(K x + B v)              held until the next one takes over
//! latency samples later:  m x'' = F - b x' - k x        exact under the held force
//! ```
//!
//! With `period = 1` and without latency, these are equations (3) to (5) of the paper's section 2.1. The force changes
//! only once per output period. So at the output instants the loop is time-invariant for any period and latency. Its
//! characteristic equation is affine in K and in B: `1 + K Hx(z) + B Hv(z) = 0`. A root lies on the unit circle exactly
//! if `K(w) = -(1 + B Hv) / Hx` is real at z = exp(j w). This condition gives every crossing in closed form
//! ([`Boundary`]). The monodromy matrix over one period ([`Monodromy`]) is built independently, by stepping the loop.
//! Its eigenvalues show which side of a crossing is stable.
//!
//! Passivity ([`passivity`]) is a stricter criterion (after Colgate and Schenkel): no motion may take energy out of the
//! port. By passivity, the order of the cutoffs is opposite to the order by stability.
//!
//! A plant with linear elements ([`Elements`]) may replace the single mass: the amplifier's lag, a second mode, or an
//! arm. Non-linear elements are not included.
//!
//! Units are SI. Frequencies in reports are in hertz. `omega` is in radians per step of the respective z.

use crate::{
    numerics, scene,
    scene::element::{Amplifier, Arm, Chain, Mode},
};

mod acting;
mod boundary;
mod monodromy;
pub mod passivity;
mod response;
mod transfer;

pub use boundary::{Boundary, Crossing, StiffnessLimit};
pub use monodromy::Monodromy;
pub use transfer::{TransferFunction, position_response, transfer_function};

/// Longest allowed latency, in samples: ten times the longest latency of a scene.
pub const LATENCY_MAX_SAMPLES: f64 = 10_000.0;
/// Longest allowed output period, in samples. The computing time grows with the square of the period.
pub const PERIOD_MAX: u32 = 1_000;
/// Highest order that an estimator may have.
pub const ORDER_MAX: usize = 66;

/// Largest number of iterations to compute eigenvalues. Usually a few per eigenvalue are enough.
const SCHUR_ITERATIONS: usize = 10_000;

/// A mass on a spring and a damper: `m x'' = F - b x' - k x`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Device {
    /// Moving mass in kg, above 0.
    pub mass_kg: f64,
    /// Viscous damping in N s/m, 0 or more.
    pub damping_n_s_per_m: f64,
    /// Stiffness of the return spring in N/m, 0 or more.
    pub stiffness_n_per_m: f64,
}

impl Device {
    /// The device of the paper, with the values that section 2.2.2 identifies.
    pub const PAPER: Self =
        Self { mass_kg: 0.4160, damping_n_s_per_m: 5.5195, stiffness_n_per_m: 11.0626 };
}

/// The linear elements of the device. By default there are none. [`crate::scene::element`] describes them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Elements {
    pub amplifier: Option<Amplifier>,
    /// A second mass behind the transmission.
    pub mode: Option<Mode>,
    /// A person on the handle.
    pub arm: Option<Arm>,
}

/// The sampled loop around a device, without its wall.
#[derive(Clone, Debug, PartialEq)]
pub struct Loop {
    pub device: Device,
    pub elements: Elements,
    /// Sample rate of position and velocity, above 0 Hz.
    pub rate_hz: f64,
    /// Number of samples per force output, 1 to [`PERIOD_MAX`].
    pub period: u32,
    /// Time from a sample until the force that is computed from this sample acts, in samples. The latency may be any
    /// real number from 0 to [`LATENCY_MAX_SAMPLES`].
    pub latency_samples: f64,
    /// Transfer function of the velocity estimator from position to velocity, at the sample rate.
    pub estimator: TransferFunction,
}

impl Loop {
    /// The loop of the paper's section 2.1. Every sample gives a force, and there is no latency.
    #[must_use]
    pub fn single_rate(device: Device, rate_hz: f64, estimator: TransferFunction) -> Self {
        let elements = Elements::default();
        Self { device, elements, rate_hz, period: 1, latency_samples: 0.0, estimator }
    }

    /// Checks whether the analysis accepts this loop.
    ///
    /// # Errors
    /// A quantity is not finite or out of its range. The error names the first such quantity.
    pub fn check(&self) -> Result<(), LinearError> {
        let Device { mass_kg, damping_n_s_per_m, stiffness_n_per_m } = self.device;
        let Elements { amplifier, mode, arm } = self.elements;
        let (least, most) = (f64::MIN_POSITIVE, f64::MAX);
        let period = Some(f64::from(self.period));
        let numbers = [
            ("mass_kg", Some(mass_kg), least, most),
            ("damping_n_s_per_m", Some(damping_n_s_per_m), 0.0, most),
            ("stiffness_n_per_m", Some(stiffness_n_per_m), 0.0, most),
            ("rate_hz", Some(self.rate_hz), least, most),
            ("latency_samples", Some(self.latency_samples), 0.0, LATENCY_MAX_SAMPLES),
            ("period", period, 1.0, f64::from(PERIOD_MAX)),
            ("amplifier.bandwidth_hz", amplifier.map(|a| a.bandwidth_hz), least, most),
            ("mode.mass_kg", mode.map(|m| m.mass_kg), least, most),
            ("arm.mass_kg", arm.map(|a| a.mass_kg), least, most),
            ("mode.stiffness_n_per_m", mode.map(|m| m.stiffness_n_per_m), 0.0, most),
            ("mode.damping_n_s_per_m", mode.map(|m| m.damping_n_s_per_m), 0.0, most),
            ("arm.stiffness_n_per_m", arm.map(|a| a.stiffness_n_per_m), 0.0, most),
            ("arm.damping_n_s_per_m", arm.map(|a| a.damping_n_s_per_m), 0.0, most),
            ("arm.grip_stiffness_n_per_m", arm.map(|a| a.grip_stiffness_n_per_m), 0.0, most),
            ("arm.grip_damping_n_s_per_m", arm.map(|a| a.grip_damping_n_s_per_m), 0.0, most),
        ];
        for (name, value, low, high) in numbers {
            if value.is_some_and(|value| !(low..=high).contains(&value)) {
                return Err(LinearError::OutOfRange { name, low, high });
            }
        }
        self.estimator.check()
    }

    /// The plant as one system. Its positions are measured from rest.
    pub(crate) fn chain(&self) -> Chain {
        let Device { mass_kg, damping_n_s_per_m, stiffness_n_per_m } = self.device;
        let Elements { amplifier, mode, arm } = self.elements;
        let (rest_position_m, start_position_m) = (0.0, 0.0);
        let device = scene::Device {
            mass_kg,
            damping_n_s_per_m,
            stiffness_n_per_m,
            rest_position_m,
            start_position_m,
        };
        Chain { mode, arm, amplifier, ..Chain::alone(device) }
    }

    #[must_use]
    pub fn sample_s(&self) -> f64 {
        1.0 / self.rate_hz
    }

    /// Divides the latency into whole output periods and a rest in samples. The rest is at least 0 and below one
    /// period.
    pub(crate) fn split_latency(&self) -> (usize, f64) {
        let period = f64::from(self.period);
        let whole = (self.latency_samples / period).floor();
        (numerics::whole(whole), (self.latency_samples - whole * period).max(0.0))
    }
}

/// The reason why a loop cannot be analysed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LinearError {
    /// A number is not finite or out of its range.
    OutOfRange { name: &'static str, low: f64, high: f64 },
    /// The estimator has no denominator, a leading zero in the denominator, a coefficient that is not finite, or an
    /// order above [`ORDER_MAX`].
    Estimator,
}

impl core::fmt::Display for LinearError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::OutOfRange { name, low, high } => {
                write!(f, "{name} must lie in {low:e} to {high:e}")
            }
            Self::Estimator => write!(
                f,
                "estimator needs finite coefficients, den[0] other than 0 and an order of at most {ORDER_MAX}"
            ),
        }
    }
}

impl core::error::Error for LinearError {}

#[cfg(test)]
mod tests;
