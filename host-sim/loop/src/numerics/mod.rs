//! Mathematics that knows no device: the exact step of a linear system, integrators, Fourier transform, random numbers, statistics.

pub mod double;
pub mod exact;
pub mod fft;
pub mod integrator;
pub mod random;
pub mod statistics;
