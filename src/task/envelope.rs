//! Settings as the loop takes them, and whether their wall is predicted to be stable on this board: by
//! `scenes/BOARD.envelope.csv`, which a sweep wrote, as the build script took it in.

use zwidth::{
    LoopParameters, SettingsError,
    safety::envelope::{Boundary, Envelope, Key, Outside, Point},
    store::Stored,
};

use super::{
    device,
    order::{Gains, Order},
};

include!(concat!(env!("OUT_DIR"), "/envelope.rs"));

/// The integers of those settings.
///
/// # Errors
/// Names what is out of range.
pub fn control(stored: &Stored) -> Result<LoopParameters, SettingsError> {
    stored.settings.build(&device::design(stored.full_scale_n)?)
}

/// What of the envelope holds for those settings.
pub fn key(stored: &Stored) -> Key<'_> {
    let velocity = &stored.settings.velocity;
    Key {
        device: stored.device.name(),
        estimator: velocity.name().text(),
        // A table holds for the default of the second parameter; of another one nothing is known.
        cutoff_hz: match velocity.second() {
            Some((parameter, value)) if value != parameter.default => f64::NAN,
            _ => velocity.tuning().map_or(0.0, |(_, value)| value),
        },
        latency_samples: device::LATENCY_SAMPLES,
        period_samples: f64::from(device::PERIOD),
    }
}

/// Whether their gains lie inside it.
///
/// # Errors
/// Says what is allowed.
pub fn inside(stored: &Stored) -> Result<(), Outside> {
    let wall = &stored.settings.wall;
    ENVELOPE.allows(&key(stored), wall.stiffness_n_per_m, wall.damping_n_s_per_m)
}

/// The order to `render` to take them.
///
/// # Errors
/// Names what is out of range.
pub fn order(stored: &Stored) -> Result<Order, SettingsError> {
    let gains = if inside(stored).is_ok() { Gains::Inside } else { Gains::Outside };
    Ok(Order::LoopParameters(control(stored)?, gains))
}
