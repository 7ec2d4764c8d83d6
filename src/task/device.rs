//! The device that the firmware controls: what cannot be tuned while it runs.
//!
//! These are the numbers of the scene with the board's name: the paper's device on this board. Another
//! device is another set of them here; its envelope, from `cargo sim sweep`, goes with it
//! (`scenes/BOARD.envelope.csv`, taken in by build.rs).

use zwidth::{
    Design, HitSettings, LoopParameters, Settings, SettingsError, VelocitySettings, WallSettings,
    experiment::{
        CalibrationPlan, CalibrationSettings, DutyPlan, DutySettings, HitSequencePlan,
        ReturnSettings, WalkSettings,
    },
    safety::{SafetyPlan, SafetySettings},
    store::{DeviceKey, Signs, Stored},
};

use super::envelope;
use crate::board;

/// Name, as in the scene and in the envelope.
pub const NAME: &str = board::NAME;

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

/// The way back to the start. Soft enough for a hand to stop it: tuned on the paper's device and on
/// handles of 0.05 to 2 kg (src/experiment/back.rs).
const RETURN: ReturnSettings = ReturnSettings {
    start_m: 0.0, // replaced by the setting
    speed_m_per_s: 0.15,
    force_n: 1.4,
    stiffness_n_per_m: 300.0,
    damping_n_s_per_m: 15.0,
    integral_n_per_m_s: 600.0,
    tolerance_m: 5e-5,
    timeout_s: 10.0,
};

/// What the motor stands. The paper gives no rating: 70 % of full scale and half a minute are a guess
/// for a motor of a hundred grams; enter those of yours.
const DUTY: DutySettings = DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 };

/// Lowest place of the handle with force on, from zero, m. The paper's device has 0.15 m (section 2.2.1);
/// that its start, the zero, lies 40 mm from one end is a guess. Enter the way from your zero to each
/// stop, less what the handle needs to come to rest.
const TRAVEL_LOW_M: f64 = -0.04;
/// Highest such place, m.
const TRAVEL_HIGH_M: f64 = 0.11;

/// The force at full command may differ from the one above by this factor; more is a typing error.
const FULL_SCALE_FACTOR: f64 = 3.0;

/// [`DESIGN`] with the force at full command that was calibrated.
///
/// # Errors
/// It is too far from that of [`DESIGN`].
pub fn design(full_scale_n: f64) -> Result<Design, SettingsError> {
    let nominal = DESIGN.full_scale_n;
    let range = nominal / FULL_SCALE_FACTOR..=nominal * FULL_SCALE_FACTOR;
    if range.contains(&full_scale_n) {
        Ok(Design { full_scale_n, ..DESIGN })
    } else {
        Err(SettingsError { parameter: "full_scale_n", value: full_scale_n, range })
    }
}

/// What is made of the numbers of this file: the defaults, the supervisor's limits, what the motor stands.
///
/// # Errors
/// Names the first that is out of range.
pub fn constants() -> Result<(LoopParameters, SafetyPlan, DutyPlan), SettingsError> {
    let safety = SAFETY.build(&DESIGN)?;
    DUTY.build(&DESIGN, 0)?;
    let defaults = defaults();
    let duty = trial(&defaults, false)?.duty;
    Ok((envelope::control(&defaults)?, safety, duty))
}

/// A hit with those settings and what comes before it.
///
/// # Errors
/// Names what is out of range; a start at or behind the wall is.
pub fn trial(stored: &Stored, early: bool) -> Result<HitSequencePlan, SettingsError> {
    let design = design(stored.full_scale_n)?;
    let Stored { push_n, settle_s, window_s, rms_limit_m, .. } = *stored;
    let hit = HitSettings { push_n, settle_s, window_s, rms_limit_m }.build(&design)?;
    let start_m = stored.start_m;
    let wall_m = stored.settings.wall.position_m;
    // A motor weaker than it was taken for brings the handle back with what it has.
    let force_n = RETURN.force_n.min(design.full_scale_n / 2.0);
    let back = ReturnSettings { start_m, force_n, ..RETURN }.build(&design)?;
    let range = TRAVEL_LOW_M..=wall_m.min(TRAVEL_HIGH_M) - design.resolution_m;
    if !range.contains(&start_m) {
        return Err(SettingsError { parameter: "start_m", value: start_m, range });
    }
    // What heats is the current: its part of full scale stays, whatever force a calibration found there.
    let continuous_force_n = DUTY.continuous_force_n * (design.full_scale_n / DESIGN.full_scale_n);
    let duty = DutySettings { continuous_force_n, ..DUTY };
    let range = 0.0..=duty.longest_hit_s(&design);
    let value = settle_s + window_s;
    if !range.contains(&value) {
        return Err(SettingsError { parameter: "settle_s and window_s together", value, range });
    }
    let duty = duty.build(&design, hit.settle.saturating_add(hit.window))?;
    Ok(HitSequencePlan { hit, back, duty, early })
}

/// A calibration at that part of full scale.
///
/// # Errors
/// It is too much.
pub fn calibration(percent: f64) -> Result<CalibrationPlan, SettingsError> {
    let settings = CalibrationSettings {
        percent,
        rise_percent_per_s: 2.0, // a person can follow it and stop
        hold_s: 30.0,
        travel_m: 1e-3,
    };
    settings.build(&DESIGN)
}

const SAFETY: SafetySettings = SafetySettings {
    speed_max_m_per_s: 1.0,
    speed_believable_m_per_s: 5.0,
    travel_low_m: TRAVEL_LOW_M,
    travel_high_m: TRAVEL_HIGH_M,
    ramp_in_s: 0.2,
    sign_test_force: 0.05,
    // The free handle moves by some 900; a dead amplifier under a hand's tremor must not pass.
    sign_test_counts: 200,
};

/// Before and during the judgement of a hit, s (paper, 2.2.3).
const PAPER_SETTLE_S: f64 = 4.0;
const PAPER_WINDOW_S: f64 = 2.0;

/// Settings of a board to which nothing was ever saved: no wall at all; hit and grid of the paper.
pub fn defaults() -> Stored {
    // The paper's hit, or as much of it as the motor stands, less 1 % for rounding.
    let longest_s = 0.99 * DUTY.longest_hit_s(&DESIGN);
    let part = f64::min(1.0, longest_s / (PAPER_SETTLE_S + PAPER_WINDOW_S));
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
        start_m: 0.0,
        settle_s: PAPER_SETTLE_S * part,
        window_s: PAPER_WINDOW_S * part,
        rms_limit_m: 1.5e-5,
        full_scale_n: DESIGN.full_scale_n,
        grid: WalkSettings {
            stiffness_start_n_per_m: 2000.0,
            stiffness_step_n_per_m: 2000.0,
            stiffness_max_n_per_m: 1e7,
            damping_start_n_s_per_m: 10.0,
            damping_step_n_s_per_m: 10.0,
            damping_max_n_s_per_m: 4000.0,
        },
    }
}
