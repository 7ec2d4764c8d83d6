//! The device that the firmware controls, as numbers: what cannot be tuned while it runs.
//!
//! Device, encoder, actuator and sampling are those of the scene with the board's name: the paper's device on this
//! board. What a walk tries is smaller than there, and nothing pushes until somebody says so. Another device is
//! another set of them here; its envelope, from `cargo sim sweep`, goes with it
//! (`scenes/BOARD.envelope.csv`, taken in by build.rs).

use zwidth::{
    Design, HitSettings, Settings, VelocitySettings, WallSettings,
    device::Device,
    experiment::{CalibrationSettings, DutySettings, ReturnSettings, WalkSettings},
    safety::{
        SafetySettings,
        envelope::{Boundary, Envelope, Key, Point},
    },
    store::DeviceKey,
};

use crate::board;

include!(concat!(env!("OUT_DIR"), "/envelope.rs"));

/// The device.
pub static DEVICE: Device = Device {
    key: DeviceKey::of(board::NAME),
    design: Design {
        rate_hz: board::RATE_HZ as f64,
        resolution_m: 1e-6,
        full_scale_n: 5.906, // 0.5906 N/V times 10 V
        period: 10,          // until another one is set
        output: board::OUTPUT,
    },
    // Computing, and on a board with PWM the way to the next PWM period and half of that period
    // (docs/firmware.md has the measurement).
    latency_samples: board::LATENCY_SAMPLES,
    senses: board::SENSES,
    envelope: &ENVELOPE,
    safety: SafetySettings {
        speed_max_m_per_s: 1.0,
        speed_believable_m_per_s: 5.0,
        // The paper's device has 0.15 m (section 2.2.1); that its start, the zero, lies 40 mm from one end is a guess.
        // Enter the way from your zero to each stop, less what the handle needs to come to rest.
        travel_low_m: -0.04,
        travel_high_m: 0.11,
        ramp_in_s: 0.2,
        sign_test_force: 0.05,
        // The free handle moves by some 900; a dead amplifier under a hand's tremor must not pass.
        sign_test_counts: 200,
    },
    // The paper gives no rating: 70 % of full scale and half a minute are a guess for a motor of a hundred grams;
    // enter those of yours.
    duty: DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 },
    back: ReturnSettings::SOFT,
    calibration: CalibrationSettings {
        percent: 0.0,
        rise_percent_per_s: 2.0, // a person can follow it and stop
        hold_s: 30.0,
        travel_m: 1e-3,
    },
    // No wall at all.
    settings: Settings {
        velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
        wall: WallSettings {
            position_m: 0.07,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        },
    },
    // Before and during the judgement of a hit: paper, 2.2.3.
    hit: HitSettings { push_n: 0.0, settle_s: 4.0, window_s: 2.0, rms_limit_m: 1.5e-5 },
    walk: WalkSettings {
        stiffness_start_n_per_m: 2000.0,
        stiffness_step_n_per_m: 2000.0,
        stiffness_max_n_per_m: 1e7,
        damping_start_n_s_per_m: 10.0,
        damping_step_n_s_per_m: 10.0,
        damping_max_n_s_per_m: 4000.0,
    },
};
