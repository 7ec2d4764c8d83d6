//! The device that the firmware controls: what cannot be tuned while it runs.
//!
//! These are the numbers of the scene `paper-1um`. Another device is another set of them here; its
//! `envelope.csv`, from `cargo sim sweep`, goes with it.

use zwidth::{
    Design, HitSettings, Settings, SettingsError, VelocitySettings, WallSettings,
    envelope::Envelope,
    safety::{SafetyPlan, SafetySettings},
    store::{DeviceKey, Signs, Stored},
};

use crate::board;

/// Name, as in the scene and in the envelope.
pub const NAME: &str = "paper-1um";

/// What is built and does not change.
pub const DESIGN: Design = Design {
    rate_hz: board::RATE_HZ as f64,
    resolution_m: 1e-6,
    full_scale_n: 5.906, // 0.5906 N/V times 10 V
    period: PERIOD,
    output: board::OUTPUT,
};

/// Samples per output.
pub const PERIOD: u32 = if cfg!(feature = "period-1") { 1 } else { 10 };

/// From the counter's reading to the force, in samples: computing, and on a board with PWM the
/// way to the next PWM period and half of that period (docs/firmware.md has the measurement).
pub const LATENCY_SAMPLES: f64 = board::LATENCY_SAMPLES;

/// Walls that are predicted to be stable. None yet: every wall needs `unlock envelope`.
pub const ENVELOPE: Envelope<'static> = Envelope::EMPTY;

/// The wall hit of the paper; the push is tuned.
pub const fn hit(push_n: f64) -> HitSettings {
    HitSettings { push_n, settle_s: 4.0, window_s: 2.0, rms_limit_m: 1.5e-5 }
}

const SAFETY: SafetySettings = SafetySettings {
    speed_max_m_per_s: 1.0,
    speed_believable_m_per_s: 5.0,
    ramp_in_s: 0.2,
    sign_test_force: 0.05,
    sign_test_counts: 20,
};

/// The supervisor's limits.
///
/// # Errors
/// A number above is out of range.
pub fn safety() -> Result<SafetyPlan, SettingsError> {
    SAFETY.build(&DESIGN)
}

/// Settings of a board to which nothing was ever saved: no wall at all.
pub fn defaults() -> Stored {
    Stored {
        device: DeviceKey::new(NAME).unwrap_or_default(),
        settings: Settings {
            velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0, prewarp: false },
            wall: WallSettings {
                position_m: 0.07,
                stiffness_n_per_m: 0.0,
                damping_n_s_per_m: 0.0,
                push_only: true,
            },
        },
        push_n: 0.0,
        signs: Signs::default(),
    }
}
