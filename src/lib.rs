//! The control core of a one-degree-of-freedom haptic device: from encoder counts to the force
//! command of a spring-damper wall, in fixed point, without heap, floats or panics.
//!
//! ```text
//! count -> Position -> Velocity -> Force -> OutputCode    (SI settings become integers once, before)
//! ```
//!
//! Firmware and simulator compile this code. Both call [`Sampler::sense`] for every encoder sample (10 kHz) and
//! [`LoopParameters::render`] for every output (1 kHz). The firmware calls them through the guard and the supervisor of
//! [`safety`]. A person sets [`Settings`] in SI units. [`Settings::build`] checks them and converts them to the integer
//! coefficients of a [`LoopParameters`]. Samples change only the state of the [`Sampler`]. [`units`] has all formats in
//! one table.
//!
//! ```
//! use zwidth::{CounterWidth, Design, Output, Sampler, Settings, VelocitySettings, WallSettings};
//! use zwidth::units::Force;
//!
//! let design = Design {
//!     rate_hz: 10_000.0,
//!     resolution_m: 1e-6,
//!     full_scale_n: 5.906,
//!     period: 10,
//!     output: Output::Continuous,
//! };
//! let settings = Settings {
//!     velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
//!     wall: WallSettings {
//!         position_m: 0.07,
//!         stiffness_n_per_m: 20_000.0,
//!         damping_n_s_per_m: 50.0,
//!         push_only: true,
//!     },
//! };
//! let control = settings.build(&design)?;
//! let mut sampler = Sampler::new(0, CounterWidth::Bits32);
//! let sampled = sampler.sample(&control, 0);
//! if sampled.due {
//!     let drive = control.render(sampled.motion, Force::ZERO);
//!     assert_eq!(control.actuator.command(drive.force).code(), 0);
//! }
//! # Ok::<(), zwidth::SettingsError>(())
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

#[cfg(test)]
extern crate std;

pub mod actuator;
#[cfg(test)]
mod bounds;
pub mod console;
pub mod contract;
mod control;
mod crc;
mod design;
pub mod device;
pub mod encoder;
pub mod experiment;
mod gain;
pub mod image;
pub mod passivity;
pub mod period;
pub mod port;
mod range;
pub mod renderer;
pub mod safety;
pub mod self_test;
mod settings;
pub mod store;
pub mod telemetry;
pub mod units;
pub mod velocity;
pub mod wall;

pub use actuator::Output;
pub use control::{Drive, LoopParameters, Motion, RUN, Sampled, Sampler};
pub use design::Design;
pub use encoder::CounterWidth;
pub use experiment::HitSettings;
pub use gain::Gain;
pub use range::{SettingsError, ends, limits, shorten};
pub use settings::{Settings, WallSettings};
pub use velocity::VelocitySettings;
